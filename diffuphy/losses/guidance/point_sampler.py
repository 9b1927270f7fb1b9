"""Drawing a cloud with one of Point-E's networks (Nichol et al. 2022): theirs are the noise levels and the churn."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from diffuphy.losses.guidance.karras import heun, noise_levels
from diffuphy.losses.guidance.point_transformer import CHANNELS, PATCHES, PointTransformer

SIGMA_MIN = 1e-3
"""Lowest noise level (``point_e/diffusion/sampler.py``)."""


def draw(
    network: PointTransformer,
    alpha_bar: Tensor,
    views: Tensor | None,
    count: int,
    sigma_max: float,
    *,
    steps: int,
    scale: float,
    generator: torch.Generator,
    churn: float = 0.0,
    coarse: Tensor | None = None,
) -> Tensor:
    """z (count, 6) of one cloud.

    Args:
        network: base or upsampler.
        alpha_bar: ᾱ_k that it was trained with, shape (n,).
        views: features of the text or of V views, shape (V, ...); None: unconditional.
        sigma_max: highest noise level.
        steps: noise levels.
        scale: guidance scale, of conditional networks.
        generator: source of all noise.
        churn: fresh noise on the way.
        coarse: cloud to refine, shape (M, 6), as ``PointTransformer`` takes it.
    """
    noise = torch.randn(count, CHANNELS, generator=generator, device=generator.device)
    x = sigma_max * noise.to(network.input_proj.weight.device)
    levels = noise_levels(steps, SIGMA_MIN, sigma_max)
    return heun(denoiser(network, alpha_bar, views, scale, coarse), x, levels, churn=churn, generator=generator)


def denoiser(
    network: PointTransformer, alpha_bar: Tensor, views: Tensor | None, scale: float, coarse: Tensor | None
) -> Callable[[Tensor, float], Tensor]:
    """D(x; σ) of a network trained at ᾱ_k.

        D = D_∅ + s (1/V Σ_v D_v − D_∅),   D_v = clip(x₀, −1, 1),   x₀ = (z − √(1 − ᾱ_k) ε̂)/√ᾱ_k at z = x/√(1 + σ²)

    k is the last step with ᾱ_k ≥ 1/(1 + σ²), and ∅ are zeros; an upsampler that is told nothing sees them alone.
    """
    device = network.input_proj.weight.device
    condition = views
    if views is None and network.kind == "grid":
        condition = torch.zeros(1, PATCHES, network.features, device=device)
    elif views is not None:
        condition = torch.cat([torch.zeros_like(views[:1]), views])
    rows = 1 if condition is None else len(condition)

    def denoise(x: Tensor, sigma: float) -> Tensor:
        k = int((alpha_bar >= 1 / (1 + sigma**2)).sum().clamp(1, len(alpha_bar))) - 1
        z = (x / math.sqrt(1 + sigma**2)).expand(rows, -1, -1)
        low = None if coarse is None else coarse.expand(rows, -1, -1)
        noise = network(z, torch.full((rows,), k, device=device), condition, low)[..., :CHANNELS].float()
        a = alpha_bar[k].item()
        clean = ((z - math.sqrt(1 - a) * noise) / math.sqrt(a)).clamp(-1, 1)
        return clean[0] if rows == 1 else clean[0] + scale * (clean[1:].mean(0) - clean[0])

    return denoise
