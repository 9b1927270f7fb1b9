"""The work of a simulation, counted: what a rollout does, in units whose price is measured.

    forward     Σ_rounds [ round + N particle(order) + M node + N Σ_k law(k) ]  +  Σ_frames [ frame + N frame.particle ]
    backward    the rounds again, with prices of their own

N particles, M nodes of the block. Every particle pays for every law of the mixture, whatever its weight.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.material.branch import BRANCHES
from diffuphy.mpm import Scheme

Work = dict[str, float]
"""Unit → how often."""

AROUND = 5
"""Nodes of a block beyond the cells of a body along each axis: the reach of a spline, and the way of a frame [-]."""


def add(*parts: Mapping[str, float]) -> Work:
    """The sum of some work."""
    total: Work = {}
    for part in parts:
        for unit, count in part.items():
            total[unit] = total.get(unit, 0.0) + count
    return total


def times(count: float, work: Mapping[str, float]) -> Work:
    """The same work ``count`` times."""
    return {unit: count * n for unit, n in work.items()}


def block(extent: tuple[float, float, float], dx: float) -> float:
    """Nodes around a body whose sides are ``extent`` [m]."""
    return math.prod(side / dx + AROUND for side in extent)


@dataclass(frozen=True)
class Laws:
    """The laws of a mixture, as far as they cost something."""

    elastic: tuple[str, ...]
    """Names in ``ELASTIC``."""
    plastic: tuple[str, ...]
    """Names in ``PLASTIC`` other than the identity."""
    branches: tuple[str, ...] = ()
    """Names in ``BRANCHES``."""

    @classmethod
    def of(cls, elastic: tuple[str, ...], plastic: tuple[str, ...], branches: tuple[str, ...] = ()) -> Self:
        """Those of these names that do something."""
        return cls(tuple(elastic), tuple(p for p in plastic if not PLASTIC[p].is_identity), tuple(branches))

    @classmethod
    def of_mixture(cls, mixture: Any) -> Self:
        """Those of ``material.make_mixture``."""
        return cls.of(mixture.laws_e, mixture.laws_p, mixture.branches)

    @property
    def decomposes(self) -> bool:
        """Whether a principal frame is computed, as in ``material.make_mixture``."""
        return bool(self.plastic) or not all(ELASTIC[name].is_direct for name in self.elastic)

    @property
    def params(self) -> int:
        """Number of parameters a particle has."""
        registered = [(ELASTIC, self.elastic), (PLASTIC, self.plastic), (BRANCHES, self.branches)]
        return len({p.name for registry, names in registered for n in names for p in registry[n].params})

    @property
    def memory(self) -> int:
        """Numbers that some law remembers."""
        return len({m for name in self.plastic for m in PLASTIC[name].memory})

    def units(self) -> Work:
        """What a particle pays a round."""
        form = "law" if self.decomposes else "direct"
        names = [*(f"{form}.{name}" for name in self.elastic), *(f"law.{n}" for n in (*self.plastic, *self.branches))]
        return dict.fromkeys([*names, *["decompose"] * self.decomposes], 1.0)


def transfer(scheme: Scheme, double: bool) -> tuple[str, str]:
    """Units of the transfer of a particle and of the passes over a node."""
    kind = ".double" if double else ""
    return f"particle.order{scheme.order}{kind}", f"node.{'two' if two_passes(scheme) else 'one'}{kind}"


def two_passes(scheme: Scheme) -> bool:
    """Whether nodes are gone through twice forward; a backward pass always does."""
    return scheme.sharpen or scheme.mirror or scheme.contact == "elastic"


def forward(
    particles: float, rounds: float, frames: float, nodes: float, laws: Laws, scheme: Scheme, *,
    double: bool = False,
) -> Work:  # fmt: skip
    """A simulation of ``frames`` frames with ``rounds`` rounds in all."""
    particle, node = transfer(scheme, double)
    each = times(particles * rounds, laws.units() | {particle: 1.0})
    return each | {"round": rounds, node: nodes * rounds, "frame": frames, "frame.particle": frames * particles}


def backward(
    particles: float, rounds: float, nodes: float, laws: Laws, scheme: Scheme, *,
    kept: bool, double: bool = False,
) -> Work:  # fmt: skip
    """The gradient of the same, from states that were kept or by running every frame again."""
    particle, node = transfer(scheme, double)
    each = times(particles * rounds, laws.units() | {particle: 1.0})
    work = {f"back.{unit}": n for unit, n in (each | {"round": rounds, node: nodes * rounds}).items()}
    again = forward(particles, rounds, 0.0, nodes, laws, scheme, double=double)
    return work if kept else add(work, again)


def row_bytes(laws: Laws, double: bool) -> int:
    """Memory of a particle's state in one row: u, v, C, He, H, what laws remember, and a viscous branch [byte]."""
    numbers = 3 + 3 + 9 + 9 + 9 * bool(laws.plastic) + laws.memory + 9 * bool(laws.branches)
    return numbers * (8 if double else 4)


def matter_bytes(laws: Laws, double: bool) -> int:
    """Memory of a particle's weights, parameters, mass and rest volume [byte]."""
    return (len(laws.elastic) + max(1, len(laws.plastic)) + laws.params + 2) * (8 if double else 4)


def node_bytes(scheme: Scheme, double: bool, *, grad: bool = False) -> int:
    """Memory of the rows of a node: momentum, velocity, between two passes, sharpening; with ``grad`` theirs too
    [byte]. A row has eight numbers (``mpm.transfer``)."""
    rows = 2 + (two_passes(scheme) or grad) + scheme.sharpen + grad * (3 + scheme.sharpen)
    return rows * 8 * (8 if double else 4)
