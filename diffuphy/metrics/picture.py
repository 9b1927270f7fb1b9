"""What the frames themselves show, without any model: colours, silhouettes, how they move."""

import torch
from torch import Tensor

from diffuphy.metrics.structure import SILHOUETTE


def saturation(rgb: Tensor, cover: Tensor) -> Tensor:
    """Mean HSV saturation S = (max − min)/max of the object's pixels (0 for black), of each picture, (n,).

    Distillation with strong guidance oversaturates: the mean tends to 1 (Liang et al., LucidDreamer, 2024).

    Args:
        rgb: pictures (n, H, W, 3) in [0, 1].
        cover: coverage of the object, (n, H, W); pixels above one half count. A picture without any is NaN.
    """
    high, low = rgb.amax(-1), rgb.amin(-1)
    s = torch.where(high > 0, (high - low) / high.clamp_min(torch.finfo(rgb.dtype).tiny), torch.zeros_like(high))
    return over(s, cover > SILHOUETTE)


def over(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of (n, H, W) where ``mask`` is true, (n,); NaN where it is nowhere."""
    weight = mask.to(values)
    return (values * weight).sum((1, 2)) / weight.sum((1, 2))


def area(cover: Tensor) -> Tensor:
    """Share of the picture that the object covers, (T, H, W) → (T,)."""
    return cover.mean((1, 2))


def overlap(cover: Tensor) -> Tensor:
    """Intersection over union of each frame's silhouette with the next one's, (T, H, W) → (T − 1,); NaN where both are
    empty. Near 1: hardly any motion; 0: the object jumps by more than itself."""
    mask = cover > SILHOUETTE
    both, either = (mask[1:] & mask[:-1]).sum((1, 2)), (mask[1:] | mask[:-1]).sum((1, 2))
    return both / either


def middle(cover: Tensor) -> Tensor:
    """Centre of coverage (x, y) of each frame, in shares of the picture's height, (T, H, W) → (T, 2); NaN where there
    is none."""
    _, height, width = cover.shape
    y, x = ((torch.arange(n, device=cover.device, dtype=cover.dtype) + 0.5) / height for n in (height, width))
    total = cover.sum((1, 2))
    return torch.stack([(cover.sum(1) * x).sum(1) / total, (cover.sum(2) * y).sum(1) / total], 1)
