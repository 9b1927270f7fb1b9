"""What a stage does, counted; and the work of pictures, which several stages make."""

from dataclasses import dataclass, field

from diffuphy.cost.rollouts import Work, add


@dataclass(frozen=True)
class Counted:
    """What a stage does."""

    work: Work
    """How often each unit is done."""
    sizes: Work = field(default_factory=dict)
    """How much is kept of each kind."""
    spread: Work = field(default_factory=dict)
    """The part of ``work`` that several threads share."""
    lanes: int = 1
    """How many threads at most."""


def pictures(views: float, gaussians: float, side: float, *, back: bool = False, degree: int = 0) -> Work:
    """Pictures of ``side`` pixels a side, forward, or forward and backward; coloured by harmonics of a degree."""
    work = {"view": views, "view.gaussian": views * gaussians, "view.pixel": views * side**2}
    if degree:
        work["view.harmonic"] = views * gaussians * (degree + 1) ** 2
    return add(work, {f"back.{unit}": n for unit, n in work.items()}) if back else work
