"""What the optimisation starts from."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.params import nearest_distance
from diffuphy.types import N_SH, Gaussians, Look


@dataclass(frozen=True)
class Ball:
    """Grey Gaussians that fill a ball evenly: for priors that know no geometry."""

    count: int = 3000
    """Number of Gaussians to start with."""
    radius: float = 0.9
    """[object units]; the object is 2 long."""
    opacity: float = 0.3
    """Low enough that gradients reach the back, high enough to be seen."""

    def __post_init__(self) -> None:
        _check(self.count, self.opacity)

    def __call__(self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0) -> Gaussians:
        d = torch.randn(self.count, 3, generator=generator)
        r = self.radius * torch.rand(self.count, 1, generator=generator) ** (1 / 3)
        return cloud(d / d.norm(dim=1, keepdim=True) * r, None, self.opacity, sh_degree)


@dataclass(frozen=True)
class SurfaceCloud:
    """Points on the surface that the prior's object has, blurred; a ``Ball`` where the prior has no object.

    The place of Point-E in the paper: a rough cloud, not the answer. Colours start grey.
    """

    count: int = 3000
    """Number of Gaussians to start with."""
    noise: float = 0.05
    """Standard deviation of the blur of positions [object units]."""
    opacity: float = 0.7
    """A surface is opaque: 0.7 ends 0.3 dB higher and with twice the opacity of 0.3."""
    coloured: bool = False
    """Start from the object's colours instead of grey."""

    def __post_init__(self) -> None:
        _check(self.count, self.opacity)
        if self.noise < 0:
            raise ValueError(f"noise must not be negative, got {self.noise}")

    def __call__(self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0) -> Gaussians:
        library: Any = getattr(guidance, "references", None)
        if not hasattr(library, "object"):
            return Ball(self.count, opacity=self.opacity)(look, guidance, generator, sh_degree)
        points, colours = library.object(look).surface(self.count, generator)
        points = points.float() + self.noise * torch.randn(self.count, 3, generator=generator)
        return cloud(points, colours.float() if self.coloured else None, self.opacity, sh_degree)


def cloud(points: Tensor, colours: Tensor | None, opacity: float, sh_degree: int) -> Gaussians:
    """Round Gaussians at ``points`` (n, 3), as wide as the distance to the third neighbour; rgb (n, 3), or mid grey."""
    n = len(points)
    scale = nearest_distance(points, k=3).clamp_min(1e-4)
    quats = torch.zeros(n, 4)
    quats[:, 0] = 1
    sh = torch.zeros(n, N_SH[sh_degree], 3)
    if colours is not None:
        sh[:, :1] = from_rgb(colours)
    return Gaussians(
        means=points,
        quats=quats,
        log_scales=scale.log()[:, None].repeat(1, 3),
        logit_opacities=torch.full((n,), math.log(opacity / (1 - opacity))),
        sh=sh,
    )


def _check(count: int, opacity: float) -> None:
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    if not 0 < opacity < 1:
        raise ValueError(f"opacity must be in (0, 1), got {opacity}")
