"""Which cells are looked at: lines through a centre, corners, and points anywhere inside."""

import dataclasses
import itertools
import random
from collections.abc import Iterator

from benchmarks.stability.cells import Cell

AXES: dict[str, tuple[float, ...]] = {
    "E": (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11),
    "nu": (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999),
    "speed": (0.0, 0.01, 0.1, 0.3, 0.6, 0.9),
    "cfl": (0.05, 0.1, 0.2, 0.4, 0.6, 0.75),
    "yields": (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1),
}
"""Values of each coordinate on the lines through the centre, which is the default of ``Cell``."""

CORNERS = {"E": (1e2, 1e11), "nu": (0.0, 0.4999), "speed": (0.0, 0.9), "cfl": (0.1, 0.75)}
"""Every combination of these."""

SEED = 20
"""Of the points inside."""


def lines(matter: str) -> Iterator[tuple[str, Cell]]:
    """Cells on the lines, each with the name of its coordinate; elastic matter has no yield stress."""
    for axis, values in AXES.items():
        if axis == "yields" and not _flows(matter):
            continue
        for value in values:
            yield axis, dataclasses.replace(Cell(matter), **{axis: value})


def corners(matter: str) -> Iterator[tuple[str, Cell]]:
    """Cells at the corners."""
    for values in itertools.product(*CORNERS.values()):
        yield "corner", dataclasses.replace(Cell(matter), **dict(zip(CORNERS, values, strict=True)))


def inside(matter: str, count: int) -> Iterator[tuple[str, Cell]]:
    """Cells anywhere: E, 1/2 − ν and the yield stress evenly in their logarithms, half of them with rigid contact."""
    rng = random.Random(f"{SEED} {matter}")
    for k in range(count):
        yield (
            "inside",
            Cell(
                matter,
                E=10.0 ** rng.uniform(2, 11),
                nu=0.5 - 10.0 ** rng.uniform(-4, -0.301),
                speed=rng.uniform(0.0, 0.9),
                cfl=rng.uniform(0.05, 0.75),
                yields=10.0 ** rng.uniform(-6, -1),
                contact="rigid" if k % 2 else "elastic",
            ),
        )


def _flows(matter: str) -> bool:
    """Whether a law of it has a stress at which it flows."""
    return any(law in matter for law in ("mises", "visco", "bulkley", "clay", "melting", "three"))
