"""Walls as data: one row of numbers for each wall and substep, which the kernels read and give gradients for.

0–2    n of a half-space, else the centre c, lengths from the lowest node of the grid [m]
3      offset n·c of a half-space, radius of a ball, 0 of the others; less (reach − SLACK) Δx [m]
4–6    V, 7 μ, 8 one while it acts, 9–11 ω, 12–14 c
15–23  axes of box, cylinder and mesh as columns of R, row by row
24–26  half edges of a box; radius and half height of a cylinder; first sample of a mesh in its frame [m]
27–31  of a mesh: 1/h [1/m], index of its first sample, samples along each axis
"""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from diffuphy.mpm.boundary.mesh import Mesh
from diffuphy.mpm.boundary.shapes import Box, Cylinder, HalfSpace, Sphere
from diffuphy.mpm.grid import Grid

Boundary = HalfSpace | Sphere | Box | Cylinder | Mesh
Signature = tuple[tuple[str, str, bool, bool, bool], ...]
"""Shape, kind, friction or none, turning or not, elastic or not, of each wall."""

STIFFNESS = 2.0
"""ω² of elastic contact [c²/Δx²]: a plane of nodes on a wall has half the mass of a cell, so this is the stiffness of a
whole cell of the stiffest material. A step of 0.8 Δx/c has ωΔt = 1.1; up to 1.5 would be stable with the damper."""

DAMPING = 0.3
"""ζ of elastic contact [-]: a body at rest comes to rest, and a ball loses 2 % more of its speed in a bounce."""

HARD = 1.25
"""How far behind an elastic wall its nodes are held [Δx]."""

SLACK = 1e-3
"""A node this close in front of a wall still belongs to it [Δx]: a wall on a plane of nodes, as a floor at z = 0 is,
would otherwise take or lose that plane, and with it a whole Δx of height, by the rounding of a coordinate."""

OFFSET, FRICTION, ACTS = 3, 7, 8
VELOCITY, ANGULAR_VELOCITY, PIVOT = slice(4, 7), slice(9, 12), slice(12, 15)
FRAME, SIZE, SAMPLES = slice(15, 24), slice(24, 27), slice(27, 32)
N_WALL = 32
"""Numbers that describe a wall to a kernel."""


def signature(boundaries: Sequence[Boundary], elastic: bool = False) -> Signature:
    """What is compiled into the kernels: shape, kind, whether there is friction, whether it turns and, of walls that
    separate, whether they are elastic; everything else is data."""
    return tuple(
        (type(b).__name__, b.kind, b.friction > 0.0, b.turns, elastic and b.kind == "separate") for b in boundaries
    )


def wall_gradients(boundaries: Sequence[Boundary], times: np.ndarray, row_bar: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients in ``friction`` (walls,), ``velocity`` (walls, 3) and ``angular_velocity`` (walls, 3) of the walls.

    Sums over steps of those in the rows, which ``adjoint_rows`` made; a wall that has come to its ``end`` stands,
    whatever its velocity. Of a wall on a schedule they are those in what is added to its velocities. That a faster wall
    is elsewhere later, where it governs other nodes, is left out.

    Args:
        times: those of ``rows``, shape (steps,) [s].
        row_bar: gradients in its result, shape (steps, walls, N_WALL).
    """
    moves = torch.from_numpy(np.stack([times < b.end for b in boundaries], axis=1)[..., None]).to(row_bar)
    friction = row_bar[..., FRICTION].sum(0)
    return friction, (row_bar[..., VELOCITY] * moves).sum(0), (row_bar[..., ANGULAR_VELOCITY] * moves).sum(0)


def can_be_elastic(boundaries: Sequence[Boundary]) -> bool:
    """Whether walls that separate may be elastic: not where the planes of two meet, since nodes know how far their
    matter is from the nearest wall only."""
    planes = [b for b in boundaries if isinstance(b, HalfSpace) and b.kind == "separate"]
    return all(np.dot(a.normal, b.normal) < -0.99 for a, b in combinations(planes, 2))


def rows(boundaries: Sequence[Boundary], grid: Grid, times: np.ndarray, elastic: bool = False) -> np.ndarray:
    """The walls as data, shape (steps, walls, N_WALL), lengths from the lowest node of ``grid`` [m].

    Args:
        times: start of each step [s], float64; one row suffices when every wall is still.
        elastic: whether walls that separate are elastic, and their nodes held from HARD cells behind them on.
    """
    out = np.zeros((len(times), len(boundaries), N_WALL))
    low = np.asarray(grid.low)
    first = 0
    for k, b in enumerate(boundaries):
        now, row = b.pose(times), out[:, k]
        reach = (b.reach - SLACK + (HARD if elastic and b.kind == "separate" else 0.0)) * grid.dx
        place = now.place - low
        if isinstance(b, HalfSpace):
            n = np.asarray(b.normal)
            if b.turns:
                row[:, :3] = now.rotation @ n
                row[:, OFFSET] = np.einsum("ti,ti->t", place, row[:, :3]) - reach
            else:
                row[:, :3] = n
                row[:, OFFSET] = place @ n - reach
        else:
            row[:, :3] = place
            row[:, OFFSET] = (b.radius if isinstance(b, Sphere) else 0.0) - reach
            row[:, FRAME] = (now.rotation @ b.frame).reshape(-1, 9)
        if isinstance(b, Box):
            row[:, SIZE] = 0.5 * np.asarray(b.size)
        elif isinstance(b, Cylinder):
            row[:, SIZE] = b.radius, 0.5 * b.height, 0.0
        elif isinstance(b, Mesh):
            row[:, SIZE], row[:, SAMPLES] = b.corner, (1.0 / b.spacing, first, *b.shape)
            first += math.prod(b.shape)
        row[:, VELOCITY], row[:, FRICTION] = now.velocity, b.friction
        row[:, ANGULAR_VELOCITY], row[:, PIVOT] = now.angular_velocity, place
        row[:, ACTS] = (times >= b.start) & (times < b.end + b.reset)
    return out
