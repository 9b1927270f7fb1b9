"""What a film is compared with: the prior's own material in the film's own scene, on a grid twice as fine.

The body is the film's, each particle split into eight that lie about it at random, so that it has the same shape and
mass; the motion of a particle of the film is compared with the mean of its eight.

    error = mean_t √(|Σ m e|² + Σ m |e − ē|²) / size,   e = x − x_ref,   Σ m = 1
"""

import dataclasses
import itertools
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.errors import split
from diffuphy.learning.probe import table_field
from diffuphy.material.field import take
from diffuphy.mpm import simulate
from diffuphy.mpm.state import placed
from diffuphy.mpm.trajectory import Simulate
from diffuphy.types import Look, Motion, Particles, Trajectory
from diffuphy.workspace import Workspace

SIDE = 0.4
"""Largest share by which a child is shifted, of its distance from the parent [-]."""


@dataclass(frozen=True)
class Reference:
    """The motion that the prior has in mind."""

    VERSION: ClassVar[int] = 1

    scene: Simulate
    """How the film is simulated."""
    library: Any
    """Knows the parts of the object."""
    override: dict[str, float | None]
    """Parameters that replace the table's [SI]."""
    seed: int = 0
    """Of the places of the children."""

    def __call__(self, look: Look, motion: Motion, particles: Particles, *, work: Workspace) -> Trajectory:
        """Means over the children of each particle of the film."""
        scene = self.scene.scene(motion, particles)
        field = table_field(self.library, look, motion, particles, self.override)
        x = children(placed(scene, particles.x, particles.vol), particles.spacing, self.seed)
        parent = torch.arange(len(particles)).repeat_interleave(8)
        fine = dataclasses.replace(scene, dx=scene.dx / 2, lift=None)
        states = simulate(fine, x, particles.vol[parent] / 8, take(field, parent))
        frames = [tuple(t.unflatten(0, (-1, 8)).mean(1) for t in (s.x, s.v, s.F)) for s in states]
        return Trajectory(*(torch.stack(parts) for parts in zip(*frames, strict=True)), fps=scene.fps)


@dataclass(frozen=True)
class Told:
    """The film of somebody who is told the prior's own material: what is left of its error is the simulation's."""

    VERSION: ClassVar[int] = 1

    scene: Simulate
    """How the film is simulated."""
    library: Any
    """Knows the parts of the object."""
    override: dict[str, float | None]
    """Parameters that replace the table's [SI]."""

    def __call__(self, look: Look, motion: Motion, particles: Particles, *, work: Workspace) -> Trajectory:
        """The particles of the film."""
        field = table_field(self.library, look, motion, particles, self.override)
        return self.scene(motion, particles, field, work=work)


def children(x: Tensor, spacing: float, seed: int) -> Tensor:
    """Eight points about each of N, in pairs on opposite sides so that their mean is that point, shape (8 N, 3) [m].

    x ± (h/4)(1 + ξ),   ξ uniform in (−SIDE, SIDE), one for each axis of each point
    """
    draw = torch.rand(x.shape, generator=torch.Generator().manual_seed(seed)).to(x)
    reach = spacing / 4 * (1 + SIDE * (2 * draw - 1))
    signs = x.new_tensor(list(itertools.product((-1.0, 1.0), repeat=3)))
    return (x[:, None] + signs * reach[:, None]).flatten(0, 1)


def error(film: Trajectory, reference: Trajectory, weight: Tensor, size: float) -> dict[str, float]:
    """Mean over the frames after the first of the error of the whole, of the centre of mass, of the shape [size].

    Args:
        weight: shares in the mass, shape (N,).
    """
    com, shape = split((film.x - reference.x).double(), weight.double())
    whole = torch.hypot(com, shape)
    return {name: float(e[1:].mean()) / size for name, e in (("error", whole), ("com", com), ("shape", shape))}
