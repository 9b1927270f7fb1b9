"""What a clip can tell: Fisher information against closed forms, degeneracies, and what is said of them."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from diffuphy.learning.identifiability import (
    RHO,
    STEP,
    Fisher,
    coordinate_of,
    fisher,
    moved,
    sensitivity,
    stated,
    value_at,
)
from diffuphy.material.moduli import NU, E
from diffuphy.types import MaterialField


def field(n=6):
    one = torch.ones(n, 1)
    theta = {"E": torch.full((n,), 1e5), "nu": torch.full((n,), 0.3)}
    return MaterialField(("neo_hookean",), ("identity",), one, one, theta, torch.full((n,), 1e3))


NONE = torch.zeros(6, dtype=torch.long)


def test_fisher_of_a_linear_model_is_that_of_least_squares():
    """c = A q: I = AᵀA/σ², errors² = diag (AᵀA)⁻¹ σ²."""
    generator = torch.Generator().manual_seed(0)
    A = torch.randn(40, 3, generator=generator, dtype=torch.float64)
    J = sensitivity(lambda q: A @ q, torch.zeros(3, dtype=torch.float64))
    found = Fisher.of("abc", J, 0.1)
    # central differences of a linear map: rounding over the step, eps/STEP ≈ 1e-14
    torch.testing.assert_close(found.information, A.T @ A / 0.01, rtol=1e-11, atol=1e-9)
    torch.testing.assert_close(found.errors, (torch.linalg.inv(A.T @ A).diagonal() * 0.01).sqrt(), rtol=1e-9, atol=0)
    assert bool((found.errors >= found.alone).all()) and not found.remarks()


def test_errors_of_least_squares_scatter_as_the_bound_says():
    """The estimator of a linear model attains the bound: its scatter over 4000 draws of noise is the stated error."""
    generator = torch.Generator().manual_seed(1)
    A = torch.randn(30, 2, generator=generator, dtype=torch.float64)
    noise = 0.3 * torch.randn(30, 4000, generator=generator, dtype=torch.float64)
    scatter = torch.linalg.lstsq(A, noise).solution.std(1)
    # the standard deviation of a standard deviation of 4000 draws is 1/√8000 = 1.1 %: four of them
    torch.testing.assert_close(scatter, Fisher.of("ab", A, 0.3).errors, rtol=0.045, atol=0)


def test_difference_is_second_order():
    """c = e^q: (c(q+h) − c(q−h))/2h = e^q (1 + h²/6 + …)."""
    q = torch.tensor([0.3], dtype=torch.float64)
    for step in (0.1, 0.05):
        error = float(sensitivity(torch.exp, q, step)[0, 0] / q.exp()[0] - 1)
        assert error == pytest.approx(step**2 / 6, rel=step**2)


def test_what_no_clip_depends_on_has_no_error_and_is_named():
    J = torch.tensor([[1.0, 0.0], [2.0, 0.0]])
    found = Fisher.of(("E", "yield_stress"), J, 0.1)
    assert math.isinf(found.errors[1]) and math.isinf(found.condition)
    assert float(found.errors[0]) == pytest.approx(0.1 / math.sqrt(5))  # the other one costs it nothing
    (said,) = found.remarks()
    assert said.startswith("the clip does not show yield_stress")


def test_a_ratio_is_seen_and_its_parts_are_not():
    """c depends on q_E − q_ρ alone."""
    c = torch.randn(50, generator=torch.Generator().manual_seed(2), dtype=torch.float64)

    def film(f):
        return c * (f.theta["E"][0] / f.rho[0]).double().log10()

    found = fisher(film, field(), [E, RHO], NONE, 0.1)
    (said,) = found.remarks()
    assert said.startswith("the clip shows E and rho only in combination")
    assert float(found.errors.min()) > 1.0 > float(found.alone.max())
    assert not fisher(film, field(), [E], NONE, 0.1).remarks()


def test_regions_have_errors_of_their_own():
    labels = torch.tensor([0, 0, 0, 0, 1, 1])

    def film(f):
        return f.theta["E"].double().log10()  # one pixel a particle

    found = fisher(film, field(), [E], labels, 0.1)
    assert found.names == ("E of region 0", "E of region 1")
    # float32 parameters: 1e-7 of a log10 of 5 over the step of 0.02
    torch.testing.assert_close(found.errors, 0.1 / torch.tensor([4.0, 2.0]).double().sqrt(), rtol=1e-4, atol=0)
    assert set(stated(found, [E])) == {"error_E_0", "error_E_1", "condition"}


def test_errors_are_stated_in_dex_or_in_the_unit_of_the_parameter():
    found = Fisher.of(("E", "nu"), torch.eye(2), 0.01)
    assert stated(found, [E, NU])["error_E"] == pytest.approx(0.01)
    assert stated(found, [E, NU])["error_nu"] == pytest.approx(0.01 * (NU.hi - NU.lo))


@settings(max_examples=30, deadline=None)
@given(p=st.sampled_from([E, NU]), u=st.floats(0.05, 0.9))
def test_coordinates_and_values_are_inverse(p, u):
    """A shift by h in the coordinate is what ``moved`` makes."""
    q = coordinate_of(p, p.lo) + u * (coordinate_of(p, p.hi) - coordinate_of(p, p.lo))
    assert coordinate_of(p, value_at(p, q)) == pytest.approx(q, abs=1e-9)
    value = torch.tensor(value_at(p, q), dtype=torch.float64)
    assert coordinate_of(p, float(moved(p, value, STEP))) == pytest.approx(q + STEP, abs=1e-9)


def test_noise_must_be_positive():
    with pytest.raises(ValueError, match="positive standard deviation"):
        Fisher.of(("E",), torch.ones(2, 1), 0.0)
