"""Covariances that follow matter."""

import pytest
import torch

from diffuphy.geometry import covariances, rotations
from diffuphy.render.kinematics import advance, limited


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


QUATS, SCALES = normal(20, 4), normal(20, 3, seed=1).exp()


def test_the_product_form_is_that_of_the_deformation_gradient() -> None:
    """Σ ← (1 + Δt ∇v) Σ (1 + Δt ∇v)ᵀ with the ∇v of F ← (1 + Δt ∇v) F is F Σ₀ Fᵀ, to rounding over 100 steps."""
    F, covariance, dt = torch.eye(3, dtype=torch.float64).expand(20, 3, 3), covariances(QUATS, SCALES), 0.01
    for step in range(100):
        grad_v = normal(20, 3, 3, seed=step)
        F = F + dt * grad_v @ F
        covariance = advance(covariance, grad_v, dt)
    torch.testing.assert_close(covariance, covariances(QUATS, SCALES, F), rtol=1e-11, atol=1e-11)


def test_it_converges_to_the_flow_with_first_order() -> None:
    """A constant ∇v for a time T gives F = exp(T ∇v); halving Δt halves the error of Σ, to O(Δt): 2 ± 0.1 at 1/400."""
    grad_v = normal(20, 3, 3)
    true = covariances(QUATS, SCALES, torch.linalg.matrix_exp(grad_v))

    def error(steps: int) -> float:
        covariance = covariances(QUATS, SCALES)
        for _ in range(steps):
            covariance = advance(covariance, grad_v, 1 / steps)
        return float((covariance - true).norm())

    assert error(200) / error(400) == pytest.approx(2.0, abs=0.1)


def test_it_stays_positive_definite_where_the_linear_form_does_not() -> None:
    """Compression at a rate of 1/s over Δt = 0.8 s: (1 − 0.8)² = 0.04 of the variance, where 1 − 2 · 0.8 < 0."""
    rate, dt = -torch.eye(3, dtype=torch.float64), 0.8
    covariance = covariances(QUATS, SCALES)
    assert float(torch.linalg.eigvalsh(advance(covariance, rate, dt)).min()) > 0
    linear = covariance + dt * (rate @ covariance + covariance @ rate.mT)
    assert float(torch.linalg.eigvalsh(linear).max()) < 0
    torch.testing.assert_close(advance(covariance, rate, dt), 0.04 * covariance, rtol=1e-12, atol=0)


def test_what_is_limited_is_counted() -> None:
    """Three of five are stretched beyond 3; Frobenius norms above it alone do not count."""
    S = torch.tensor([[4.0, 1, 1], [1, 1, 3.5], [2.9, 2.9, 2.9], [1, 1, 1], [9, 9, 9]], dtype=torch.float64)
    R, Q = rotations(normal(5, 4)), rotations(normal(5, 4, seed=1))
    cut, count = limited((R * S[:, None]) @ Q, 3.0)
    assert count == 3
    torch.testing.assert_close(torch.linalg.svdvals(cut)[:, 0], S.amax(1).clamp_max(3.0))
