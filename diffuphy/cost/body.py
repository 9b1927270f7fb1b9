"""The object of a prompt as far as it costs something: how large it is, how stiff, how many points it will be made of.

Nothing of it exists yet when a plan is made, so everything here is a guess with a source: the shape is that of the
prior's object where it has one, the material is the table's.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.material import lookup, presets, wave_speed
from diffuphy.material.preset import Preset
from diffuphy.types import Motion, Prompt

LATTICE = 36
"""Points along the longest side with which a shape is measured: 5·10⁴ distances take 10 ms and are good to 3 %."""

BLOAT = 0.03
"""How far matter reaches beyond the surface of the prior's object [object units]: cells are matter from half a standard
deviation of the outermost Gaussians on (measured: ``benchmarks speed``)."""

BALL = (math.pi / 6, (1.0, 1.0, 1.0), 1.0)
"""Of an object of which nothing is known: see ``shape``."""

GROWTH = 0.13
"""Share of Gaussians that one event of densification adds, averaged over the objects of the library [-]."""

COARSENED = 0.94
"""Share of the most particles that is left when a lattice has to be made coarser, 1.02⁻³ [-]."""

KEPT = 0.96
"""Share of Gaussians that is left when haze and strays are removed [-]."""


@dataclass(frozen=True)
class Body:
    """What is known of the object beforehand."""

    size: float
    """Longest side [m]."""
    volume: float
    """Volume of its matter [m³]."""
    extent: tuple[float, float, float]
    """Sides of its box [m]."""
    particles: float
    """Particles of the film."""
    gaussians: float
    """Gaussians of the film."""
    mean_gaussians: float
    """The same, averaged over the steps of their optimisation."""
    crowd: float
    """Primitives that a ray of the prior meets."""
    kinds: tuple[Preset, ...]
    """Materials of its parts, what melts molten."""

    def spacing(self, particles: float) -> float:
        """Distance of so many particles [m]."""
        return (self.volume / particles) ** (1 / 3)

    def wave(self, log_E: Sequence[float | None] | None = None) -> float:
        """Fastest wave at rest in any part [m/s].

        Args:
            log_E: log₁₀ of Young's modulus of each part instead of the table's [Pa]; None keeps it.
        """
        values = log_E or [None] * len(self.kinds)
        kinds = [k if e is None else dataclasses.replace(k, E=10**e) for k, e in zip(self.kinds, values, strict=True)]
        field = presets.field(kinds, torch.arange(len(kinds)), dtype=torch.float64)
        return float(wave_speed(field.elastic, field.w_e, field.theta, field.rho, field.branches).max())


def body(components: Mapping[str, Any], prompt: Prompt, particles: float | None = None) -> Body:
    """The object of a prompt.

    Args:
        components: one a stage, by stage name.
        particles: how many there are, where it is known.
    """
    size = prompt.motion.size
    share, sides, crowd = shape(components, prompt)
    sample = components["particles"]
    most = share * sample.cells**3 * sample.per_cell
    if most > sample.max_particles:
        most = COARSENED * sample.max_particles
    _first, last, mean = gaussians(components["gaussians"])
    return Body(
        size, share * size**3, tuple(s * size for s in sides),  # type: ignore[arg-type]
        particles or max(1.0, most), KEPT * last, mean, crowd, kinds(components["material"], prompt.motion),
    )  # fmt: skip


def shape(components: Mapping[str, Any], prompt: Prompt) -> tuple[float, tuple[float, ...], float]:
    """Share of the cube around it that an object fills and its sides over its longest one, as particles make it; and
    how many primitives a ray meets."""
    guidance = getattr(components["gaussians"], "guidance", None)
    libraries = (getattr(guidance, "references", None), getattr(components["material"], "library", None))
    library: Any = next((found for found in libraries if hasattr(found, "object")), None)
    if library is None:
        return BALL
    try:
        drawn = library.object(prompt.look)
    except ValueError:  # only a prior that reads text knows it, and not before it has made it
        return BALL
    a = torch.linspace(-1.25, 1.25, LATTICE)
    points, cell = torch.cartesian_prod(a, a, a), float(a[1] - a[0])
    distance: Tensor = drawn.sdf(points)[0][:, None]
    inside = distance[:, 0] < 0.0  # and so is the ball around a point that touches the surface
    core, room = points[inside], -distance[inside]
    sides = (core + room).amax(0) - (core - room).amin(0)
    longest = float(sides.max())
    matter = (0.5 - (distance - BLOAT) / cell).clamp(0.0, 1.0).sum() * cell**3
    return float(matter) / longest**3, tuple(((sides + 2 * BLOAT) / longest).tolist()), drawn.crowd


def gaussians(fit: Any) -> tuple[float, float, float]:
    """Gaussians at the start, at the end, and on average over the steps."""
    if not hasattr(fit, "init"):  # given, not made
        return float(fit.count), float(fit.count), float(fit.count)
    count = first = float(fit.init.count)
    total = 0.0
    for step in range(1, fit.steps + 1):
        total += count
        if fit.densify is not None and fit.densify.due(step, fit.steps):
            grown = count * (1 + min(GROWTH, fit.densify.growth))
            count = max(count, min(grown, fit.densify.max_count))
    return first, count, total / fit.steps


def kinds(material: Any, motion: Motion) -> tuple[Preset, ...]:
    """Materials of the parts, as ``probe.table_field`` takes them from the table."""
    whole = motion.materials.get("", next(iter(motion.materials.values())))
    known = getattr(material, "library", None) is not None
    words = sorted(set(motion.materials.values())) if known else [whole]
    found = [lookup(word) for word in words]
    found = [presets.melt(kind) for kind in found] if motion.verb == "melting" else found
    given = {name: value for name, value in getattr(material, "override", {}).items() if value is not None}
    return tuple(dataclasses.replace(kind, **given) for kind in found)
