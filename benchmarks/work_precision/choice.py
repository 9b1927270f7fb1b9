"""Ways to run the solver: the default, and each of its settings varied alone or with one that goes well with it."""

import dataclasses
from dataclasses import dataclass

import torch

from diffuphy.mpm import Scheme
from diffuphy.mpm.scene import STABLE


@dataclass(frozen=True)
class Choice:
    """One way to run the solver; resolution is not part of it."""

    series: str
    """Name in tables and figures."""
    axis: str
    """What it varies of the default: "default", "transfer", "part", "order", "force", "CFL", "precision",
    "particles" or "contact"; "peer" for other codes."""
    scheme: Scheme = Scheme()
    """Transfer, walls, time integration."""
    cfl: float = 0.4
    """Δt (c + |v|)/Δx [-]; the default of a scene."""
    dtype: torch.dtype = torch.float32
    """Precision; the default of films."""
    per: float = 2.0
    """Particles along each axis of a cell [-]; the default of films."""

    def __post_init__(self) -> None:
        if not 0.0 < self.cfl <= STABLE:
            raise ValueError(f"cfl must be in (0, {STABLE}], got {self.cfl}: beyond it an explicit step is unstable")

    @property
    def precision(self) -> str:
        """``float32`` or ``float64``."""
        return str(self.dtype).removeprefix("torch.")


DEFAULT = Choice("default", "default")
FAST = 0.7
"""Near the largest CFL number that a scene accepts."""


def varied(series: str, axis: str, cfl: float = DEFAULT.cfl, **parts: object) -> Choice:
    """The default with other parts of the scheme."""
    return Choice(series, axis, dataclasses.replace(DEFAULT.scheme, **parts), cfl)  # type: ignore[arg-type]


CHOICES: tuple[Choice, ...] = (
    DEFAULT,
    Choice("plain MLS", "transfer", Scheme.mls()),
    Choice("plain APIC", "transfer", Scheme.apic()),
    varied("elastic contact", "contact", contact="elastic"),
    varied("no sharpening", "part", sharpen=False),
    varied("no retention", "part", retain=0.0),
    varied("no half kick", "part", half_kick=False),
    varied("no mirror", "part", mirror=False),
    varied("cubic", "order", order=3),
    varied("cubic, CFL 0.7", "order", FAST, order=3),
    varied("classic force", "force", force="classic"),
    varied("cubic, classic force", "force", order=3, force="classic"),
    *(dataclasses.replace(DEFAULT, series=f"CFL {c}", axis="CFL", cfl=c) for c in (0.05, 0.1, 0.2, 0.6, FAST)),
    Choice("plain MLS, CFL 0.7", "CFL", Scheme.mls(), FAST),
    Choice("plain APIC, CFL 0.7", "CFL", Scheme.apic(), FAST),
    dataclasses.replace(DEFAULT, series="float64", axis="precision", dtype=torch.float64),
    dataclasses.replace(DEFAULT, series="1.5³ a cell", axis="particles", per=1.5),
    dataclasses.replace(DEFAULT, series="3³ a cell", axis="particles", per=3.0),
)
"""Everything that is swept; a case leaves out what cannot matter to it."""


def named(*series: str) -> tuple[Choice, ...]:
    """The choices of these names, in the order of ``CHOICES``.

    Raises:
        ValueError: a name that none has.
    """
    known = {c.series for c in CHOICES}
    if unknown := set(series) - known:
        raise ValueError(f"no choice is called {', '.join(sorted(unknown))}; known: {', '.join(sorted(known))}")
    return tuple(c for c in CHOICES if c.series in series)
