"""A finished run made by hand: a ball of rubber above the floor, one Gaussian for each particle."""

import torch

from diffuphy.material import presets
from diffuphy.mpm.trajectory import Simulate
from diffuphy.render import Film
from diffuphy.types import Gaussians, Motion, Particles, Trajectory
from diffuphy.viewer.opened import Run

SIZE = 0.4
FRAMES = 6


def ball(cells: int = 10) -> tuple[Gaussians, Particles]:
    """About π/6 cells³ particles on a lattice, and as many Gaussians."""
    axis = (torch.arange(cells) + 0.5) / cells * 2 - 1
    means = torch.cartesian_prod(axis, axis, axis)
    means = means[means.norm(dim=1) <= 1.0]
    n, spacing = len(means), SIZE / cells
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1)
    gaussians = Gaussians(
        means, quats, torch.full((n, 3), 1 / cells).log(), torch.full((n,), 3.0), (means[:, None] / 2)
    )
    x = means * SIZE / 2
    return gaussians, Particles(x, torch.full((n,), spacing**3), torch.arange(n), SIZE / 2, (0.0, 0.0, 0.0), spacing)


def run(folder, word: str = "rubber", cells: int = 10) -> Run:
    """The ball falls freely for the first frames: a motion that needs no simulation."""
    gaussians, particles = ball(cells)
    play = Simulate(seconds=FRAMES / 30, fps=30.0)
    t = torch.arange(FRAMES + 1) / 30
    fall = torch.zeros(FRAMES + 1, 1, 3)
    fall[:, 0, 2] = 0.8 * SIZE + SIZE / 2 - 9.81 * t**2 / 2
    v = torch.zeros(FRAMES + 1, len(particles), 3)
    v[:, :, 2] = -9.81 * t[:, None]
    x, eye = particles.x + fall, torch.eye(3).expand(FRAMES + 1, len(particles), 3, 3)
    field = presets.field(presets.lookup(word), len(particles))
    return Run(
        folder, Motion("falling", "a ball falling", {"": word}, SIZE), gaussians, particles, field,
        Trajectory(x, v, eye.contiguous(), 30.0), play, Film(width=32, height=32),
    )  # fmt: skip
