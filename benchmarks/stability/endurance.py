"""A hundred thousand substeps: a body of one cell falls on a rough floor, comes to rest, and lies there.

What flows or crumbles is left out: its eight particles would go their ways over the floor, and the nodes with them.
"""

import dataclasses
import math

from benchmarks.stability.cells import DX, SIDE, Cell, Outcome, play, scene_of, wave
from benchmarks.verification.bodies import block

SUBSTEPS, FRAMES = 100_000, 20
WEIGHT = 1e-4
"""g L/c² [-]: the clock bounds the speed by a fall through all of a frame, and frames are long."""


def holds(matter: str) -> bool:
    """Whether a body of it stays together."""
    return not any(law in matter for law in ("fluid", "drucker", "clay", "three"))


def endure(cell: Cell, substeps: int = SUBSTEPS) -> Outcome:
    """What becomes of eight particles in about so many substeps."""
    c = wave(cell)
    T = substeps * cell.cfl * DX / c
    g = (0.0, 0.0, -WEIGHT * c * c / SIDE)
    scene = dataclasses.replace(
        scene_of(cell), fps=FRAMES / T, frames=FRAMES, gravity=g, velocity=(0.0, 0.0, -0.01 * c), lift=0.25 * DX
    )
    frames = max(FRAMES, math.ceil(abs(g[2]) * T / (0.05 * c)))
    scene = dataclasses.replace(scene, fps=frames / T, frames=frames)
    outcome, _ = play(cell, block((1, 1, 1), DX), scene)
    return outcome
