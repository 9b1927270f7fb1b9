"""Walls as frozen settings: their shape, what they do to a body, how they move, when they are there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from diffuphy.mpm.boundary.motion import Pose, Schedule, Vec, direction, pose, rotation_matrix, vector

Kind = Literal["sticky", "slip", "separate"]


@dataclass(frozen=True, kw_only=True)
class Wall:
    """What every wall has."""

    kind: Kind = "separate"
    """"sticky" holds, "slip" holds the normal direction only, "separate" pushes but never pulls."""
    friction: float = 0.0
    """Coulomb coefficient μ [-] of a separating wall."""
    velocity: Vec = (0.0, 0.0, 0.0)
    """Velocity of the centre [m/s]; the wall moves with it while it acts."""
    angular_velocity: Vec = (0.0, 0.0, 0.0)
    """Angular velocity ω about the centre c [rad/s]: the surface moves with V + ω × (x − c), and the shape turns."""
    schedule: Schedule | None = None
    """Places and turns at given times instead of the two velocities."""
    start: float = 0.0
    """Time at which the wall appears, at the place its other fields say [s]."""
    end: float = math.inf
    """Time at which it vanishes [s]."""
    reset: float = 0.0
    """For so long after ``end`` it is still there, stopped [s]. A sticky wall thus brings what it has moved to rest
    before it lets go."""
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
        if not (math.isfinite(self.start) and self.start < self.end):
            raise ValueError(f"a wall needs start < end, got start = {self.start}, end = {self.end} s")
        if not 0.0 <= self.reset < math.inf:
            raise ValueError(f"reset must be finite and not negative, got {self.reset} s")
        if self.reset > 0 and self.end == math.inf:
            raise ValueError(f"reset = {self.reset} s counts from end, and this wall never ends; give end")
        if not self.reach >= 0.0:
            raise ValueError(f"reach must not be negative, got {self.reach} dx")
        for name in ("velocity", "angular_velocity"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
            if self.schedule is not None and any(getattr(self, name)):
                raise ValueError(f"a wall with a schedule has no {name}, got {getattr(self, name)}; leave one out")

    @property
    def place(self) -> Vec:
        """What moves with V and about which the wall turns [m]."""
        raise NotImplementedError

    @property
    def extent(self) -> float:
        """Largest distance of its surface from the centre [m]; 0 for a half-space, which has none."""
        raise NotImplementedError

    @property
    def thickness(self) -> float:
        """Smallest width [m]; nodes that are further apart can miss it."""
        raise NotImplementedError

    @property
    def frame(self) -> np.ndarray:
        """Its axes at first as columns, shape (3, 3)."""
        return np.eye(3)

    @property
    def turns(self) -> bool:
        """True when its surface has more than one velocity."""
        return any(self.angular_velocity) if self.schedule is None else self.schedule.rates[1] > 0.0

    @property
    def speed(self) -> float:
        """Bound on |V + ω × (x − c)| over its surface [m/s]; of a half-space |V| alone, see ``speed_within``."""
        return self._speed(self.extent)

    def speed_within(self, low: Sequence[float], high: Sequence[float], time: float) -> float:
        """Bound on the speed of its surface inside the box ``low`` … ``high`` [m] at ``time`` [s] [m/s]."""
        at = self.pose(np.array([time])).place[0]
        corner = [max(abs(a - c), abs(b - c)) for a, b, c in zip(low, high, at, strict=True)]
        return self._speed(min(self.extent or math.inf, math.hypot(*corner)))

    def _speed(self, distance: float) -> float:
        V, w = math.hypot(*self.velocity), math.hypot(*self.angular_velocity)
        if self.schedule is not None:
            V, w = self.schedule.rates
        return V + w * distance if w > 0.0 else V

    def pose(self, times: np.ndarray) -> Pose:
        """Place, turn and velocities at ``times`` (T,) [s]; after ``end`` it stands where it was then."""
        now = pose(
            self.place, self.velocity, self.angular_velocity, self.schedule, self.start, np.minimum(times, self.end)
        )
        moves = (times < self.end)[:, None]
        return replace(now, velocity=now.velocity * moves, angular_velocity=now.angular_velocity * moves)

    @property
    def still(self) -> bool:
        """True when nothing about the wall depends on time."""
        moves = self.schedule is not None or self.turns or any(self.velocity)
        return not moves and self.start <= 0.0 and self.end == math.inf


@dataclass(frozen=True, kw_only=True)
class HalfSpace(Wall):
    """Everything on the far side of a plane: a floor, an incline, a press.  φ(x) = (x − point)·normal."""

    point: Vec = (0.0, 0.0, 0.0)
    """A point of the plane [m]."""
    normal: Vec = (0.0, 0.0, 1.0)
    """Direction out of the wall; any length but 0."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "normal", direction("normal", self.normal))
        object.__setattr__(self, "point", vector("point", self.point))

    @property
    def place(self) -> Vec:
        return self.point

    @property
    def extent(self) -> float:
        return 0.0

    @property
    def thickness(self) -> float:
        return math.inf


