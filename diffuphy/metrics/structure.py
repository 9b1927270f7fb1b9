"""Pixel by pixel: SSIM, on whole frames or on the object alone, and PSNR."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

WINDOW, SIGMA = 11, 1.5
"""Side and standard deviation of the Gaussian window [px] (Wang et al. 2004, §III.B)."""

C1, C2 = 0.01**2, 0.03**2
"""Stabilising constants (K₁ L)², (K₂ L)² for values in [0, 1]."""

SILHOUETTE = 0.5
"""Coverage from which a pixel belongs to the object [-]."""


def ssim_map(a: Tensor, b: Tensor) -> Tensor:
    """Structural similarity around each pixel, mean over colours, shape (T, H, W), float64.

        SSIM = (2 μ_a μ_b + C₁)(2 σ_ab + C₂) / ((μ_a² + μ_b² + C₁)(σ_a² + σ_b² + C₂))

    with the moments in a Gaussian window; zeros lie beyond the border, as in the evaluation of 3D Gaussian splatting
    and of the paper. Wang et al., IEEE TIP 13:600 (2004), eq. 13.

    Args:
        a, b: frames in [0, 1], shape (T, H, W, 3).
    """
    if a.shape != b.shape or a.ndim != 4:
        raise ValueError(f"SSIM compares two clips (T, H, W, 3), got {tuple(a.shape)} and {tuple(b.shape)}")
    a, b = (x.double().permute(0, 3, 1, 2) for x in (a, b))  # (T, 3, H, W); σ² is a difference of nearly equal numbers
    channels = a.shape[1]
    at = torch.arange(WINDOW, dtype=a.dtype, device=a.device) - WINDOW // 2
    g = torch.exp(-(at**2) / (2 * SIGMA**2))
    g = (g / g.sum()).expand(channels, 1, -1)

    def mean(x: Tensor) -> Tensor:
        x = F.conv2d(x, g[..., None], padding=(WINDOW // 2, 0), groups=channels)
        return F.conv2d(x, g[:, :, None], padding=(0, WINDOW // 2), groups=channels)

    mu_a, mu_b = mean(a), mean(b)
    var_a, var_b, cov = mean(a * a) - mu_a**2, mean(b * b) - mu_b**2, mean(a * b) - mu_a * mu_b
    value = (2 * mu_a * mu_b + C1) * (2 * cov + C2) / ((mu_a**2 + mu_b**2 + C1) * (var_a + var_b + C2))
    return value.mean(1)


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Mean structural similarity of each frame, (T, H, W, 3) twice → (T,)."""
    return torch.cat([ssim_map(x, y).mean((1, 2)) for x, y in zip(a.split(1), b.split(1), strict=True)])


def ssim_object(a: Tensor, b: Tensor, cover_a: Tensor, cover_b: Tensor) -> Tensor:
    """Mean structural similarity where at least one of two objects is seen, shape (T,); NaN where none is.

    An object that fills 7 % of a white frame scores 0.88 against any other texture: the background agrees with itself.

    Args:
        cover_a, cover_b: coverage of the two objects, shape (T, H, W), in [0, 1].
    """
    values = []
    for x, y, m, n in zip(a.split(1), b.split(1), cover_a, cover_b, strict=True):
        mask = torch.maximum(m, n) > SILHOUETTE
        values.append(ssim_map(x, y)[0][mask].mean())
    return torch.stack(values)


def psnr(a: Tensor, b: Tensor) -> Tensor:
    """−10 log₁₀ mean (a − b)² of each picture (..., H, W, 3) → (...), for values in [0, 1] [dB]; ∞ where equal."""
    if a.shape != b.shape:
        raise ValueError(f"PSNR compares pictures of one shape, got {tuple(a.shape)} and {tuple(b.shape)}")
    error = (a.double() - b.double()).square().mean((-3, -2, -1))
    return -10 / math.log(10) * error.log()
