"""A hundred thousand substeps: the body of the map falls on a rough floor, comes to rest, and lies there.

What flows or crumbles does so in a pit with smooth sides: its particles would go their ways over the floor, and the
nodes with them. Bodies of one and two cells are run as well, on floors that are elastic and rigid: the smaller a body,
the less of its contact does the grid see.
"""

import dataclasses
from collections.abc import Iterator

from benchmarks.stability.cells import CELLS, DTYPES, DX, SIDE, Cell, Outcome, play, scene_of, wave
from diffuphy.mpm import HalfSpace

SUBSTEPS, FRAMES = 100_000, 500
"""At 0.05 c nothing crosses more than four cells in one of so many frames, and its block of nodes stays small."""

WEIGHT = 1e-3
"""g L/c² [-]: a tenth of that of the map, for the clock bounds the speed by a fall through all of a frame."""

PIT = (-DX, 4 * DX)
"""Where its sides are [m]: the five cells that two mirrors need between them."""

FLUID = ("fluid", "drucker", "clay", "melting", "three")
"""What does not stay together, by parts of names of matters."""


SMALL = ("neo_hookean",)
"""Matters of which small bodies are run as well."""

TWICE = ("neo_hookean", "fluid_eos, fluid", "hencky, drucker_prager", "three and three")
"""Matters that are run in float64 as well; films are made in float32, which is the first to wear out."""


def bodies(matter: str) -> Iterator[tuple[str, Cell]]:
    """The long runs of one matter, each with the name of its place in the map."""
    for precision in DTYPES if matter in TWICE else ("float32",):
        yield "long", Cell(matter, precision=precision)
        if matter in SMALL:
            for contact in ("elastic", "rigid"):
                for side in range(1, CELLS):
                    yield "small", Cell(matter, precision=precision, contact=contact, side=side)


def sides() -> tuple[HalfSpace, ...]:
    """Four walls that face inwards."""
    low, high = PIT
    places = [((low, 0.0, 0.0), (1.0, 0.0, 0.0)), ((high, 0.0, 0.0), (-1.0, 0.0, 0.0))]
    places += [((0.0, low, 0.0), (0.0, 1.0, 0.0)), ((0.0, high, 0.0), (0.0, -1.0, 0.0))]
    return tuple(HalfSpace(point=p, normal=n, kind="slip") for p, n in places)


def endure(cell: Cell, substeps: int = SUBSTEPS) -> Outcome:
    """What becomes of its body in about so many substeps."""
    c, scene = wave(cell), scene_of(cell)
    frames = max(1, FRAMES * substeps // SUBSTEPS)
    flows = any(law in cell.matter for law in FLUID)
    scene = dataclasses.replace(
        scene,
        fps=frames * c / (substeps * cell.cfl * DX),
        frames=frames,
        gravity=(0.0, 0.0, -WEIGHT * c * c / SIDE),
        velocity=(0.0, 0.0, -0.01 * c),
        boundaries=scene.boundaries + (sides() if flows else ()),
    )
    return play(cell, scene)[0]
