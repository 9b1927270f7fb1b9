"""Cases, what they check, and the settings of the solver that they are run under."""

import dataclasses
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diffuphy.mpm import Scene, Scheme


@dataclass(frozen=True)
class Check:
    """One measured number beside the interval that theory accepts."""

    what: str
    """Quantity."""
    measured: float
    lo: float
    """Smallest accepted value."""
    hi: float
    """Largest accepted value."""
    reference: float | None = None
    """Exact value, if there is one."""
    unit: str = ""

    @property
    def ok(self) -> bool:
        """Within the interval; false for what is not a number."""
        return self.lo <= self.measured <= self.hi

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.what}: {self.measured:.6g}{unit}, accepted {interval(self.lo, self.hi)}{unit}"


def interval(lo: float, hi: float) -> str:
    """The accepted values in words."""
    if lo == hi:
        return f"{lo:.6g}"
    if lo == -math.inf:
        return f"≤ {hi:.6g}"
    return f"≥ {lo:.6g}" if hi == math.inf else f"{lo:.6g} … {hi:.6g}"


def at_most(what: str, measured: float, limit: float, unit: str = "") -> Check:
    """An error, a drift or a loss: not negative, and exactly 0 at best."""
    return Check(what, float(measured), 0.0, limit, 0.0, unit)


def at_least(what: str, measured: float, limit: float, reference: float | None = None, unit: str = "") -> Check:
    return Check(what, float(measured), limit, math.inf, reference, unit)


def within(what: str, measured: float, lo: float, hi: float, reference: float | None = None, unit: str = "") -> Check:
    return Check(what, float(measured), lo, hi, reference, unit)


def near(what: str, measured: float, reference: float, tolerance: float, unit: str = "") -> Check:
    """``reference`` ± ``tolerance``."""
    return Check(what, float(measured), reference - tolerance, reference + tolerance, reference, unit)


@dataclass(frozen=True)
class Setting:
    """One way to run the solver: the transfer between particles and grid, and what theory promises for it."""

    name: str
    """``default``, ``elastic``, ``mls`` or ``apic``."""
    scheme: Scheme

    @property
    def improved(self) -> bool:
        """Half kick, mirror walls, sharpening and retention: bands are one-sided and narrower."""
        return self.name in ("default", "elastic")

    def scene(self, **fields: Any) -> Scene:
        """A scene in free space without gravity, particles where they are, unless told otherwise."""
        return Scene(**{"gravity": (0.0, 0.0, 0.0), "boundaries": (), "lift": None, "scheme": self.scheme} | fields)

    def cubic(self) -> "Setting":
        """The same with cubic splines."""
        return dataclasses.replace(self, scheme=dataclasses.replace(self.scheme, order=3))


SETTINGS = {
    "default": Setting("default", Scheme()),
    "elastic": Setting("elastic", Scheme(contact="elastic")),
    "mls": Setting("mls", Scheme.mls()),
    "apic": Setting("apic", Scheme.apic()),
}
"""What cases are run under: the default transfer, that of films with elastic contact, and the two plain ones."""


@dataclass(frozen=True)
class Case:
    """A problem with a known answer."""

    id: str
    title: str
    tier: int
    """0: seconds, in every run of the tests; 1: up to minutes."""
    schemes: tuple[str, ...]
    """Settings it makes sense under."""
    measure: Callable[[Setting], list[Check]]

    @property
    def place(self) -> tuple[str, int, str]:
        """Where it stands in a list: A2 before A10, A4 before A4b."""
        digits = "".join(c for c in self.id if c.isdigit())
        letter, suffix = self.id.split(digits)
        return letter, int(digits), suffix

    @property
    def equation(self) -> str:
        """First line of its docstring."""
        return (inspect.getdoc(self.measure) or "").split("\n\n")[0].replace("\n", " ")


CASES: dict[str, Case] = {}
"""Every case by id."""


def case(
    id: str, title: str, *, tier: int = 0, schemes: tuple[str, ...] = ("default", "mls", "apic")
) -> Callable[[Callable[[Setting], list[Check]]], Callable[[Setting], list[Check]]]:
    """Register a function of a setting as the case ``id``."""

    def register(measure: Callable[[Setting], list[Check]]) -> Callable[[Setting], list[Check]]:
        if id in CASES:
            raise ValueError(f"two cases are called {id}: {CASES[id].title!r} and {title!r}")
        CASES[id] = Case(id, title, tier, schemes, measure)
        return measure

    return register
