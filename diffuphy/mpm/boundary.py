"""Walls that act on the grid: half-spaces and balls; sticky, slipping or separating, with Coulomb friction, still or
moving.

A node i with signed distance φ(x_i) ≤ −reach·Δx to the surface belongs to the wall. With the velocity relative to the
wall u = v_i − V, u_n = u·n and u_t = u − u_n n (n points out of the wall, into the material):

    sticky      u ← 0
    slip        u ← u_t                                          always (bilateral)
    separate    u ← u_t max(0, 1 − μ |u_n| / |u_t|)  if u_n < 0, else unchanged

The last line is Coulomb's law for the impulse: the normal impulse m |u_n| allows a tangential one of at most μ m |u_n|.
``docs/boundaries.md`` says where the wall lies relative to the nodes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import SimpleNamespace
from typing import Literal

import numpy as np
import warp as wp

from diffuphy.mpm.grid import Grid

Kind = Literal["sticky", "slip", "separate"]
Vec = tuple[float, float, float]

SLACK = 1e-3
"""A node this close in front of a wall still belongs to it [Δx]: a wall on a plane of nodes, as a floor at z = 0 is,
would otherwise take or lose that plane, and with it a whole Δx of height, by the rounding of a coordinate."""

N_WALL = 9
"""Numbers that describe a wall to a kernel: normal or centre (3), offset or radius, velocity (3), friction, 1 while
it acts."""


def _vector(name: str, value: Sequence[float]) -> Vec:
    if len(value) != 3 or not all(math.isfinite(c) for c in value):
        raise ValueError(f"{name} must be three finite numbers, got {tuple(value)}")
    return (float(value[0]), float(value[1]), float(value[2]))


@dataclass(frozen=True, kw_only=True)
class _Wall:
    """What every wall has."""

    kind: Kind = "separate"
    """"sticky" holds, "slip" holds the normal direction only, "separate" pushes but never pulls."""
    friction: float = 0.0
    """Coulomb coefficient μ [-] of a separating wall."""
    velocity: Vec = (0.0, 0.0, 0.0)
    """Velocity of the wall [m/s]; it moves with it while it acts."""
    start: float = 0.0
    """Time at which the wall appears, at the place its other fields say [s]."""
    end: float = math.inf
    """Time at which it vanishes [s]."""
    reach: float = 0.0
    """How far behind the surface the governed nodes begin [Δx]. With 0 a body at rest lies on the surface, but an
    elastic one that falls is turned back 0.3 to 0.9 Δx above it, since nodes are felt from 1.5 Δx away; see
    ``docs/boundaries.md``."""

    def __post_init__(self) -> None:
        if self.kind not in ("sticky", "slip", "separate"):
            raise ValueError(f"kind must be 'sticky', 'slip' or 'separate', got {self.kind!r}")
        if not 0.0 <= self.friction < math.inf:
            raise ValueError(f"friction must be finite and not negative, got {self.friction}")
        if self.friction > 0 and self.kind != "separate":
            raise ValueError(
                f"friction = {self.friction} needs kind='separate', got {self.kind!r}: a sticky wall holds anyway, a "
                "slip wall has none"
            )
        if not self.start < self.end:
            raise ValueError(f"a wall needs start < end, got start = {self.start}, end = {self.end} s")
        if not self.reach >= 0.0:
            raise ValueError(f"reach must not be negative, got {self.reach} dx")
        object.__setattr__(self, "velocity", _vector("velocity", self.velocity))

    @property
    def speed(self) -> float:
        """|V| [m/s]."""
        return math.hypot(*self.velocity)

    @property
    def still(self) -> bool:
        """True when nothing about the wall depends on time."""
        return self.speed == 0.0 and self.start <= 0.0 and self.end == math.inf


@dataclass(frozen=True, kw_only=True)
class HalfSpace(_Wall):
    """Everything on the far side of a plane: a floor, an incline, a press.  φ(x) = (x − point)·normal."""

    point: Vec = (0.0, 0.0, 0.0)
    """A point of the plane [m]."""
    normal: Vec = (0.0, 0.0, 1.0)
    """Direction out of the wall; any length but 0."""

    def __post_init__(self) -> None:
        super().__post_init__()
        normal, point = _vector("normal", self.normal), _vector("point", self.point)
        length = math.hypot(*normal)
        if length == 0.0:
            raise ValueError(f"normal must not be zero, got {self.normal}")
        object.__setattr__(self, "normal", tuple(c / length for c in normal))
        object.__setattr__(self, "point", point)


@dataclass(frozen=True, kw_only=True)
class Sphere(_Wall):
    """A solid ball.  φ(x) = |x − center| − radius."""

    center: Vec = field(default=(0.0, 0.0, 0.0))
    """Centre [m] at time ``start``."""
    radius: float = 0.1
    """Radius [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.radius < math.inf:
            raise ValueError(f"radius must be positive and finite, got {self.radius} m")
        object.__setattr__(self, "center", _vector("center", self.center))


Boundary = HalfSpace | Sphere
Signature = tuple[tuple[str, str, bool], ...]


def signature(boundaries: Sequence[Boundary]) -> Signature:
    """What is compiled into the kernels: shape, kind and whether there is friction; everything else is data."""
    return tuple((type(b).__name__, b.kind, b.friction > 0.0) for b in boundaries)


def rows(boundaries: Sequence[Boundary], grid: Grid, times: np.ndarray) -> np.ndarray:
    """The walls as data, shape (steps, walls, N_WALL), lengths from the lowest node of ``grid`` [m].

    Args:
        times: start of each step [s], float64; one row suffices when every wall is still.
    """
    out = np.zeros((len(times), len(boundaries), N_WALL))
    low = np.asarray(grid.origin, dtype=np.float64) * grid.dx
    for k, b in enumerate(boundaries):
        V = np.asarray(b.velocity)
        place = np.asarray(b.point if isinstance(b, HalfSpace) else b.center) + (times - b.start)[:, None] * V - low
        if isinstance(b, HalfSpace):
            out[:, k, :3] = b.normal
            out[:, k, 3] = place @ np.asarray(b.normal) - (b.reach - SLACK) * grid.dx
        else:
            out[:, k, :3] = place
            out[:, k, 3] = b.radius - (b.reach - SLACK) * grid.dx
        out[:, k, 4:7], out[:, k, 7] = V, b.friction
        out[:, k, 8] = (times >= b.start) & (times < b.end)
    return out


@lru_cache
def _make_wall(shape: str, kind: str, rough: bool, real: type) -> tuple[wp.Function, wp.Function]:
    """Warp functions of one wall: the velocity after it, and the adjoint of that."""
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)
    ball, sticky, slip = shape == "Sphere", kind == "sticky", kind == "slip"

    @wp.func(module="unique")
    def surface(w: wall_t, r: vec3):
        """Normal, and φ + reach·Δx."""
        n = vec3(w[0], w[1], w[2])
        if wp.static(not ball):
            return n, wp.dot(n, r) - w[3]
        e = r - n
        d = wp.length(e)
        n = vec3(real(0.0), real(0.0), real(1.0))
        if d > real(0.0):
            n = e / d
        return n, d - w[3]

    @wp.func(module="unique")
    def act(v: vec3, r: vec3, w: wall_t) -> vec3:
        n, phi = surface(w, r)
        if phi > real(0.0) or w[8] == real(0.0):
            return v
        V = vec3(w[4], w[5], w[6])
        if wp.static(sticky):
            return V
        u = v - V
        u_n = wp.dot(u, n)
        if wp.static(not slip):
            if u_n >= real(0.0):
                return v
        t = u - u_n * n
        if wp.static(rough):
            length = wp.length(t)
            drag = -w[7] * u_n
            if drag >= length:
                return V
            t = t * (real(1.0) - drag / length)
        return V + t

    @wp.func(module="unique")
    def act_adjoint(v: vec3, r: vec3, w: wall_t, o_bar: vec3) -> vec3:
        n, phi = surface(w, r)
        if phi > real(0.0) or w[8] == real(0.0):
            return o_bar
        if wp.static(sticky):
            return vec3()
        u = v - vec3(w[4], w[5], w[6])
        u_n = wp.dot(u, n)
        if wp.static(not slip):
            if u_n >= real(0.0):
                return o_bar
        if wp.static(rough):
            # o = t (1 + μ u_n/|t|):  do = dt (1 + μ u_n/|t|) + t (μ du_n/|t| − μ u_n t·dt/|t|³)
            t = u - u_n * n
            length = wp.length(t)
            k = w[7] * u_n / length
            if length <= -w[7] * u_n:
                return vec3()
            e = t / length
            along = wp.dot(e, o_bar)
            t_bar = (real(1.0) + k) * o_bar - (k * along) * e
            return t_bar - wp.dot(t_bar, n) * n + (w[7] * along) * n
        return o_bar - wp.dot(o_bar, n) * n

    return act, act_adjoint


