"""``accuracy=0.02``: how fine a film must be to be wrong by two hundredths of the object's size.

The error of a film, largest root mean square error of positions over the longest side, was measured for a family of
materials each with grids of three spacings, and falls as

    e(n) = e₀ (n₀ / n)ᵖ,   n = cells along the longest side

with quadratic and with cubic splines (``python -m benchmarks errors`` writes ``accuracy.json``). Of what reaches an
accuracy the cheapest is taken; work grows as n⁴ (n³ particles, n substeps). The curves are those of one impact: a film
in which bodies bounce again and again is less accurate, and its report says by how much.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from diffuphy.material.presets import lookup, melt
from diffuphy.types import Motion

CURVES = Path(__file__).with_name("accuracy.json")
"""The measured curves."""

FAMILIES = {
    "identity": "elastic",
    "von_mises": "plastic",
    "von_mises_hardening": "plastic",
    "drucker_prager": "granular",
    "drucker_prager_plane_strain": "granular",
    "cam_clay": "granular",
    "viscoplastic": "paste",
    "herschel_bulkley": "paste",
    "fluid": "fluid",
}
"""Plastic law of a material in the table → whose curve it has."""

FEWEST, BEYOND = 8, 4
"""Fewest cells, so that the drafts of the error estimate have four; and how far curves are trusted, in times the cells
of the finest grid that made them."""

ROUNDING = 0.1
"""Share of the accuracy that rounding may take: more than that asks for float64."""


@dataclass(frozen=True)
class Curve:
    """Error of a film against its cells."""

    error: float
    """Error with ``cells``, over the longest side [-]."""
    order: float
    """p [-]."""
    cells: float
    """n₀ [-]."""
    finest: float
    """Cells of the finest grid that was run [-]."""
    price: float
    """Processor time over that of the quadratic spline with as many cells [-]."""
    rounding: float
    """Difference of float32 and float64 films, over the longest side [-]."""

    def at(self, cells: float) -> float:
        """e(n) [-]."""
        return self.error * (self.cells / cells) ** self.order

    def needed(self, accuracy: float) -> float:
        """n with e(n) = accuracy [-]."""
        return self.cells * (self.error / accuracy) ** (1.0 / self.order)

    @property
    def most(self) -> float:
        """Cells up to which the curve is trusted [-]."""
        return BEYOND * self.finest


@dataclass(frozen=True)
class Choice:
    """What reaches an accuracy."""

    cells: int
    """Grid cells along the longest side."""
    order: int
    """Degree of the spline."""
    double: bool
    """Whether in float64."""
    error: float
    """What the curves predict, over the longest side [-]."""
    families: tuple[str, ...]
    """The materials of the scene."""

    def __str__(self) -> str:
        spline = "quadratic" if self.order == 2 else "cubic"
        return f"{self.cells} cells along the object, {spline} splines, {'float64' if self.double else 'float32'}"

    def applied(self, components: Mapping[str, Any]) -> dict[str, Any]:
        """Components with these settings instead of their own."""
        sample, scene = components["particles"], components["trajectory"]
        cells = math.ceil(self.cells * (scene.particles_per_cell / sample.per_cell) ** (1 / 3))
        fill = cells**3 * sample.per_cell  # what a cube would take: no lattice is coarsened any more
        scheme = dataclasses.replace(scene.scheme, order=self.order)
        return dict(components) | {
            "particles": dataclasses.replace(sample, cells=cells, max_particles=max(fill, sample.max_particles)),
            "trajectory": dataclasses.replace(scene, scheme=scheme, double=self.double or scene.double),
        }


class Unreachable(ValueError):
    """No grid for which there are curves is as accurate as asked."""

    def __init__(self, accuracy: float, best: Choice):
        super().__init__(
            f"accuracy = {accuracy:g} is beyond the measured curves for {', '.join(best.families)} matter; the best "
            f"that can be promised is accuracy={ceiled(best.error):g} with {best}"
        )
        self.best = best


@cache
def curves() -> dict[str, dict[int, Curve]]:
    """Measured curves by family and degree of the spline."""
    table = json.loads(CURVES.read_text(encoding="utf-8"))["curves"]
    return {name: {int(k): Curve(**c) for k, c in of.items()} for name, of in table.items()}


def families(motion: Motion) -> tuple[str, ...]:
    """Whose curves hold in a scene: those of all its materials."""
    kinds = [melt(lookup(w)) if motion.verb == "melting" else lookup(w) for w in motion.materials.values()]
    return tuple(sorted({FAMILIES[kind.plastic] for kind in kinds}))


def choose(accuracy: float, motion: Motion) -> Choice:
    """The cheapest grid, spline and precision whose error is at most ``accuracy``.

    Args:
        accuracy: largest root mean square error of positions over the longest side of the object [-].
        motion: materials and motion of the scene.

    Raises:
        ValueError: an accuracy outside (0, 1).
        Unreachable: the curves end before it; the error holds the best there is.
    """
    if not 0.0 < accuracy < 1.0:
        raise ValueError(f"accuracy must be in (0, 1), an error over the size of the object, got {accuracy}")
    mine = families(motion)
    found: list[tuple[float, Choice]] = []
    best: list[Choice] = []
    for order in (2, 3):
        of = [curves()[name][order] for name in mine]
        most = math.floor(min(c.most for c in of))
        rounding = max(c.rounding for c in of) > ROUNDING * accuracy
        best.append(Choice(most, order, rounding, max(c.at(most) for c in of), mine))
        cells = max(FEWEST, *(math.ceil(c.needed(accuracy)) for c in of))
        if cells <= most:
            price = max(c.price for c in of) * cells**4
            found.append((price, Choice(cells, order, rounding, max(c.at(cells) for c in of), mine)))
    if not found:
        raise Unreachable(accuracy, min(best, key=lambda choice: choice.error))
    return min(found, key=lambda pair: pair[0])[1]


def ceiled(value: float) -> float:
    """Rounded up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit - 1e-9) * unit
