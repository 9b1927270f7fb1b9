"""The sampler against flows that have closed forms."""

import itertools
import math

import pytest
import torch

from diffuphy.losses.guidance.karras import heun, noise_levels

MEAN, WIDTH = 0.3, 0.5


def gaussian(x, sigma):
    """D(x; σ) of data N(m, s²): (s² x + σ² m)/(s² + σ²)."""
    return (WIDTH**2 * x + sigma**2 * MEAN) / (WIDTH**2 + sigma**2)


def flow(x, sigma):
    """Where dx/dσ = (x − D)/σ ends: m + s (x − m)/√(s² + σ²)."""
    return MEAN + WIDTH * (x - MEAN) / math.sqrt(WIDTH**2 + sigma**2)


def test_levels_are_karras_and_end_at_zero():
    levels = noise_levels(64, 1e-3, 120.0)
    assert levels[0] == pytest.approx(120) and levels[-2] == pytest.approx(1e-3) and levels[-1] == 0
    roots = torch.tensor(levels[:-1], dtype=torch.float64) ** (1 / 7)
    # σ^{1/ρ} is evenly spaced; float64 powers of numbers of order 1
    torch.testing.assert_close(roots.diff(), roots.diff()[:1].expand(63), rtol=1e-12, atol=0)


def test_heun_is_of_second_order():
    """The error of data that are normal falls as n⁻²: measured order between 1.8 and 2.3, from 32 to 256 levels."""
    x = torch.linspace(-100, 100, 21, dtype=torch.float64)
    counts = [32, 64, 128, 256]
    errors = [(heun(gaussian, x, noise_levels(n, 1e-3, 80.0)) - flow(x, 80.0)).abs().max().item() for n in counts]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert all(1.8 < order < 2.3 for order in orders), (errors, orders)


def test_churn_keeps_the_distribution():
    """N(0, σ_max²) goes to N(m, s²), with fresh noise on the way; five standard errors of 20 000 draws."""
    g, n = torch.Generator().manual_seed(0), 20_000
    x = 120 * torch.randn(n, generator=g, dtype=torch.float64)
    y = heun(gaussian, x, noise_levels(64, 1e-3, 120.0), churn=3.0, generator=g)
    assert abs(y.mean() - MEAN) < 5 * WIDTH / math.sqrt(n)
    assert abs(y.std() / WIDTH - 1) < 5 / math.sqrt(2 * n)
    assert (y - flow(x, 120.0)).abs().mean() > 0.05  # other noise than that of the start


def test_a_known_point_is_reached_exactly():
    """D = const: the last step goes to it whatever came before."""
    x = heun(lambda x, sigma: torch.full_like(x, 0.25), torch.randn(5), noise_levels(8, 1e-3, 80.0))
    # σ_min · eps of a subtraction of order 1
    torch.testing.assert_close(x, torch.full((5,), 0.25), rtol=0, atol=1e-6)


def test_noise_needs_a_generator_and_levels_an_order():
    with pytest.raises(ValueError, match=r"torch\.Generator"):
        heun(gaussian, torch.zeros(2), [1.0, 0.0], churn=3.0)
    for wrong in ((1, 1e-3, 80.0), (8, 2.0, 1.0), (8, 0.0, 1.0)):
        with pytest.raises(ValueError, match="noise levels"):
            noise_levels(*wrong)
