"""Moduli and their ranges."""

import pytest
import torch

from diffuphy.material import moduli
from diffuphy.material.expert import Param


def test_lame_parameters_give_back_young_and_poisson():
    """E = μ (3λ + 2μ)/(λ + μ) and ν = λ/(2(λ + μ))."""
    params = {"E": torch.tensor([1e3, 2e5], dtype=torch.float64), "nu": torch.tensor([0.05, 0.45], dtype=torch.float64)}
    mu, lam = moduli.lame(params)
    torch.testing.assert_close(mu * (3 * lam + 2 * mu) / (lam + mu), params["E"], rtol=1e-14, atol=0)
    torch.testing.assert_close(lam / (2 * (lam + mu)), params["nu"], rtol=1e-14, atol=0)


def test_p_wave_speed_is_that_of_the_p_wave_modulus():
    """ρ c² = E (1 − ν)/((1 + ν)(1 − 2ν))."""
    params = {"E": torch.tensor(1e5, dtype=torch.float64), "nu": torch.tensor(0.3, dtype=torch.float64)}
    c = moduli.p_wave_speed(params, torch.tensor(1000.0, dtype=torch.float64))
    assert abs(1000 * float(c) ** 2 / (1e5 * 0.7 / (1.3 * 0.4)) - 1) < 1e-14


@pytest.mark.parametrize("nu", [0.5, 0.7, -1.0, float("nan")])
def test_impossible_poisson_ratio_is_refused_with_the_remedy(nu: float):
    with pytest.raises(ValueError, match=r"nu must be in \(-1, 0.5\).*'fluid' expert"):
        moduli.check({"E": torch.tensor([1e5, 1e5]), "nu": torch.tensor([0.3, nu])})


@pytest.mark.parametrize("young", [0.0, -1.0, float("inf"), float("nan")])
def test_impossible_modulus_is_refused_with_the_remedy(young: float):
    with pytest.raises(ValueError, match=r"E must be positive.*'fluid' expert"):
        moduli.check({"E": torch.tensor([1e5, young]), "nu": torch.tensor([0.3, 0.3])})


@pytest.mark.parametrize(("lo", "hi", "default", "log"), [(1, 0, 0.5, False), (0, 1, 2, False), (0, 1, 0.5, True)])
def test_parameter_with_an_empty_range_is_refused(lo: float, hi: float, default: float, log: bool):
    with pytest.raises(ValueError, match="x: "):
        Param("x", "-", lo, hi, log=log, default=default)
