"""Drives as frozen settings: what accelerates particles from within, and what moves them by force."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diffuphy.mpm.boundary.motion import Schedule, Vec, direction, vector
from diffuphy.mpm.drive.select import InBall, InBox, Where, as_where

MAX_DRIVES = 30
"""Drives of a scene: each has a bit in the 32-bit tag of a particle, whose sign is not used and one more of whose bits
marks what is one piece with held matter."""


@dataclass(frozen=True, kw_only=True)
class _Drive:
    """What every drive has."""

    where: Where = None
    """Particles it acts on: ``InBox``, ``InBall`` or ``InCylinder`` of initial positions, indices, a mask (turned into
    indices), or None for all."""
    start: float = 0.0
    """Time at which it begins [s]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "where", as_where(self.where))
        if not 0.0 <= self.start < math.inf:
            raise ValueError(f"start must be finite and not negative, got {self.start} s: films begin at 0")


@dataclass(frozen=True, kw_only=True)
class _Timed(_Drive):
    end: float = math.inf
    """Time at which it ceases [s]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.start < self.end:
            raise ValueError(f"a drive needs start < end, got start = {self.start}, end = {self.end} s")


@dataclass(frozen=True, kw_only=True)
class _Field(_Timed):
    region: InBox | InBall | None = None
    """Where it is felt, in space: particles come and go; None: everywhere."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.region, InBox | InBall | None):
            raise ValueError(f"region must be InBox, InBall or None, got {self.region!r}")


@dataclass(frozen=True, kw_only=True)
class Impulse(_Drive):
    """A total impulse, shared out by mass and spread evenly over a time: b = J / (M duration).

    M is the mass of the selected particles, so that Σ_p m_p ∫ b dt = J whatever the time step.
    """

    impulse: Vec
    """Total impulse J [N s]."""
    duration: float = 0.01
    """How long it lasts [s]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "impulse", vector("impulse", self.impulse))
        _positive("duration", self.duration, "s")


@dataclass(frozen=True, kw_only=True)
class Acceleration(_Field):
    """A uniform acceleration, as by a wind or a second gravity."""

    acceleration: Vec
    """b [m/s²]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "acceleration", vector("acceleration", self.acceleration))


@dataclass(frozen=True, kw_only=True)
class Attractor(_Field):
    """A pull towards a point:  b = −(A/s) d (1 + |d|²/s²)^(−(p+1)/2),  d = x − center.

    Far away |b| = A (s/|d|)^p, within s it is a spring of stiffness A/s per mass. p = 2 is the gravity of a Plummer
    sphere (Plummer 1911), p = 0 a constant pull, p = −1 a spring everywhere.
    """

    center: Vec
    """Where it pulls to [m]."""
    strength: float
    """A [m/s²]; negative repels."""
    radius: float
    """Core radius s [m]."""
    falloff: float = 2.0
    """Exponent p [-]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "center", vector("center", self.center))
        _positive("radius", self.radius, "m")
        _finite(self, "strength", "falloff")


@dataclass(frozen=True, kw_only=True)
class Vortex(_Field):
    """A swirl about an axis a:  b = (A/s) a × d (1 + |d⊥|²/s²)^(−(p+1)/2),  d = x − center, d⊥ = d − (d·a) a."""

    center: Vec
    """A point of the axis [m]."""
    axis: Vec = (0.0, 0.0, 1.0)
    """Direction a of the axis; any length but 0. The swirl is right-handed about it."""
    strength: float
    """A [m/s²]; negative turns the other way."""
    radius: float
    """Core radius s [m]."""
    falloff: float = 1.0
    """Exponent p [-]: far away |b| = A (s/|d⊥|)^p."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "center", vector("center", self.center))
        object.__setattr__(self, "axis", direction("axis", self.axis))
        _positive("radius", self.radius, "m")
        _finite(self, "strength", "falloff")


