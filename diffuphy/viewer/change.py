"""What is to be otherwise than in the film: the scene, the particles and the material that follow."""

import dataclasses
import math
from dataclasses import dataclass

import torch

from diffuphy.material.presets import PRESETS, field, lookup
from diffuphy.mpm import Scene, coarsen
from diffuphy.mpm.boundary import Vec, vector
from diffuphy.types import MaterialField, Particles
from diffuphy.viewer.opened import Run

DRAFT = 2000
"""Particles of a draft, at most: enough to see how a body bounces, sags or flows."""

SKETCH = 500
"""Particles of a sketch: coarser still, for a hand in it without a GPU."""

MATERIALS = tuple(sorted(PRESETS))
"""Words that ``Change.material`` may be."""


@dataclass(frozen=True)
class Change:
    """Differences from the film; what is None stays."""

    material: str | None = None
    """A word of the table for the whole body; None: what the run has found."""
    stiffness: float = 1.0
    """Factor on Young's modulus [-]."""
    height: float | None = None
    """Height of the underside at the beginning [m]."""
    velocity: Vec | None = None
    """Initial velocity [m/s]."""
    gravity: float | None = None
    """Acceleration downwards [m/s²]."""
    particles: int | None = DRAFT
    """Particles at most; None: all, as in the film."""

    def __post_init__(self) -> None:
        if self.material is not None:
            lookup(self.material)
        if not 0.0 < self.stiffness < math.inf:
            raise ValueError(f"stiffness must be a positive factor, got {self.stiffness}")
        if self.height is not None and not 0.0 <= self.height < math.inf:
            raise ValueError(f"height must be at least 0 m, the floor, got {self.height} m")
        if self.gravity is not None and not math.isfinite(self.gravity):
            raise ValueError(f"gravity must be finite, got {self.gravity} m/s²")
        if self.velocity is not None:
            object.__setattr__(self, "velocity", vector("velocity", self.velocity))
        if self.particles is not None and self.particles < 64:
            raise ValueError(f"a body needs at least 64 particles, got {self.particles}")

    def __str__(self) -> str:
        parts = {
            "": self.material,
            "stiffness ×": None if self.stiffness == 1.0 else f"{self.stiffness:g}",
            "from ": None if self.height is None else f"{self.height:g} m",
            "at ": None if self.velocity is None else f"({', '.join(f'{v:g}' for v in self.velocity)}) m/s",
            "gravity ": None if self.gravity is None else f"{self.gravity:g} m/s²",
        }
        told = ", ".join(f"{word}{value}" for word, value in parts.items() if value is not None)
        return (told or "as in the film") + ("" if self.particles is None else f", {self.particles} particles")

    def __call__(self, run: Run) -> "Setup":
        """The film's scene with these differences.

        Raises:
            ValueError: what the scene of the run refuses, such as walls too thin for a draft's grid.
        """
        particles, kept = run.particles, None
        if self.particles is not None and self.particles < len(particles):
            particles, kept = coarsen(particles, n=self.particles)
        scene = run.play.scene(run.motion, particles)
        given = {
            "lift": self.height,
            "velocity": self.velocity,
            "gravity": None if self.gravity is None else (0.0, 0.0, -self.gravity),
        }
        scene = dataclasses.replace(scene, **{k: v for k, v in given.items() if v is not None})
        return Setup(scene, particles, self._field(run, kept), run.play.double)

    def _field(self, run: Run, kept: torch.Tensor | None) -> MaterialField:
        if self.material is not None:
            n = len(run.particles) if kept is None else len(kept)
            made = field(lookup(self.material), n, dtype=run.field.rho.dtype, device=run.field.rho.device)
        else:
            made = run.field if kept is None else _rows(run.field, kept.to(run.field.rho.device))
        return dataclasses.replace(made, theta=made.theta | {"E": self.stiffness * made.theta["E"]})


@dataclass(frozen=True)
class Setup:
    """All that a simulation begins with."""

    scene: Scene
    particles: Particles
    field: MaterialField
    double: bool = False
    """Whether it is computed in float64."""


def _rows(field: MaterialField, kept: torch.Tensor) -> MaterialField:
    theta = {name: values[kept] for name, values in field.theta.items()}
    return dataclasses.replace(field, w_e=field.w_e[kept], w_p=field.w_p[kept], theta=theta, rho=field.rho[kept])


def height_of(scene: Scene, particles: Particles) -> float:
    """Height of the underside at the beginning [m]."""
    if scene.lift is not None:
        return scene.lift
    return float((particles.x[:, 2] - 0.5 * particles.vol ** (1 / 3)).min())
