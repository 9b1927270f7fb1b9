"""Where the Gaussians are, judged by a prior of shapes: the second term of DiffuPhyGS, eq. 2."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.losses import sds
from diffuphy.losses.guidance import Guidance
from diffuphy.losses.sds import Weight
from diffuphy.render import orbit
from diffuphy.render.sh import to_rgb
from diffuphy.types import Camera, Gaussians, Look


def four_sides(size: int = 256) -> Camera:
    """Cameras in front, left, behind and right of an object, 15° above it as in MVDream's own example
    (``scripts/t2i.py``): from where a prior of several views is asked for pictures."""
    return orbit([0.0, 90.0, 180.0, 270.0], 15.0, 3.4, fov=40.0, width=size, height=size)


def farthest_points(x: Tensor, count: int, start: Tensor) -> Tensor:
    """Indices (B, count) of points spread evenly: each is the farthest from all before it (Eldar et al. 1997).

    Args:
        x: points (n, 3), n ≥ count.
        start: first index of each of B subsets, shape (B,).
    """
    if count > len(x):
        raise ValueError(f"{count} points cannot be chosen from {len(x)}")
    chosen = torch.empty(len(start), count, dtype=torch.int64, device=x.device)
    chosen[:, 0] = start.to(x.device)
    nearest = torch.full((len(start), len(x)), torch.inf, dtype=x.dtype, device=x.device)
    for i in range(1, count):
        last = x[chosen[:, i - 1]]  # (B, 3)
        nearest = torch.minimum(nearest, (x[None] - last[:, None]).square().sum(-1))
        chosen[:, i] = nearest.argmax(1)
    return chosen


@dataclass(frozen=True)
class ShapePrior:
    """Score distillation of a point prior into the positions of the Gaussians.

        λ E_{t, ε}[w(t) (ε̂(x_t; y, t) − ε) ∂x/∂θ]

    DiffuPhyGS, eq. 2; x are the means of an evenly spread subset, as many as the prior was trained with.
    """

    VERSION: ClassVar[int] = 1

    guidance: Guidance
    """The prior; its layout must be "points"."""
    weight: float = 0.1
    """λ_MV3D, against 1 of the image term: the paper's. gsgen's two weights, 0.01 and 0.1, have the same ratio."""
    stop: int | float = 2000
    """The term acts before this step (int) or share of the run (float): a rough shape is all that it knows, say the
    authors of gsgen, which stops it there."""
    points: int = 1024
    """Points judged together, fewer if there are fewer Gaussians."""
    copies: int = 1
    """Subsets a step, each with its own time, noise and view; their mean is the gradient."""
    t_min: float = 0.02
    """Lower end of the diffusion times drawn."""
    t_max: float = 0.98
    """Upper end."""
    estimate_weight: Weight = "sigma2"
    """w(t)."""
    colours: bool = False
    """Whether colours follow too; pictures know them better."""

    def __post_init__(self) -> None:
        if self.guidance.layout != "points":
            raise ValueError(f"a shape prior judges points; guidance of layout {self.guidance.layout!r} cannot")
        if self.weight <= 0:
            raise ValueError(f"weight must be positive, got {self.weight}; leave the term out with fit.shape=null")
        if self.points < 2 or self.copies < 1:
            raise ValueError(f"points must be ≥ 2 and copies ≥ 1, got {self.points} and {self.copies}")
        if not 0 < self.t_min <= self.t_max < 1:
            raise ValueError(f"0 < t_min ≤ t_max < 1 must hold, got {self.t_min} and {self.t_max}")
        if self.stop <= 0 or (isinstance(self.stop, float) and self.stop > 1):
            raise ValueError(f"stop must be a number of steps (int) or a share of the run in (0, 1], got {self.stop!r}")

    def acts(self, step: int, total: int) -> bool:
        """Whether step ``step`` (counted from 0) of ``total`` has the term."""
        return step < (self.stop if isinstance(self.stop, int) else self.stop * total)

    def prepare(self, look: Look, device: torch.device | str) -> None:
        """Let the prior paint and read what it will look at, before the networks of the pictures fill the memory."""
        self._condition(look, torch.device(device), torch.Generator())

    def _condition(self, look: Look, device: torch.device, generator: torch.Generator) -> Any:
        return self.guidance.condition(look, four_sides(), torch.ones(3, device=device), generator=generator)

    def loss(self, gaussians: Gaussians, look: Look, generator: torch.Generator) -> Tensor:
        """Scalar whose gradient is that of the term, λ included. All that is random comes from ``generator``."""
        x = gaussians.means
        start = torch.randint(len(x), (self.copies,), generator=generator, device=generator.device)
        index = farthest_points(x.detach(), min(self.points, len(x)), start)
        rgb = to_rgb(gaussians.sh)
        rgb = rgb if self.colours else rgb.detach()
        cond = self._condition(look, x.device, generator)
        t = self.t_min + (self.t_max - self.t_min) * torch.rand(
            self.copies, generator=generator, device=generator.device
        )
        sample = torch.cat([x[index], rgb[index]], -1)
        value = sds(self.guidance, sample, cond, t=t.to(x.device), generator=generator, weight=self.estimate_weight)
        return self.weight / self.copies * value
