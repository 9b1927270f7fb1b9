"""Which walls reflect, and where their planes lie.

A half-space that holds the normal direction always (slip, sticky), stands still and has its normal along an axis acts
as a mirror when its plane is a plane of nodes: the grid is shifted so that the first such wall of an axis has one, and
others of that axis are mirrors if they are a whole number of cells away. Walls that separate are not mirrors: which of
their nodes touch is decided one by one, and with friction that is the more exact way (``docs/boundaries.md``).
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from diffuphy.mpm.boundary import SLACK, Boundary, HalfSpace
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.nodes import REACH

FAR = 10**8
"""Index of a mirror plane that does not exist."""


@dataclass(frozen=True)
class Mirrors:
    """Mirror planes of a list of walls: per axis at most one on either side."""

    low: tuple[float | None, float | None, float | None] = (None, None, None)
    """Place of the plane with the matter above it [m]."""
    high: tuple[float | None, float | None, float | None] = (None, None, None)
    """Place of the plane with the matter below it [m]."""
    sticky: tuple[bool, bool, bool] = (False, False, False)
    """Whether the planes of an axis turn every component around."""
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Shift of the lattice [Δx]."""

    @property
    def any(self) -> bool:
        """Whether there is a plane at all."""
        return any(p is not None for p in (*self.low, *self.high))

    def planes(self, grid: Grid) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Index of the node plane of each axis, low and high; ∓FAR where there is none."""
        low, high = (
            tuple(
                far if p is None else round(p / grid.dx - s) - o
                for p, s, o in zip(planes, grid.shift, grid.origin, strict=True)
            )
            for planes, far in ((self.low, -FAR), (self.high, FAR))
        )
        return low, high


def mirrors(boundaries: Sequence[Boundary], dx: float) -> tuple[Mirrors, tuple[Boundary, ...]]:
    """The mirrors among some walls, and the list of walls in which those govern only the nodes that no mirror
    reaches."""
    low: list[float | None] = [None] * 3
    high: list[float | None] = [None] * 3
    sticky, shift = [False] * 3, [0.0] * 3
    rest = []
    for b in boundaries:
        axis = _axis(b)
        if axis is None:
            rest.append(b)
            continue
        assert isinstance(b, HalfSpace)
        place, up = b.point[axis], b.normal[axis] > 0
        first = low[axis] is None and high[axis] is None
        if first:
            shift[axis] = place / dx - math.floor(place / dx)
            sticky[axis] = b.kind == "sticky"
        off = place / dx - shift[axis]
        side = low if up else high
        if side[axis] is not None or abs(off - round(off)) > SLACK or sticky[axis] != (b.kind == "sticky"):
            rest.append(b)
            continue
        side[axis] = place
        rest.append(dataclasses.replace(b, reach=REACH + 0.5))
    return Mirrors(tuple(low), tuple(high), tuple(sticky), tuple(shift)), tuple(rest)  # type: ignore[arg-type]


def _axis(b: Boundary) -> int | None:
    """The axis of a wall that can be a mirror."""
    if not isinstance(b, HalfSpace) or b.kind == "separate" or not b.still or b.reach > 0.0:
        return None
    along = [k for k in range(3) if abs(b.normal[k]) == 1.0]
    return along[0] if along else None
