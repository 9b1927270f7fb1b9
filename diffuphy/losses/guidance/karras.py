"""Sampling a diffusion model: the second-order solver of Karras et al. (2022), "Elucidating the design space"."""

import itertools
import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor


def noise_levels(steps: int, low: float, high: float, rho: float = 7.0) -> list[float]:
    """σ_i = (σ_max^{1/ρ} + i/(n−1) (σ_min^{1/ρ} − σ_max^{1/ρ}))^ρ, i < n, then 0 (eq. 5).

    Args:
        steps: n, at least 2.
        low, high: σ_min and σ_max.
        rho: crowds the levels towards σ_min.
    """
    if steps < 2 or not 0 < low < high:
        raise ValueError(f"noise levels need steps ≥ 2 and 0 < σ_min < σ_max, got {steps}, {low} and {high}")
    a, b = high ** (1 / rho), low ** (1 / rho)
    return [*((a + i / (steps - 1) * (b - a)) ** rho for i in range(steps)), 0.0]


def heun(
    denoise: Callable[[Tensor, float], Tensor],
    x: Tensor,
    levels: Sequence[float],
    *,
    churn: float = 0.0,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Follow dx/dσ = (x − D(x; σ))/σ down the ``levels`` (algorithm 2).

    Args:
        denoise: D(x; σ), the expectation of the clean sample.
        x: a draw from N(0, σ_max²).
        levels: decreasing, the last one 0.
        churn: S_churn: each step first raises σ by min(S_churn/n, √2 − 1) of itself with fresh noise.
        generator: source of that noise.
    """
    raised = min(churn / (len(levels) - 1), math.sqrt(2) - 1)
    if raised > 0 and generator is None:
        raise ValueError("churn adds noise: give a torch.Generator, it is never drawn from global state")
    for now, after in itertools.pairwise(levels):
        sigma = now * (1 + raised)
        if generator is not None and raised > 0:
            noise = torch.randn(x.shape, generator=generator, device=generator.device, dtype=x.dtype).to(x.device)
            x = x + math.sqrt(sigma**2 - now**2) * noise
        slope = (x - denoise(x, sigma)) / sigma
        ahead = x + (after - sigma) * slope
        if after > 0:
            ahead = x + (after - sigma) * (slope + (ahead - denoise(ahead, after)) / after) / 2
        x = ahead
    return x
