"""What the optimisation starts from. ``device`` is where a network works, if one is asked; the start is on the CPU."""

import dataclasses
import logging
import math
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.params import nearest_distance
from diffuphy.text2gs.shape_prior import four_sides
from diffuphy.types import N_SH, Camera, Gaussians, Look

log = logging.getLogger(__name__)

Device = torch.device | str


class Start(Protocol):
    """What an optimisation may start from."""

    def __call__(
        self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0, *, device: Device = "cpu"
    ) -> Gaussians:
        """Gaussians in the frame of the object, on the CPU."""
        ...


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

    def __call__(
        self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0, *, device: Device = "cpu"
    ) -> Gaussians:
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

    def __call__(
        self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0, *, device: Device = "cpu"
    ) -> Gaussians:
        library: Any = getattr(guidance, "references", None)
        if not hasattr(library, "object"):
            return Ball(self.count, opacity=self.opacity)(look, guidance, generator, sh_degree)
        points, colours = library.object(look).surface(self.count, generator)
        points = points.float() + self.noise * torch.randn(self.count, 3, generator=generator)
        return cloud(points, colours.float() if self.coloured else None, self.opacity, sh_degree)


class CloudSampler(Protocol):
    """A prior that draws clouds of an object, as Point-E does."""

    @property
    def count(self) -> int:
        """Points of a cloud."""
        ...

    def sample(
        self, words: Look, camera: Camera, generator: torch.Generator, device: Device = "cpu"
    ) -> tuple[Tensor, Tensor]:
        """Positions (n, 3) and rgb (n, 3) in [0, 1]; the object faces +x, z is up."""
        ...


@dataclass(frozen=True)
class PointECloud:
    """A cloud that a point prior draws for the words, or for pictures of the object: the start of DiffuPhyGS (§3.3).

    It is drawn by a copy of the prior, which is freed with its networks.
    """

    prior: CloudSampler
    """Who draws it: ``losses.guidance.point_e.PointE``. Its painter, if any, shows it the object from four sides."""
    length: float = 2.0
    """Longest side of the cloud [object units]; the object is 2 long."""
    opacity: float = 0.8
    """gsgen's."""
    coloured: bool = True
    """Start from the cloud's colours instead of grey."""

    def __post_init__(self) -> None:
        _check(1, self.opacity)
        if self.length <= 0:
            raise ValueError(f"length must be positive, got {self.length}")

    @property
    def count(self) -> int:
        """Number of Gaussians to start with."""
        return self.prior.count

    def __call__(
        self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0, *, device: Device = "cpu"
    ) -> Gaussians:
        prior = dataclasses.replace(self.prior) if dataclasses.is_dataclass(self.prior) else self.prior  # type: ignore[type-var]
        points, colours = (x.cpu() for x in prior.sample(look, four_sides(), generator, device))
        low, high = points.aminmax(dim=0)
        points = (points - (low + high) / 2) * (self.length / (high - low).max())
        return cloud(points, colours if self.coloured else None, self.opacity, sh_degree)


def ball(count: int = 3000, radius: float = 0.9, opacity: float = 0.3, **other: Any) -> Ball:
    """The ``Ball`` of a configuration that another start was configured in before.

    Args:
        count, radius, opacity: of ``Ball``.
        other: settings of that start, which presets of whole runs change; they are logged, and change nothing.
    """
    _unused(other, "the start is a ball")
    return Ball(count, radius, opacity)


def _unused(settings: dict[str, Any], why: str) -> None:
    if given := [name for name, value in settings.items() if value is not None]:
        log.info("fit.init: %s not used: %s", ", ".join(given), why)


def point_e(
    prior: CloudSampler, length: float = 2.0, opacity: float = 0.8, coloured: bool = True, **cloud: Any
) -> PointECloud:
    """The ``PointECloud`` of a configuration.

    Args:
        prior, length, opacity, coloured: of ``PointECloud``.
        cloud: settings of other starts, which presets of whole runs change; they are logged, and change nothing.
    """
    _unused(cloud, "the prior draws the cloud")
    return PointECloud(prior, length, opacity, coloured)


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
