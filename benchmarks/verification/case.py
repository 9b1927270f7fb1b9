"""Cases, what they check, and the settings of the solver that they are run under."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import diffuphy.mpm as mpm
from diffuphy.mpm import Scene, simulate


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


class Unavailable(Exception):
    """The solver has no such setting; the case cannot be run, which is neither a pass nor a failure."""


@dataclass(frozen=True)
class Setting:
    """One way to run the solver: the transfer between particles and grid, and what theory promises for it."""

    name: str
    """``default``, ``mls`` or ``apic``."""
    scheme: Any = None
    """``diffuphy.mpm.Scheme``; None for a solver that knows plain MLS-MPM alone."""

    @property
    def improved(self) -> bool:
        """Half kick, mirror walls, sharpening and retention: bands are one-sided and narrower."""
        return self.name == "default" and self.scheme is not None

    @property
    def half_kick(self) -> bool:
        """Velocities at frames belong to the same time as positions; with symplectic Euler they lag Δt/2."""
        return bool(getattr(self.scheme, "half_kick", False))

    @property
    def order(self) -> int:
        """Degree of the B-spline."""
        return getattr(self.scheme, "order", 2)

    @property
    def inertia(self) -> float:
        """D of the affine transfer [Δx²]: 1/4 for quadratic, 1/3 for cubic splines (Jiang et al. 2015, §5.2)."""
        return 0.25 if self.order == 2 else 1.0 / 3.0

    @property
    def dissipates(self) -> bool:
        """Loses what the grid cannot see at every step, so that small steps lose more (plain APIC)."""
        return not self.improved

    def scene(self, **fields: Any) -> Scene:
        """A scene in free space without gravity, particles where they are, unless told otherwise."""
        free: dict[str, Any] = {"gravity": (0.0, 0.0, 0.0), "boundaries": (), "lift": None}
        chosen = {} if self.scheme is None else {"scheme": self.scheme}
        return Scene(**(free | chosen | fields))

    def cubic(self) -> "Setting":
        """The same with cubic splines.

        Raises:
            Unavailable: the solver has none.
        """
        import dataclasses

        if self.scheme is None:
            raise Unavailable("the solver has quadratic splines only")
        return dataclasses.replace(self, scheme=dataclasses.replace(self.scheme, order=3))


def settings() -> dict[str, Setting]:
    """Every setting of this solver by name; the default first."""
    Scheme = getattr(mpm, "Scheme", None)
    if Scheme is None:
        return {"default": Setting("default")}
    return {
        "default": Setting("default", Scheme()),
        "mls": Setting("mls", Scheme.mls()),
        "apic": Setting("apic", Scheme.apic()),
    }


def baseline(name: str) -> Setting:
    """Plain ``mls`` or ``apic``, to compare with.

    Raises:
        Unavailable: the solver has one transfer only.
    """
    known = settings()
    if name in known:
        return known[name]
    if name == "mls" and known["default"].scheme is None:
        return known["default"]
    raise Unavailable(f"the solver has no {name} transfer")


def needs(option: str) -> None:
    """Refuse a case whose option ``simulate`` does not have.

    Raises:
        Unavailable: it has none.
    """
    if option not in inspect.signature(simulate).parameters:
        raise Unavailable(f"simulate has no option {option!r}")


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
    def equation(self) -> str:
        """First line of its docstring."""
        return (inspect.getdoc(self.measure) or "").split("\n\n")[0].replace("\n", " ")


CASES: dict[str, Case] = {}
"""Every case by id, in the order in which the modules were imported."""


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
