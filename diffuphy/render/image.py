"""What a rasteriser is given and what it answers."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from diffuphy.types import Camera


@dataclass(frozen=True)
class Image:
    """C views of a set of G Gaussians, premultiplied: everything is weighted by the coverage α T and stands on
    black."""

    rgb: Tensor
    """Colour, shape (C, H, W, 3)."""
    alpha: Tensor
    """Coverage 1 - Π(1 - α), shape (C, H, W)."""
    depth: Tensor
    """Distance along the optical axis times coverage, in the unit of the means, shape (C, H, W)."""
    means2d: Tensor
    """Projected centres, shape (C, G, 2) [px]; after a backward pass ``means2d.grad`` is what densification
    thresholds."""

    def over(self, background: Tensor) -> Tensor:
        """Colour over a background of shape (3,), (H, W, 3) or (C, H, W, 3): rgb + (1 - alpha) background."""
        return self.rgb + (1 - self.alpha)[..., None] * background


class Rasteriser(Protocol):
    """Draws Gaussians with covariance Σ = F R S² Rᵀ Fᵀ; operands as in :func:`diffuphy.render.rasterize`, already
    checked."""

    def __call__(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        camera: Camera,
        F: Tensor | None = None,
    ) -> Image: ...


def check(fields: dict[str, Tensor], shapes: dict[str, tuple[tuple[int, ...], ...]]) -> None:
    """Raise ValueError at the first field of wrong shape, type, device or range, or with a value that is not finite.

    Args:
        fields: operands by name; the first gives dtype and device.
        shapes: shapes allowed for each name.
    """
    first = next(iter(fields.values()))
    for name, value in fields.items():
        if tuple(value.shape) not in shapes[name]:
            allowed = " or ".join(str(s) for s in shapes[name])
            raise ValueError(f"{name} must have shape {allowed}, got {tuple(value.shape)}")
        if value.dtype != first.dtype or value.device != first.device:
            raise ValueError(
                f"{name} must be {first.dtype} on {first.device} as means is, got {value.dtype} on {value.device}; "
                "move all operands to one dtype and device"
            )
    with torch.no_grad():
        # a sum is not finite if one of its terms is not: one number a field, one synchronisation for all
        sums = torch.stack([value.sum() for value in fields.values()])
        if torch.isfinite(sums).all():
            return
    for name, value in fields.items():
        if not (finite := torch.isfinite(value)).all():
            index = tuple((~finite).nonzero()[0].tolist())
            raise ValueError(f"{name}{list(index)} is {value[index].item()}; every operand of rasterize must be finite")


def check_ranges(quats: Tensor, opacities: Tensor) -> None:
    """Raise ValueError at the first quaternion of length zero or opacity outside [0, 1]."""
    with torch.no_grad():
        length = torch.linalg.vector_norm(quats, dim=1)
        good = (length > 0) & (opacities >= 0) & (opacities <= 1)
        if good.all():
            return
        i = int((~good).nonzero()[0])
    if not length[i] > 0:
        raise ValueError(f"quats[{i}] has length zero and is no rotation; use (1, 0, 0, 0) for the identity")
    raise ValueError(f"opacities[{i}] must be in [0, 1], got {opacities[i].item()}; pass a sigmoid of the logits")
