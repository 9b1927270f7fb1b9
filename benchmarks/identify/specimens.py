"""What the ball is made of, and what is sought of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.identify.bodies import GRAINS, PROBE, Split
from diffuphy.learning.case import parameters
from diffuphy.learning.identifiability import coordinate_of, value_at
from diffuphy.learning.probe import Probe
from diffuphy.material import Param
from diffuphy.material.field import Hypothesis, warm_start
from diffuphy.types import MaterialField


@dataclass(frozen=True)
class Specimen:
    """A material with unknown parameters."""

    name: str
    elastic: str
    plastic: str
    theta: Mapping[str, float]
    """What is known [SI]; of the unknown ones a middle value."""
    rho: float
    """Density [kg/m³]."""
    unknown: Mapping[str, tuple[float, float]]
    """Name of a parameter → range that truths are drawn from [SI]."""
    tolerance: Mapping[str, tuple[float, str]]
    """What counts as found: dex, a relative error or the parameter's unit."""
    split: Split | None = None
    """Axis from one half to the other if they have parameters of their own; all of the first half come first."""

    probe: Probe = PROBE
    """How it is dropped and simulated."""

    def __hash__(self) -> int:
        return hash(self.name)

    @property
    def halves(self) -> bool:
        return self.split is not None

    @property
    def seam(self) -> Split:
        """Where the colours of the skin change."""
        return self.split or "z"

    @property
    def regions(self) -> int:
        return 1 + self.halves

    @property
    def params(self) -> tuple[Param, ...]:
        """The unknown parameters."""
        all_of = {p.name: p for p in parameters((self.elastic,), (self.plastic,))}
        return tuple(all_of[n] for n in self.unknown)

    @property
    def sought(self) -> list[tuple[str, str]]:
        """Name and unit of error of each coordinate."""
        return [(f"{n} {half}".strip(), self.tolerance[n][1]) for half in HALVES[self.split] for n in self.unknown]

    def box(self, beyond: float = 0.0) -> tuple[Tensor, Tensor]:
        """Ends of the ranges of the truths in coordinates, widened by so many dex or ranges, inside the bounds."""
        lo, hi = [], []
        for p in self.params:
            a, b = (coordinate_of(p, v) for v in self.unknown[p.name])
            ends = coordinate_of(p, p.lo), coordinate_of(p, p.hi)
            lo.append(max(a - beyond, ends[0] + 0.01))
            hi.append(min(b + beyond, ends[1] - 0.01))
        times = self.regions
        return torch.tensor(lo * times, dtype=torch.float64), torch.tensor(hi * times, dtype=torch.float64)

    def draw(self, generator: torch.Generator) -> Tensor:
        """Coordinates of a truth, shape (P,)."""
        lo, hi = self.box()
        return lo + (hi - lo) * torch.rand(len(lo), generator=generator, dtype=torch.float64)

    def values(self, q: Tensor) -> list[float]:
        """The parameters at coordinates [SI]."""
        return [value_at(p, v) for p, v in zip(self.params * self.regions, q.tolist(), strict=True)]

    def field(self, labels: Tensor, q: Tensor) -> MaterialField:
        """The material at coordinates, in the regions of the particles."""
        names, values = list(self.unknown), self.values(q)
        regions = [values[: len(names)], values[-len(names) :]]
        made = [Hypothesis(self.elastic, self.plastic, {**self.theta, **dict(zip(names, v, strict=True))}, self.rho)
                for v in regions]  # fmt: skip
        return warm_start((self.elastic,), (self.plastic,), labels * int(self.halves), made[: self.regions])

    def errors(self, q: Tensor, truth: Tensor) -> list[float]:
        """Errors in the unit of the tolerance, one for each coordinate."""
        found = []
        names = list(self.unknown) * self.regions
        for name, a, b, u, v in zip(names, q.tolist(), truth.tolist(), self.values(q), self.values(truth), strict=True):
            unit = self.tolerance[name][1]
            found.append(a - b if unit == "dex" else (u / v - 1 if unit == "%" else u - v))
        return found

    def right(self, errors: list[float], times: float = 1.0) -> list[bool]:
        names = list(self.unknown) * self.regions
        return [abs(e) <= times * self.tolerance[n][0] for n, e in zip(names, errors, strict=True)]


HALVES: dict[Split | None, tuple[str, ...]] = {None: ("",), "z": ("below", "above"), "x": ("left", "right")}
SOFT, STIFF = 10**3.9, 10**5.9
SPECIMENS = {
    s.name: s
    for s in (
        Specimen(
            "rubber", "neo_hookean", "identity", {"E": 1e5, "nu": 0.4}, 1000.0,
            {"E": (SOFT, STIFF)}, {"E": (0.1, "dex")},
        ),
        Specimen(
            "jelly", "neo_hookean", "identity", {"E": 3e4, "nu": 0.3}, 1000.0,
            {"E": (10**4.0, 10**5.3), "nu": (0.15, 0.42)}, {"E": (0.1, "dex"), "nu": (0.03, "-")},
        ),
        Specimen(
            "plasticine", "hencky", "von_mises", {"E": 3e5, "nu": 0.3, "yield_stress": 6e3}, 1200.0,
            {"yield_stress": (10**3.4, 10**4.2)}, {"yield_stress": (0.15, "%")},
        ),
        Specimen(
            "wax", "hencky", "von_mises", {"E": 3e5, "nu": 0.3, "yield_stress": 6e3}, 1200.0,
            {"E": (10**5.0, 10**5.8), "yield_stress": (10**3.4, 10**4.0)},
            {"E": (0.1, "dex"), "yield_stress": (0.15, "%")},
        ),
        Specimen(
            "sand", "hencky", "drucker_prager", {"E": 5e5, "nu": 0.2, "friction_angle": 30.0, "cohesion": 0.0}, 1600.0,
            {"friction_angle": (18.0, 45.0)}, {"friction_angle": (4.0, "deg")}, probe=GRAINS,
        ),
        Specimen(
            "honey", "hencky", "viscoplastic", {"E": 5e4, "nu": 0.42, "yield_stress": 10.0, "viscosity": 60.0}, 1400.0,
            {"viscosity": (10.0, 300.0)}, {"viscosity": (0.15, "%")},
        ),
        Specimen(
            "two halves", "neo_hookean", "identity", {"E": 1e5, "nu": 0.4}, 1000.0,
            {"E": (10**3.9, 10**5.6)}, {"E": (0.15, "dex")}, split="z",
        ),
        Specimen(
            "halves side by side", "neo_hookean", "identity", {"E": 1e5, "nu": 0.4}, 1000.0,
            {"E": (10**3.9, 10**5.6)}, {"E": (0.15, "dex")}, split="x",
        ),
    )
}  # fmt: skip


def contrast(generator: torch.Generator, which: int) -> Tensor:
    """Coordinates of two halves of which one, by turns, is ten times as stiff."""
    low = 4.0 + 0.5 * torch.rand((), generator=generator, dtype=torch.float64)
    pair = torch.stack([low, low + math.log10(10)])
    return pair if which % 2 else pair.flip(0)