@dataclass(frozen=True, kw_only=True)
class Drag(_Field):
    """Resistance of a medium:  dv/dt = −u/τ − q |u| u,  u = v − velocity, integrated exactly over each substep Δt.

        b = −u ((1 − E) + q κ |u|) / ((1 + q κ |u|) Δt),   E = exp(−Δt/τ),  κ = τ (1 − E)

    It is therefore stable for any Δt, and its decay does not depend on it.
    """

    velocity: Vec = (0.0, 0.0, 0.0)
    """Velocity of the medium [m/s]."""
    time: float = math.inf
    """Time constant τ of the linear part [s]; infinite: none."""
    quadratic: float = 0.0
    """Coefficient q of the quadratic part [1/m]; of a body ½ ρ_air c_d A/m."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "velocity", vector("velocity", self.velocity))
        if not self.time > 0.0:
            raise ValueError(f"time must be positive, got {self.time} s; math.inf leaves the linear part out")
        if not 0.0 <= self.quadratic < math.inf:
            raise ValueError(f"quadratic must be finite and not negative, got {self.quadratic} 1/m")
        if self.time == math.inf and self.quadratic == 0.0:
            raise ValueError("a drag without time and without quadratic resists nothing; give one of them")


@dataclass(frozen=True, kw_only=True)
class Held(_Timed):
    """Particles that move as a rigid body whatever happens: x(t) = c(t) + R(t) (x₀ − c₀), F ← R F, exactly.

    For all other matter they are a rough wall that moves (``mpm.substep.obstacle``). In a substep they have the
    velocity v = V + A (x − c) with A = (exp(Δt [ω]×) − 1)/Δt, the chord of their arc, which takes them to the right
    place; A is their affine velocity C.
    """

    center: Vec = (0.0, 0.0, 0.0)
    """Centre c of the rotation at ``start`` [m]."""
    velocity: Vec = (0.0, 0.0, 0.0)
    """Velocity V of the centre [m/s]."""
    angular_velocity: Vec = (0.0, 0.0, 0.0)
    """ω about the centre [rad/s]."""
    schedule: Schedule | None = None
    """Places and turns at given times instead of the two velocities."""
    attached: bool = True
    """Whether what is within a cell of them at first is one piece with them, as a stem is with the pot that is held;
    else it only lies against them and may be lifted off, as what comes later always may."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("center", "velocity", "angular_velocity"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        if self.schedule is not None and (any(self.velocity) or any(self.angular_velocity)):
            raise ValueError("particles held on a schedule have no velocity and angular_velocity; leave one out")


@dataclass(frozen=True, kw_only=True)
class Release(_Drive):
    """Particles are held still until a plane passes where they were at first: n·(x₀ − point) = speed (t − start).

    Those behind the plane at ``start`` are let go then. One that several drives of this kind select waits for the last.
    """

    point: Vec
    """A point of the plane at ``start`` [m]."""
    normal: Vec
    """Direction n in which it moves; any length but 0."""
    speed: float
    """Speed of the plane [m/s]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "point", vector("point", self.point))
        object.__setattr__(self, "normal", direction("normal", self.normal))
        _positive("speed", self.speed, "m/s")

    @property
    def attached(self) -> bool:
        """What is released is one piece with what is not yet."""
        return True


HOLDING = (Held, Release)
"""Drives that set a velocity; the others accelerate."""

Drive = Impulse | Acceleration | Attractor | Vortex | Drag | Held | Release


def _positive(name: str, value: float, unit: str) -> None:
    if not 0.0 < value < math.inf:
        raise ValueError(f"{name} must be positive and finite, got {value} {unit}")


def _finite(drive: Any, *names: str) -> None:
    for name in names:
        if not math.isfinite(getattr(drive, name)):
            raise ValueError(f"{name} must be finite, got {getattr(drive, name)}")


def check_drives(drives: Sequence[Drive]) -> None:
    """Refuse what is no drive, or too many.

    Raises:
        ValueError: naming the first, or their number.
    """
    for k, drive in enumerate(drives):
        if not isinstance(drive, Drive):
            raise ValueError(f"drives[{k}] must be one of {Drive}, got {drive!r}")
    if len(drives) > MAX_DRIVES:
        raise ValueError(f"at most {MAX_DRIVES} drives, got {len(drives)}; select more particles with one of them")
