"""What a run says about its own error: one line at its end, one section of its report."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from diffuphy.artifact import Done
from diffuphy.render.report import Section
from diffuphy.types import Errors, Particles

BAND = 3.0
"""True errors lie between the estimate over this and the estimate times this [-]; ``docs/numerics/errors.md``."""

APART = 0.25
"""Error over the object's size from which film and draft are two motions [-]: how far they are apart is a fact, an
extrapolation from it is not."""

FINER = (8, 16)
"""What half the grid spacing takes: times the particles, and times the work."""

FALL = (0.8, 1.7, 3.9)
"""By what half the grid spacing divides an error: the least, the geometric mean and the most of the scenes of
``python -m benchmarks errors`` [-]."""


@dataclass(frozen=True)
class Judgement:
    """Errors of a film, in words and numbers."""

    errors: Errors
    particles: int
    """Of the film."""
    cells: float
    """Grid cells along the longest side, if there are eight particles in one."""
    film: float
    """Seconds that the trajectory took [s]."""
    run: float
    """All stages but the estimate [s]."""
    estimate: float
    """The estimate [s]."""

    def __str__(self) -> str:
        e = self.errors
        if e.why:
            return f"not known: {e.why}"
        com, shape = (float(t.max()) for t in (e.com, e.shape))
        return (
            f"at most about {length(com)} of the centre of mass, {length(shape)} of the shape ({com / e.size:.1%}, "
            f"{shape / e.size:.1%} of the size), {float(e.pixels.max()):.1f} px; "
            f"half the grid spacing divides it by {FALL[1]:g} for {FINER[1]} times the {self.film:.0f} s; "
            f"found in {self.estimate:.1f} s"
        )

    def section(self) -> Section:
        e = self.errors
        if e.why:
            return Section("Error and run time", words=[f"The error is not known: {e.why}."])
        percent = [
            (name, [100 * float(v) / e.size for v in t]) for name, t in (("centre of mass", e.com), ("shape", e.shape))
        ]
        curves = [(f"{name} [% of the size]", values) for name, values in percent]
        curves.append(("in the picture [px]", e.pixels.tolist()))
        return Section("Error and run time", self._numbers(), [_band(n, v, e.fps) for n, v in curves], self._words())

    def _numbers(self) -> list[tuple[str, str, str]]:
        e = self.errors
        causes = {
            "time": "root mean square change of the draft by half the time step",
            "precision": "change of the draft by the other precision",
        }
        found = [
            ("centre of mass", *_both(e.com, e.size)),
            ("shape", *_both(e.shape, e.size)),
            ("picture", f"{float(e.pixels.max()):.2g} px", f"{float(e.pixels[-1]):.2g} px in the last frame"),
        ]
        found += [(f"due to {n}", length(float(t.max())), causes[n]) for n, t in e.parts.items() if n in causes]
        share = self.estimate / self.run if self.run else math.nan
        return [*found, ("took", f"{self.estimate:.1f} s", f"{share:.0%} of the {self.run:.0f} s of everything else")]

    def _words(self) -> list[str]:
        e = self.errors
        finer = (
            f"+sample.cells={math.ceil(2 * self.cells)} +sample.max_particles={FINER[0] * _thousands(self.particles)}"
        )
        words = [
            "Estimates, from the same motion with twice the grid spacing; the true error lies in the band, between a "
            "third and three times the estimate. Not in it: the choice of the material, and what the particles leave "
            "out of the object.",
            f"Half the grid spacing takes {FINER[0]} times the {self.particles} particles and {FINER[1]} times the "
            f"work, about {duration(FINER[1] * self.film)} instead of {duration(self.film)} for the trajectory "
            f"({finer}). Measured, it divides the error by {FALL[1]:g} in the mean, by {FALL[0]:g} to {FALL[2]:g} in "
            "single scenes; by two would be the first order of contact.",
        ]
        far = (e.total > APART * e.size).nonzero()
        if len(far):
            words.append(
                f"From {float(far[0]) / e.fps:.2f} s on film and draft are two different motions, more than "
                f"{APART:.0%} of the size apart: bodies that bounce or tumble magnify what is small before. The band "
                "then says how far they are apart, not where it ends; the film shows one possible motion."
            )
        return words


def judgement(done: Sequence[Done]) -> Judgement | None:
    """The errors of a run, if they were estimated."""
    at = {d.name: d for d in done}
    if "errors" not in at:
        return None
    errors, particles = Errors.load(at["errors"].path), Particles.load(at["particles"].path)
    others = sum(d.seconds for d in done if d.name != "errors")
    cells = errors.size / particles.spacing / 2
    return Judgement(errors, len(particles), cells, at["trajectory"].seconds, others, at["errors"].seconds)


def _both(values: Tensor, size: float) -> tuple[str, str]:
    most, end = float(values.max()), float(values[-1])
    return length(most), f"{most / size:.2%} of the size at most, {end / size:.2%} in the last frame"


def _band(name: str, values: list[float], fps: float) -> tuple[str, list, list]:
    times = [t / fps for t in range(len(values))]
    points = list(zip(times, values, strict=True))
    return name, points, [(t, v / BAND, v * BAND) for t, v in points]


def _thousands(count: int) -> int:
    return 1000 * math.ceil(count / 1000)


def length(metres: float) -> str:
    """A length as one reads it."""
    for unit, scale in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)):
        if metres >= scale:
            return f"{metres / scale:.2g} {unit}"
    return f"{float(f'{metres / 1e-6:.2g}'):g} µm"


def duration(seconds: float) -> str:
    """A time as one reads it."""
    return (
        f"{seconds:.0f} s"
        if seconds < 120
        else f"{seconds / 60:.0f} min"
        if seconds < 7200
        else f"{seconds / 3600:.1f} h"
    )
