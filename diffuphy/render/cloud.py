"""Particles without Gaussians, to film a simulation as it is."""

import torch
from torch import Tensor

from diffuphy.render.sh import from_rgb
from diffuphy.types import Gaussians, Particles

OPACITY = 0.98
"""Of each ball: a cloud of them is opaque from its second layer on."""


def cloud(x: Tensor, vol: Tensor, rgb: Tensor) -> tuple[Gaussians, Particles]:
    """A ball for every particle: the Gaussians and particles that ``Film`` wants beside a trajectory.

        σ = ½ (mean V⁰)^⅓, so that neighbours half a diameter apart close the surface

    Args:
        x: positions at rest, shape (N, 3) [m].
        vol: rest volumes, shape (N,) [m³].
        rgb: colours in [0, 1], shape (N, 3) or (3,).

    Raises:
        ValueError: other shapes, or colours out of range.
    """
    n = len(x)
    if x.shape != (n, 3) or vol.shape != (n,) or tuple(rgb.shape) not in {(n, 3), (3,)}:
        raise ValueError(
            f"x must be (N, 3), vol (N,) and rgb (N, 3) or (3,), got {tuple(x.shape)}, {tuple(vol.shape)}, "
            f"{tuple(rgb.shape)}"
        )
    if not ((rgb >= 0) & (rgb <= 1)).all():
        raise ValueError(f"rgb must lie in [0, 1], got {float(rgb.min()):.3g} to {float(rgb.max()):.3g}")
    spacing = float(vol.double().mean()) ** (1 / 3)
    low, high = x.amin(0), x.amax(0)
    scale, middle = float((high - low).amax()) / 2 or 1.0, (low + high) / 2
    x = x.float()
    gaussians = Gaussians(
        (x - middle.float()) / scale,
        x.new_tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1),
        x.new_full((n, 3), 0.5 * spacing / scale).log(),
        torch.logit(x.new_full((n,), OPACITY)),
        from_rgb(rgb.to(x).expand(n, 3)),
    )
    offset = tuple(middle.tolist())
    return gaussians, Particles(x, vol.float(), torch.arange(n, device=x.device), scale, offset, spacing)  # type: ignore[arg-type]