@dataclass(frozen=True, kw_only=True)
class Solid(Wall):
    """A wall with an inside of finite size; the material is outside."""

    center: Vec = (0.0, 0.0, 0.0)
    """Centre [m] at time ``start``; it turns about it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "center", vector("center", self.center))

    @property
    def place(self) -> Vec:
        return self.center


@dataclass(frozen=True, kw_only=True)
class Sphere(Solid):
    """A solid ball.  φ(x) = |x − center| − radius."""

    radius: float = 0.1
    """Radius [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _positive("radius", self.radius)

    @property
    def extent(self) -> float:
        return self.radius

    @property
    def thickness(self) -> float:
        return 2.0 * self.radius


@dataclass(frozen=True, kw_only=True)
class Box(Solid):
    """A solid box in any orientation.  φ = |max(q, 0)| + min(max_k q_k, 0) with q = |Rᵀ (x − center)| − size/2."""

    size: Vec = (0.2, 0.2, 0.2)
    """Lengths of its edges [m]."""
    rotation: Vec = (0.0, 0.0, 0.0)
    """Rotation vector of its orientation, axis times angle [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("size", "rotation"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        _positive("every edge in size", min(self.size))

    @property
    def extent(self) -> float:
        return 0.5 * math.hypot(*self.size)

    @property
    def thickness(self) -> float:
        return min(self.size)

    @property
    def frame(self) -> np.ndarray:
        return rotation_matrix(np.asarray(self.rotation))


@dataclass(frozen=True, kw_only=True)
class Cylinder(Solid):
    """A solid cylinder with flat ends.  φ as of a box, with q = (ρ − radius, |h| − height/2), h the distance from the
    centre along the axis and ρ that from the axis."""

    axis: Vec = (0.0, 0.0, 1.0)
    """Direction of its axis; any length but 0."""
    radius: float = 0.1
    """Radius [m]."""
    height: float = 0.2
    """Length along the axis [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axis", direction("axis", self.axis))
        for name in ("radius", "height"):
            _positive(name, getattr(self, name))

    @property
    def extent(self) -> float:
        return math.hypot(self.radius, 0.5 * self.height)

    @property
    def thickness(self) -> float:
        return min(2.0 * self.radius, self.height)

    @property
    def frame(self) -> np.ndarray:
        """Any axes whose third is ``axis``."""
        a = np.asarray(self.axis)
        b = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        b /= np.linalg.norm(b)
        return np.stack([b, np.cross(a, b), a], axis=1)


def _positive(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise ValueError(f"{name} must be positive and finite, got {value} m")


def container(low: Vec, high: Vec, kind: Kind = "separate", friction: float = 0.0) -> tuple[HalfSpace, ...]:
    """The six walls of a box that holds the material: floor first, then the sides, the lid last.

    Args:
        low, high: opposite corners [m].

    Raises:
        ValueError: a box without an inside.
    """
    low, high = vector("low", low), vector("high", high)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"a container needs low < high along every axis, got low = {low}, high = {high} m")
    planes = [(low, 2, 1.0), (low, 0, 1.0), (low, 1, 1.0), (high, 0, -1.0), (high, 1, -1.0), (high, 2, -1.0)]
    walls = []
    for point, axis, side in planes:
        normal = tuple(side if k == axis else 0.0 for k in range(3))
        walls.append(HalfSpace(point=point, normal=normal, kind=kind, friction=friction))  # type: ignore[arg-type]
    return tuple(walls)