@lru_cache
def make_contact(walls: Signature, real: type) -> SimpleNamespace:
    """Warp functions ``apply(v, r, row, s)`` and ``adjoint(v, r, row, s, v_bar)`` for one list of walls, which act
    in order.

    ``r`` is the node from the lowest node of the grid [m], ``row`` the wall data, ``s`` the row of this step. The
    adjoint is with respect to the velocity before the walls; walls themselves are data.
    """
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)
    if not walls:

        @wp.func(module="unique")
        def apply(v: vec3, r: vec3, row: wp.array2d[wall_t], s: wp.int32) -> vec3:
            return v

        @wp.func(module="unique")
        def adjoint(v: vec3, r: vec3, row: wp.array2d[wall_t], s: wp.int32, v_bar: vec3) -> vec3:
            return v_bar

        return SimpleNamespace(apply=apply, adjoint=adjoint, wall_t=wall_t)

    # One function around the other and no loop over wp.static(walls[b]): what a loop resolves is not part of the
    # hash under which Warp
    # keeps compiled kernels, and two lists of walls of one length would share one kernel.
    before, last = make_contact(walls[:-1], real), len(walls) - 1
    before_apply, before_adjoint = before.apply, before.adjoint
    act, act_adjoint = _make_wall(*walls[-1], real)

    @wp.func(module="unique")
    def apply(v: vec3, r: vec3, row: wp.array2d[wall_t], s: wp.int32) -> vec3:
        return act(before_apply(v, r, row, s), r, row[s, last])

    @wp.func(module="unique")
    def adjoint(v: vec3, r: vec3, row: wp.array2d[wall_t], s: wp.int32, v_bar: vec3) -> vec3:
        o = before_apply(v, r, row, s)
        return before_adjoint(v, r, row, s, act_adjoint(o, r, row[s, last], v_bar))

    return SimpleNamespace(apply=apply, adjoint=adjoint, wall_t=wall_t)
