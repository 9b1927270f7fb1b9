"""What happens around an object: gravity, walls, how it starts; and the scene of each motion word."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from diffuphy.mpm.boundary import Boundary, HalfSpace, Sphere, Vec, vector
from diffuphy.mpm.drive import Drive, check_drives
from diffuphy.mpm.scheme import Scheme

GRAVITY = 9.81
"""Standard gravity, rounded [m/s²]."""

STABLE = 0.75
"""Largest Δt (c + |v|) / Δx of an explicit step that is stable for all laws of the library [-]: noise in what is nearly
incompressible grows from 0.77 on, with ν = 0.3 from 0.92 on."""


@dataclass(frozen=True)
class Scene:
    """The setting of a rollout. z is up, the floor of the ready-made scenes is z = 0."""

    gravity: Vec = (0.0, 0.0, -GRAVITY)
    """Acceleration [m/s²]."""
    dx: float = 0.5 / 28
    """Grid spacing [m]; about 2 particles fit along it."""
    fps: float = 30.0
    """Frames per second of physical time [1/s]; the time step inside a frame follows from the material."""
    frames: int = 60
    """Number of frames after the initial one; 60 at 30 fps are two seconds."""
    velocity: Vec = (0.0, 0.0, 0.0)
    """Initial velocity of the object [m/s]."""
    spin: Vec = (0.0, 0.0, 0.0)
    """Initial angular velocity about the centre of mass [rad/s]."""
    lift: float | None = 0.0
    """Initial height of the underside [m], half a particle below the lowest of their centres; None leaves the
    particles where they are."""
    boundaries: tuple[Boundary, ...] = (HalfSpace(friction=0.5),)
    """Walls, which act in this order; see ``mpm.boundary``."""
    drives: tuple[Drive, ...] = ()
    """What else acts on particles: impulses, force fields, particles that are held; see ``mpm.drive``."""
    cfl: float = 0.4
    """Δt (c + |v|) / Δx, the cells that a wave crosses in a substep [-]. Explicit steps are stable to 0.75; half
    of it leaves room for stiffening while a body is squeezed."""

    scheme: Scheme = Scheme()
    """Transfer between particles and grid, walls and time integration."""
    bounds: tuple[Vec, Vec] | None = None
    """Lower and upper corner of the box that particles are not to leave [m]; it is no wall, and is looked at once a
    frame. None: the grid follows them wherever they go."""
    leaving: Literal["error", "freeze", "remove"] = "error"
    """What becomes of a particle that has left ``bounds``: an exception; it stays where it is, at rest, and touches
    nothing; or the same and its mass is counted as gone in the reports."""

    def __post_init__(self) -> None:
        for name in ("gravity", "velocity", "spin"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        for name in ("dx", "fps"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if self.frames < 1:
            raise ValueError(f"frames must be at least 1, got {self.frames}")
        if self.lift is not None and not math.isfinite(self.lift):
            raise ValueError(f"lift must be finite, got {self.lift}; use None to leave the particles where they are")
        if not 0.0 < self.cfl <= STABLE:
            raise ValueError(f"cfl must be in (0, {STABLE}], got {self.cfl}: beyond it an explicit step is unstable")
        object.__setattr__(self, "boundaries", tuple(self.boundaries))
        object.__setattr__(self, "drives", tuple(self.drives))
        check_drives(self.drives)
        self._check_bounds()
        for k, b in enumerate(self.boundaries):
            if b.thickness < 3.0 * self.dx:
                raise ValueError(
                    f"boundaries[{k}], a {type(b).__name__} {b.thickness:.3g} m thick, slips between grid nodes "
                    f"{self.dx:.3g} m apart; make it at least 3 dx = {3.0 * self.dx:.3g} m thick, or dx smaller"
                )

    def _check_bounds(self) -> None:
        if self.leaving not in ("error", "freeze", "remove"):
            raise ValueError(f"leaving must be 'error', 'freeze' or 'remove', got {self.leaving!r}")
        if self.bounds is None:
            if self.leaving != "error":
                raise ValueError(f"leaving = {self.leaving!r} needs bounds: without them the grid follows everybody")
            return
        low, high = (vector("bounds", corner) for corner in self.bounds)
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"bounds must have low < high along every axis, got {low} and {high}")
        object.__setattr__(self, "bounds", (low, high))


def _floor(friction: float) -> HalfSpace:
    return HalfSpace(friction=friction)


def _rest(scene: Scene, size: float, friction: float) -> Scene:
    """On the floor, left to gravity."""
    return dataclasses.replace(scene, lift=0.0)


def _falling(scene: Scene, size: float, friction: float) -> Scene:
    return dataclasses.replace(scene, lift=0.8 * size)


def _bouncing(scene: Scene, size: float, friction: float) -> Scene:
    return dataclasses.replace(scene, lift=1.2 * size)


def _thrown(scene: Scene, size: float, friction: float) -> Scene:
    """A flat throw with some spin: it lands about three lengths away."""
    pace = math.sqrt(GRAVITY * size)
    return dataclasses.replace(
        scene, lift=0.6 * size, velocity=(1.2 * pace, 0.0, 0.8 * pace), spin=(0.0, pace / size, 0.0)
    )


def _spinning(scene: Scene, size: float, friction: float) -> Scene:
    """About the vertical, just above the floor: two turns a second."""
    return dataclasses.replace(scene, lift=0.02 * size, spin=(0.0, 0.0, 4.0 * math.pi))


def _sliding(scene: Scene, size: float, friction: float) -> Scene:
    """Along the floor, with the speed that friction stops after two lengths: v² = 2 μ g · 2 size."""
    return dataclasses.replace(
        scene, lift=0.0, velocity=(math.sqrt(4.0 * max(friction, 0.1) * GRAVITY * size), 0.0, 0.0)
    )


def _rolling(scene: Scene, size: float, friction: float) -> Scene:
    """Rolling without slipping for a ball as high as the object is long: v = ω size/2."""
    pace = math.sqrt(GRAVITY * size)
    return dataclasses.replace(scene, lift=0.0, velocity=(pace, 0.0, 0.0), spin=(0.0, 2.0 * pace / size, 0.0))


def _squashed(scene: Scene, size: float, friction: float) -> Scene:
    """A plate comes down to 0.6 of the longest side within half of the film and is gone then."""
    half = 0.5 * scene.frames / scene.fps
    speed = 0.4 * size / half
    plate = HalfSpace(
        point=(0.0, 0.0, size), normal=(0.0, 0.0, -1.0), friction=friction, velocity=(0.0, 0.0, -speed), end=half
    )
    return dataclasses.replace(scene, lift=0.0, boundaries=(*scene.boundaries, plate))


def _poked(scene: Scene, size: float, friction: float) -> Scene:
    """A ball pushes in from the side by a third of the object within half of the film and is gone then."""
    half, radius = 0.5 * scene.frames / scene.fps, max(0.2 * size, 2.5 * scene.dx)
    finger = Sphere(
        center=(-0.5 * size - radius, 0.0, 0.35 * size),
        radius=radius,
        friction=friction,
        velocity=(size / 3.0 / half, 0.0, 0.0),
        end=half,
    )
    return dataclasses.replace(scene, lift=0.0, boundaries=(*scene.boundaries, finger))


SCENES: dict[str, Callable[[Scene, float, float], Scene]] = {
    "falling": _falling,
    "bouncing": _bouncing,
    "thrown": _thrown,
    "spinning": _spinning,
    "sliding": _sliding,
    "rolling": _rolling,
    "melting": _rest,
    "collapsing": _rest,
    "squashed": _squashed,
    "poked": _poked,
}
"""Motion word → what it changes in the scene of an object at rest: f(scene, size [m], friction) → scene."""


def scene_for(
    verb: str,
    size: float,
    *,
    cells: int = 28,
    dx: float | None = None,
    frames: int = 60,
    fps: float = 30.0,
    friction: float = 0.5,
    cfl: float = 0.4,
) -> Scene:
    """The scene of a motion word, for an object whose longest side is ``size``.

    Args:
        verb: a key of ``SCENES``.
        size: longest side [m].
        cells: grid cells along it; Δx = size / cells.
        dx: or the grid spacing itself [m]; twice the spacing of the particles leaves 8 of them in a cell.
        frames, fps: length of the film and its rate.
        friction: Coulomb coefficient of floor, plate and ball [-].
        cfl: see ``Scene``.

    Raises:
        ValueError: an unknown verb, or a size or number of cells that makes no scene.
    """
    if verb not in SCENES:
        raise ValueError(f"no scene for the motion {verb!r}; known: {', '.join(SCENES)}")
    if not 0.0 < size < math.inf:
        raise ValueError(f"size must be positive and finite, got {size} m")
    dx = size / cells if dx is None else dx
    if not size >= 4 * dx:
        raise ValueError(
            f"the longest side, {size:.3g} m, must span at least 4 grid cells, got dx = {dx:.3g} m; use smaller cells"
        )
    rest = Scene(dx=dx, frames=frames, fps=fps, boundaries=(_floor(friction),), cfl=cfl)
    return SCENES[verb](rest, size, friction)
