"""The laws on torch tensors: equal to the reference, differentiable everywhere, strict about what they are given."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from diffuphy.material import ELASTIC, PLASTIC, energy, kirchhoff, reference, remember, return_map
from tests.material.evaluate import DEFAULTS, generic, special

RNG = np.random.default_rng(0)
F = torch.from_numpy(np.concatenate([generic(40, RNG, spread=0.6), *special(RNG).values()]))


def differences(f, x: Tensor, d: Tensor) -> Tensor:
    """Directional derivative by fourth-order differences with step 1e-3 of d: h⁴ = 1e-12, rounding 1e-13."""
    h = 1e-3
    near, far = f(x + h * d) - f(x - h * d), f(x + 2 * h * d) - f(x - 2 * h * d)
    return (8 * near - far) / (12 * h)


@pytest.mark.parametrize("name", ELASTIC)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_stress_and_energy_are_those_of_the_reference(name: str, dtype: torch.dtype):
    """To hundreds of ulp of the stiffness; F is rounded first."""
    A, tol = F.to(dtype), 500 * torch.finfo(dtype).eps
    tau = reference.kirchhoff(A.double(), name, DEFAULTS)
    psi = reference.energy(A.double(), name, DEFAULTS)
    scale = tau.abs().amax().clamp_min(DEFAULTS["E"])
    assert (kirchhoff(A, name, DEFAULTS) - tau).abs().max() < tol * scale
    assert (energy(A, name, DEFAULTS) - psi).abs().max() < tol * scale


@pytest.mark.parametrize("name", PLASTIC)
def test_return_map_is_that_of_the_reference(name: str):
    """Also of matter with a past; both in batches of any shape."""
    A = F[:100].reshape(4, 25, 3, 3)
    past = {"log_J": torch.linspace(-0.3, 0.3, 25, dtype=A.dtype), "slip": torch.tensor(0.02, dtype=A.dtype)}
    for memory in (None, past):
        got = return_map(A, name, DEFAULTS, 2e-3, memory)
        torch.testing.assert_close(got, reference.return_map(A, name, DEFAULTS, 2e-3, memory), rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ELASTIC)
def test_gradient_of_stress_and_energy_is_exact_at_equal_stretches(name: str):
    """⟨τ̄, dτ⟩ and dψ against differences, in F and in every parameter, also at F = I and at rotations."""
    bar, d = torch.from_numpy(RNG.normal(size=F.shape)) / DEFAULTS["E"], torch.from_numpy(RNG.normal(size=F.shape)) / 5

    def value(A: Tensor, t: Tensor) -> Tensor:
        params = {p.name: DEFAULTS[p.name] * (1 + 0.1 * t) for p in ELASTIC[name].params}
        return (kirchhoff(A, name, params) * bar).sum((1, 2)) + energy(A, name, params) / DEFAULTS["E"]

    A, t = F.clone().requires_grad_(), torch.zeros(len(F), dtype=F.dtype, requires_grad=True)
    F_bar, t_bar = torch.autograd.grad(value(A, t).sum(), (A, t))
    scale = F_bar.abs().amax().clamp_min(1)
    assert ((F_bar * d).sum((1, 2)) - differences(lambda x: value(x, t), F, d)).abs().max() < 2e-9 * scale
    assert (t_bar - differences(lambda x: value(F, x), t.detach(), torch.ones_like(t))).abs().max() < 2e-9 * scale


def test_gradient_of_the_return_map_through_memory():
    """d slip'/d σ_Y of hardening von Mises: slip' = (2μ |ê| − √(2/3) σ_Y) √(2/3)/(2μ + 2H/3)."""
    sigma = torch.tensor(DEFAULTS["yield_stress"], dtype=torch.float64, requires_grad=True)
    A = torch.diag(torch.exp(torch.tensor([0.2, -0.1, -0.1], dtype=torch.float64)))
    slip = remember(A, "von_mises_hardening", DEFAULTS | {"yield_stress": sigma, "hardening": 2e4})["slip"]
    mu = DEFAULTS["E"] / 2.6
    stiff, n = 2 * mu + 2 / 3 * 2e4, math.sqrt(0.06)
    expected = math.sqrt(2 / 3) * (2 * mu * n - math.sqrt(2 / 3) * DEFAULTS["yield_stress"]) / stiff
    assert abs(slip.item() / expected - 1) < 1e-13
    (grad,) = torch.autograd.grad(slip, sigma)
    assert abs(float(grad) / (-2 / 3 / stiff) - 1) < 1e-12


def test_laws_without_memory_remember_nothing():
    assert remember(F, "von_mises", DEFAULTS) == {}
    new = remember(F, "melting", DEFAULTS, dt=1e-3)
    torch.testing.assert_close(new["heat"], torch.full((len(F),), 1e-3 / DEFAULTS["melt_time"], dtype=F.dtype))


def test_transposed_and_strided_tensors_are_read_as_they_are():
    A = F.mT
    torch.testing.assert_close(kirchhoff(A, "hencky", DEFAULTS), kirchhoff(A.contiguous(), "hencky", DEFAULTS))


def test_bad_input_is_refused():
    eye = torch.eye(3, dtype=torch.float64)
    with pytest.raises(ValueError, match="unknown law 'rubber'; known: fixed_corotated"):
        kirchhoff(eye, "rubber", DEFAULTS)
    with pytest.raises(ValueError, match="'nu' is missing"):
        energy(eye, "hencky", {"E": 1e5})
    with pytest.raises(ValueError, match="det F must be positive, got -1"):
        return_map(-eye, "fluid", {})
    with pytest.raises(ValueError, match="in float32 or float64, got"):
        kirchhoff(eye.half(), "hencky", DEFAULTS)
    with pytest.raises(ValueError, match="unknown memory 'age'"):
        return_map(eye, "melting", DEFAULTS, memory={"age": eye[0]})
