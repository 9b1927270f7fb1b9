"""The stage that sets particles in motion, for a scene that is written out wall by wall instead of told by a word."""

import math
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from diffuphy.mpm.boundary import Boundary, Vec, vector
from diffuphy.mpm.drive import Drive, Impulse
from diffuphy.mpm.drive.select import Where, as_where, chosen
from diffuphy.mpm.scene import GRAVITY, Scene
from diffuphy.mpm.state import placed
from diffuphy.mpm.trajectory import Play
from diffuphy.types import Motion, Particles

ALIKE = 0.01
"""Relative difference up to which two sizes are the same [-]: sizes are typed with two digits."""

FINE = 1e-9
"""A grid spacing for which no wall is too thin [m]."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """The same impulse for each chosen particle: J = each · (how many are chosen) · of/N of N particles.

    For scenes whose author gave a force per particle. ``Impulse`` shares a total out by mass and does not depend on how
    finely a body is sampled; this one depends on it unless ``of`` says how many particles were meant.
    """

    each: Vec
    """Impulse of one particle [N s]."""
    where: Where = None
    """Particles it acts on, as of a drive; None for all."""
    start: float = 0.0
    """Time at which it begins [s]."""
    duration: float = 0.01
    """How long it lasts [s]."""
    of: int | None = None
    """Particles of the whole body that ``each`` is meant for; None: as many as there are."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "where", as_where(self.where))
        object.__setattr__(self, "each", vector("each", self.each))
        if self.of is not None and self.of < 1:
            raise ValueError(f"of must be at least one particle, got {self.of}")
        self.impulse(1, 1)

    def impulse(self, many: int, total: int) -> Impulse:
        """The drive that pushes ``many`` of ``total`` particles."""
        share = many * (1.0 if self.of is None else self.of / total)
        at = {"where": self.where, "start": self.start, "duration": self.duration}
        return Impulse(impulse=tuple(share * j for j in self.each), **at)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Stated(Play):
    """Plays a scene of given walls and drives: metres, z up, the floor of the film at z = 0, the object above the
    origin."""

    VERSION: ClassVar[int] = Play.VERSION + 1  # what is held is a wall

    size: float | None = None
    """Longest side of the object that the scene is meant for [m]; None fits every object."""
    gravity: Vec = (0.0, 0.0, -GRAVITY)
    """Acceleration [m/s²]."""
    velocity: Vec = (0.0, 0.0, 0.0)
    """Initial velocity of the object [m/s]."""
    spin: Vec = (0.0, 0.0, 0.0)
    """Initial angular velocity about the centre of mass [rad/s]."""
    height: float | None = None
    """Height of the middle of the object at the beginning [m]; None: it stands on z = 0."""
    boundaries: tuple[Boundary, ...] = ()
    """Walls, which act in this order; see ``mpm.boundary``."""
    drives: tuple[Drive, ...] = ()
    """What else acts on particles; see ``mpm.drive``."""
    pushes: tuple[Push, ...] = ()
    """Impulses told by particle; they act after the drives."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size is not None and not 0.0 < self.size < math.inf:
            raise ValueError(f"size must be positive and finite, got {self.size} m; null fits every object")
        if self.height is not None and not math.isfinite(self.height):
            raise ValueError(f"height must be finite, got {self.height} m; null stands the object on z = 0")
        for name in ("gravity", "velocity", "spin"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        for name in ("boundaries", "drives", "pushes"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        self._scene(FINE, None)  # what it refuses, it refuses before the other stages run

    def scene(self, motion: Motion, particles: Particles) -> Scene:
        """The walls and drives around the particles, on a grid that fits them.

        Raises:
            ValueError: an object of another size than the scene is meant for, a wall too thin for the grid, or a push
                that meets no particle.
        """
        if self.size is not None and abs(motion.size - self.size) > ALIKE * self.size:
            raise ValueError(
                f"the scene is meant for an object {self.size:g} m long, this one is {motion.size:g} m: set "
                f"refine.default_size={self.size:g}, or say its size in the prompt"
            )
        dx = self.dx(particles)
        thin = min(self.boundaries, key=lambda b: b.thickness, default=None)
        if thin is not None and thin.thickness < 3.0 * dx:
            raise ValueError(
                f"boundaries[{self.boundaries.index(thin)}], a {type(thin).__name__} {thin.thickness:.3g} m thick, "
                f"slips between grid nodes {dx:.3g} m apart: set sample.cells="
                f"{math.ceil(3 * motion.size / thin.thickness)}, and sample.max_particles to match"
            )
        if not hasattr(particles, "x"):  # a plan asks before there are particles: a push then counts as that of one
            return self._scene(dx, None, 0.0)
        lift = 0.0
        if self.height is not None:  # of the underside, as ``Scene`` has it
            lift = self.height + float((particles.x[:, 2] - 0.5 * particles.vol ** (1 / 3)).min())
        scene = self._scene(dx, None, lift)
        return self._scene(dx, placed(scene, particles.x, particles.vol), lift)

    def _scene(self, dx: float, x: Tensor | None, lift: float = 0.0) -> Scene:
        pushes = tuple(self._pushed(k, push, x) for k, push in enumerate(self.pushes))
        return Scene(
            gravity=self.gravity, dx=dx, fps=self.fps, frames=self.frames,
            velocity=self.velocity, spin=self.spin, lift=lift, boundaries=self.boundaries,
            drives=(*self.drives, *pushes), cfl=self.cfl, scheme=self.scheme,
        )  # fmt: skip

    @staticmethod
    def _pushed(k: int, push: Push, x: Tensor | None) -> Impulse:
        if x is None:
            return push.impulse(1, 1)
        if not (many := int(chosen(push.where, x.detach()).sum())):
            raise ValueError(f"pushes[{k}] meets none of the {len(x)} particles: where = {push.where}")
        return push.impulse(many, len(x))
