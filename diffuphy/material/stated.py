"""The material stage for matter that is known: laws and parameters written out, region by region, nothing is fitted."""

import logging
import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch

from diffuphy.material.elastic import ELASTIC
from diffuphy.material.expert import Param
from diffuphy.material.field import Hypothesis, warm_start
from diffuphy.material.moduli import check
from diffuphy.material.plastic import PLASTIC
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles

log = logging.getLogger(__name__)

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Piece:
    """What the particles in a box are made of."""

    elastic: str
    """Elastic law, a key of ``ELASTIC``."""
    plastic: str
    """Plastic law, a key of ``PLASTIC``."""
    rho: float
    """Density [kg/m³]."""
    theta: dict[str, float] = field(default_factory=dict)
    """Parameters that the two laws read, by name [SI]."""
    low: Vec | None = None
    """Lowest corner of the box, in the frame of the particles [m]; None: no bound."""
    high: Vec | None = None
    """Highest corner [m]."""

    def __post_init__(self) -> None:
        for name, registry in ((self.elastic, ELASTIC), (self.plastic, PLASTIC)):
            if name not in registry:
                raise ValueError(f"unknown law {name!r}; known: {', '.join(registry)}")
        if missing := [p.name for p in self.params if p.name not in self.theta]:
            raise ValueError(f"{self.elastic} with {self.plastic} needs {', '.join(missing)} in theta [SI]")
        if surplus := sorted(set(self.theta) - {p.name for p in self.params}):
            raise ValueError(f"{self.elastic} with {self.plastic} reads no {surplus[0]!r}; leave it out of theta")
        if not 0.0 < self.rho < math.inf:
            raise ValueError(f"rho must be positive and finite, got {self.rho} kg/m³")
        if "E" in self.theta and "nu" in self.theta:
            check({k: torch.tensor(self.theta[k], dtype=torch.float64) for k in ("E", "nu")})
        for name in ("low", "high"):
            if (corner := getattr(self, name)) is not None:
                object.__setattr__(self, name, tuple(float(c) for c in corner))
        for a, b in zip(self.low or (-math.inf,) * 3, self.high or (math.inf,) * 3, strict=True):
            if not a < b:
                raise ValueError(f"a piece needs low < high along every axis, got {self.low} and {self.high} m")

    @property
    def params(self) -> tuple[Param, ...]:
        """Parameters its two laws read."""
        return tuple({p.name: p for p in (*ELASTIC[self.elastic].params, *PLASTIC[self.plastic].params)}.values())

    def contains(self, x: torch.Tensor) -> torch.Tensor:
        """Mask of the points in the box, (N, 3) → (N,)."""
        inside = torch.ones(len(x), dtype=torch.bool, device=x.device)
        if self.low is not None:
            inside &= (x > x.new_tensor(self.low)).all(1)
        if self.high is not None:
            inside &= (x < x.new_tensor(self.high)).all(1)
        return inside


@dataclass(frozen=True)
class StatedMaterial:
    """Matter whose laws and parameters are given; a particle is of the last piece that it lies in."""

    VERSION: ClassVar[int] = 1

    pieces: tuple[Piece, ...]
    """What there is; the first has no box."""
    elastic: tuple[str, ...] = ()
    """Elastic laws of the result; () those of the pieces."""
    plastic: tuple[str, ...] = ()
    """Plastic laws of the result; () those of the pieces."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "pieces", tuple(self.pieces))
        if not self.pieces:
            raise ValueError("a stated material needs at least one piece")
        if self.pieces[0].low is not None or self.pieces[0].high is not None:
            raise ValueError("the first piece is what no other piece takes: it has no low and high")
        for kind in ("elastic", "plastic"):
            own = dict.fromkeys(getattr(p, kind) for p in self.pieces)
            object.__setattr__(self, kind, tuple(getattr(self, kind)) or tuple(own))

    def __call__(
        self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles, *, work: Any
    ) -> MaterialField:
        """The material of all particles: one-hot, with the parameters of their pieces.

        A parameter that a piece's own laws do not read is that of the first piece that has it.

        Raises:
            ValueError: a piece in which no particle lies.
        """
        label = torch.zeros(len(particles), dtype=torch.long, device=particles.x.device)
        for k, piece in enumerate(self.pieces):
            label[inside := piece.contains(particles.x)] = k
            if not bool(inside.any()):
                raise ValueError(
                    f"pieces[{k}] holds none of the {len(particles)} particles: {piece.low} to {piece.high} m; the "
                    "origin is the middle of the object"
                )
        return self._field(label)

    def expected(self, motion: Motion, share: float = 1.0) -> MaterialField:
        """What a forecast is made with: one row for each piece."""
        return self._field(torch.arange(len(self.pieces)))

    def _field(self, label: torch.Tensor) -> MaterialField:
        known = {name: value for p in reversed(self.pieces) for name, value in p.theta.items()}
        matter = [Hypothesis(p.elastic, p.plastic, known | p.theta, p.rho) for p in self.pieces]
        return warm_start(self.elastic, self.plastic, label, matter)


def stated(
    pieces: tuple[Piece, ...], elastic: tuple[str, ...] = (), plastic: tuple[str, ...] = (), **fitting: Any
) -> StatedMaterial:
    """The stated material of a configuration.

    Args:
        pieces, elastic, plastic: of ``StatedMaterial``.
        fitting: settings of a fit, which presets of whole runs change; they are logged, and change nothing.
    """
    if fitting:
        log.info("material: %s not used: the material is stated, nothing is fitted", ", ".join(fitting))
    return StatedMaterial(pieces, elastic, plastic)
