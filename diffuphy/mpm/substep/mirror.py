"""Which walls reflect, and where their planes lie.

A half-space that holds the normal direction always (slip, sticky), stands still and has its normal along an axis acts
as a mirror when its plane is a plane of nodes: the grid is shifted so that the first such wall of an axis has one, and
the one opposite is a mirror too if it is a whole number of cells away, and more than twice the reach of a mirror, so
that no node has two images along an axis. Walls that separate are not mirrors: which of
their nodes touch is decided one by one, and with friction that is the more exact way (``docs/boundaries.md``).
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.boundary import SLACK, Boundary, HalfSpace
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.substep.places import make_places
from diffuphy.mpm.substep.variant import Variant

REACH = 2
"""Nodes on either side of a mirror plane that are reflected."""

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
    walls: tuple[int, ...] = ()
    """Numbers of the walls that they belong to."""

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


Extent = tuple[Sequence[float], Sequence[float]]
"""Lowest and highest coordinates of matter [m]."""


def mirrors(
    boundaries: Sequence[Boundary], dx: float, extent: Extent | None = None
) -> tuple[Mirrors, tuple[Boundary, ...]]:
    """The mirrors among some walls, and the list of walls in which those govern only the nodes that no mirror
    reaches. A wall with matter behind it, as of a body that is clamped by its end, is none: what is behind would be
    reflected too."""
    low: list[float | None] = [None] * 3
    high: list[float | None] = [None] * 3
    sticky, shift = [False] * 3, [0.0] * 3
    rest, reflecting = [], []
    for k, b in enumerate(boundaries):
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
        side, other = (low, high)[:: 1 if up else -1]
        near = other[axis] is not None and (other[axis] - place) * (1 if up else -1) < (2 * REACH + 0.5) * dx
        if (
            side[axis] is not None
            or near
            or _behind(place, up, axis, dx, extent)
            or abs(off - round(off)) > SLACK
            or sticky[axis] != (b.kind == "sticky")
        ):
            rest.append(b)
            continue
        side[axis] = place
        reflecting.append(k)
        rest.append(dataclasses.replace(b, reach=REACH + 0.5))
    found = Mirrors(tuple(low), tuple(high), tuple(sticky), tuple(shift), tuple(reflecting))  # type: ignore[arg-type]
    return found, tuple(rest)


def _behind(place: float, up: bool, axis: int, dx: float, extent: Extent | None) -> bool:
    """Whether matter lies more than a quarter of a cell behind a plane."""
    if extent is None:
        return False
    return extent[0][axis] < place - 0.25 * dx if up else extent[1][axis] > place + 0.25 * dx


def _axis(b: Boundary) -> int | None:
    """The axis of a wall that can be a mirror."""
    if not isinstance(b, HalfSpace) or b.kind == "separate" or not b.still or b.reach > 0.0:
        return None
    along = [k for k in range(3) if abs(b.normal[k]) == 1.0]
    return along[0] if along else None


def make_reflection(v: Variant) -> SimpleNamespace:
    """Warp functions ``summed`` over lanes, ``folded`` over mirror images too, what is ``seen`` of a uniform
    acceleration, and the node in ``front`` of the planes that one is an image of. Cached."""
    return v.made(_make_reflection)


def _make_reflection(v: Variant) -> SimpleNamespace:
    real, vec3, node_t = v.real, v.vec3, v.node_t
    flat, reach = make_places().flat, REACH

    @wp.func(module="unique")
    def summed(grid: wp.array[node_t], o: wp.int32, scene: wp.int32, lanes: wp.int32, nodes: wp.int32) -> node_t:
        """Row of a node of a scene, over the lanes that particles were scattered into."""
        r = grid[scene * lanes * nodes + o]
        for lane in range(1, lanes):
            r += grid[(scene * lanes + lane) * nodes + o]
        return r

    @wp.func(module="unique")
    def image(i: wp.int32, low: wp.int32, high: wp.int32) -> wp.int32:
        """Where a mirror plane sends a node, −1 if none is near."""
        if wp.abs(i - low) <= reach:
            return 2 * low - i
        if wp.abs(i - high) <= reach:
            return 2 * high - i
        return -1

    @wp.func(module="unique")
    def signed(r: node_t, sign: vec3) -> node_t:
        """Momentum and force turned around."""
        return node_t(
            sign[0] * r[0], sign[1] * r[1], sign[2] * r[2], r[3],
            sign[0] * r[4], sign[1] * r[5], sign[2] * r[6], r[7],
        )  # fmt: skip

    @wp.func(module="unique")
    def odd(axis: wp.int32, sticky: wp.int32) -> vec3:
        """−1 for the components that a mirror plane turns around."""
        one = real(1.0)
        if sticky != 0:
            return vec3(-one, -one, -one)
        sign = vec3(one, one, one)
        sign[axis] = -one
        return sign

    @wp.func(module="unique")
    def folded(
        grid: wp.array[node_t], at: wp.vec3i, n: wp.vec3i, scene: wp.int32, lanes: wp.int32,
        low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i,
    ) -> node_t:  # fmt: skip
        """Σ over the images of a node, itself included; a corner has up to seven."""
        nodes = n[0] * n[1] * n[2]
        total = summed(grid, (at[0] * n[1] + at[1]) * n[2] + at[2], scene, lanes, nodes)
        to = wp.vec3i(image(at[0], low[0], high[0]), image(at[1], low[1], high[1]), image(at[2], low[2], high[2]))
        if to[0] < 0 and to[1] < 0 and to[2] < 0:
            return total
        for c in range(1, 8):
            x, y, z = c & 1, (c >> 1) & 1, (c >> 2) & 1
            if (x == 0 or to[0] >= 0) and (y == 0 or to[1] >= 0) and (z == 0 or to[2] >= 0):
                i, j, k = at[0], at[1], at[2]
                sign = vec3(real(1.0), real(1.0), real(1.0))
                if x == 1:
                    i = to[0]
                    sign = wp.cw_mul(sign, odd(0, sticky[0]))
                if y == 1:
                    j = to[1]
                    sign = wp.cw_mul(sign, odd(1, sticky[1]))
                if z == 1:
                    k = to[2]
                    sign = wp.cw_mul(sign, odd(2, sticky[2]))
                o = flat(i, j, k, n)
                if o >= 0:
                    total += signed(summed(grid, o, scene, lanes, nodes), sign)
        return total

    @wp.func(module="unique")
    def side(i: wp.int32, low: wp.int32, high: wp.int32) -> real:
        """1 in front of the mirror planes of an axis, 0 on them, −1 behind."""
        if i == low or i == high:
            return real(0.0)
        if i < low or i > high:
            return real(-1.0)
        return real(1.0)

    @wp.func(module="unique")
    def seen(g: vec3, at: wp.vec3i, low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i) -> vec3:
        """A uniform acceleration as its mirror images make it at a node."""
        for axis in range(3):
            q = side(at[axis], low[axis], high[axis])
            if sticky[axis] != 0:
                g = q * g
            else:
                g[axis] = q * g[axis]
        return g

    @wp.func(module="unique")
    def front(at: wp.vec3i, low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i):
        """The node in front of all mirror planes that a node is the image of, and the signs of its components."""
        to, sign = wp.vec3i(at[0], at[1], at[2]), vec3(real(1.0), real(1.0), real(1.0))
        for axis in range(3):
            if at[axis] < low[axis] or at[axis] > high[axis]:
                plane = wp.where(at[axis] < low[axis], low[axis], high[axis])
                to[axis] = 2 * plane - at[axis]
                sign = wp.cw_mul(sign, odd(axis, sticky[axis]))
        return to, sign

    return SimpleNamespace(summed=summed, folded=folded, seen=seen, front=front)
