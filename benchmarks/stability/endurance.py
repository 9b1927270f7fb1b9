"""A hundred thousand substeps: a body of one cell falls on a rough floor, comes to rest, and lies there."""

import dataclasses
import math

from benchmarks.stability.cells import DX, SIDE, Cell, Outcome, play, scene_of, wave
from benchmarks.verification.bodies import block

SUBSTEPS, FRAMES = 100_000, 20


def endure(cell: Cell, substeps: int = SUBSTEPS) -> Outcome:
    """What becomes of eight particles in about so many substeps."""
    c = wave(cell)
    T = substeps * cell.cfl * DX / c
    g = (0.0, 0.0, -0.01 * c * c / SIDE)
    scene = dataclasses.replace(
        scene_of(cell), fps=FRAMES / T, frames=FRAMES, gravity=g, velocity=(0.0, 0.0, -0.01 * c), lift=0.25 * DX
    )
    # the clock bounds the speed by a fall through all of a frame: shorter frames, or it would take tiny steps
    frames = max(FRAMES, math.ceil(abs(g[2]) * T / (0.05 * c)))
    scene = dataclasses.replace(scene, fps=frames / T, frames=frames)
    outcome, _ = play(cell, block((1, 1, 1), DX), scene)
    return outcome
