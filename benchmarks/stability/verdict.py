"""What counts as stable, as drift, and as silent: wrong without an error."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Kind = Literal["stable", "drift", "error", "silent"]
KINDS: tuple[Kind, ...] = ("stable", "drift", "error", "silent")


@dataclass(frozen=True)
class Limit:
    """Two bounds of a measured number: up to the first a run is stable, beyond the second it is silent."""

    stable: float
    silent: float
    what: str
    """What is measured, in words."""
    why: str
    """Where the bounds come from."""


LIMITS = {
    "gain": Limit(
        0.01,
        0.05,
        "largest rise of kinetic + stored energy − work of gravity above its start, over all energy put in",
        "leapfrog keeps an energy that differs from this one by (ωΔt)²/4 of what waves of frequency ω carry: per cents "
        "of a shock at CFL 0.4; what grows without bound passes both",
    ),
    "stirred": Limit(
        0.01,
        0.05,
        "the same after a rest, two frames of more than ten crossings of a wave in which kinetic + stored energy are "
        "below 1 % of all put in",
        "nothing moves what has come to rest, so the bounds are those of the gain; an elastic floor under it stores "
        "½ m (g Δx/c)²/2, far less",
    ),
    "momentum": Limit(
        1.0,
        100.0,
        "|Σ m v − Σ m v(0) − M g t − impulse of the walls|, over 27 √S roundings of M (|v| + g t) in S substeps",
        "a substep sums 27 nodes a particle; errors of sign and of size average to √S. A hundred times that is no "
        "rounding",
    ),
    "shrunk": Limit(
        10.0,
        100.0,
        "largest of 1/J and J of an elastic deformation",
        "½ρ(0.9 c)² stored in volume alone is |ln J| = 0.9; waves that meet double and triple it: e^2.3 = 10, e^4.6 = "
        "100",
    ),
    "sunk": Limit(
        0.25,
        1.0,
        "depth of the deepest particle below the floor [Δx]",
        "a particle is half a cell wide: with its centre a quarter of a cell below, half of it stands out; one cell is "
        "where nodes no longer know on which side it is",
    ),
    "apart": Limit(
        1e-3,
        0.05,
        "rms distance of particles from those of the same run in float64 [side of the body]",
        "5e-2 is a fifth of a cell, to be seen in a film; 1e-3 is not",
    ),
}
"""What is measured on every run that ends without an error."""


@dataclass(frozen=True)
class Verdict:
    """What became of a run."""

    kind: Kind
    why: str = ""
    """The number that decided, or the message of the error."""


def classify(measured: Mapping[str, float], error: str | None = None, foreign: bool = False) -> Verdict:
    """Stable, drift or silent by ``LIMITS``; an error is one if it is of the documented classes and not ``foreign``.

    A number that is not finite is silent: nobody was told.

    Args:
        measured: numbers by the names of ``LIMITS``; what is not measured does not count.
        error: the message of an exception that ended the run.
        foreign: whether the exception was of another class than ``ValueError`` and ``SimulationDiverged``.
    """
    if error is not None:
        return Verdict("silent" if foreign else "error", error)
    if unknown := set(measured) - set(LIMITS):
        raise ValueError(f"no limits for {sorted(unknown)}; known: {sorted(LIMITS)}")
    worst = Verdict("stable")
    for name, value in measured.items():
        if not value <= LIMITS[name].silent:  # NaN as well
            return Verdict("silent", f"{name} = {value:.3g}, at most {LIMITS[name].silent:g}")
        if value > LIMITS[name].stable:
            worst = Verdict("drift", f"{name} = {value:.3g}, at most {LIMITS[name].stable:g}")
    return worst
