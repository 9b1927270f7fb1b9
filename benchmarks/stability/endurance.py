"""A hundred thousand substeps: a small body falls on a rough floor, comes to rest, and lies there.

One cell of what stays together; eight of what flows or crumbles, in a pit with smooth sides: its particles would go
their ways over the floor, and the nodes with them.
"""

import dataclasses

from benchmarks.stability.cells import DX, SIDE, Cell, Outcome, play, scene_of, wave
from benchmarks.verification.bodies import block
from diffuphy.mpm import HalfSpace

SUBSTEPS, FRAMES = 100_000, 500
"""At 0.05 c nothing crosses more than four cells in one of so many frames, and its block of nodes stays small."""

WEIGHT = 1e-3
"""g L/c² [-]: a tenth of that of the map, for the clock bounds the speed by a fall through all of a frame."""

PIT = (-2 * DX, 3 * DX)
"""Where its sides are [m]: the five cells that two mirrors need between them."""


def sides() -> tuple[HalfSpace, ...]:
    """Four walls that face inwards."""
    low, high = PIT
    places = [((low, 0.0, 0.0), (1.0, 0.0, 0.0)), ((high, 0.0, 0.0), (-1.0, 0.0, 0.0))]
    places += [((0.0, low, 0.0), (0.0, 1.0, 0.0)), ((0.0, high, 0.0), (0.0, -1.0, 0.0))]
    return tuple(HalfSpace(point=p, normal=n, kind="slip") for p, n in places)


def flows(matter: str) -> bool:
    """Whether a body of it falls apart."""
    return any(law in matter for law in ("fluid", "drucker", "clay", "three"))


def endure(cell: Cell, substeps: int = SUBSTEPS) -> Outcome:
    """What becomes of eight particles in about so many substeps."""
    c, scene = wave(cell), scene_of(cell)
    frames = FRAMES * substeps // SUBSTEPS
    scene = dataclasses.replace(
        scene,
        fps=frames * c / (substeps * cell.cfl * DX),
        frames=frames,
        gravity=(0.0, 0.0, -WEIGHT * c * c / SIDE),
        velocity=(0.0, 0.0, -0.01 * c),
        boundaries=scene.boundaries + (sides() if flows(cell.matter) else ()),
    )
    return play(cell, block((2, 2, 2) if flows(cell.matter) else (1, 1, 1), DX), scene)[0]
