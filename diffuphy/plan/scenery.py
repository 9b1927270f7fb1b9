"""What the scene and the scheme of its simulation ask for."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from diffuphy.plan.line import Line
from diffuphy.types import Motion


def scene_lines(components: Mapping[str, Any], motion: Motion) -> list[Line]:
    """Gravity, walls and drives of the film."""
    play = components["trajectory"]
    cells = components["particles"].cells
    scene = play.scene(motion, _Spaced(motion.size / cells / play.particles_per_cell ** (1 / 3)))
    walls = scene.boundaries
    kinds = ", ".join(sorted({f"{w.kind} {type(w).__name__}" for w in walls}))
    rough = [w.friction for w in walls if w.kind == "separate" and w.friction > 0]
    moving = [type(w).__name__ for w in walls if not w.still]
    return [
        Line.kept("gravity", any(scene.gravity), f"{scene.gravity[2]:g} m/s²", "the scene has none"),
        Line.kept("walls", bool(walls), kinds, "the scene has none"),
        Line.kept("friction", bool(rough), f"μ = {max(rough, default=0):g}", "every wall is smooth"),
        Line.kept("moving walls", bool(moving), ", ".join(moving), "every wall rests: one row of wall data a frame"),
        Line.kept("drives", bool(scene.drives), f"{len(scene.drives)} of them", "nothing but walls and gravity acts"),
    ]


def scheme_lines(components: Mapping[str, Any]) -> list[Line]:
    """Parts of transfer and time integration, and what is measured on the way."""
    play = components["trajectory"]
    scheme = play.scheme

    def other(**settings: Any) -> dict[str, Any]:
        return {"trajectory": dataclasses.replace(play, scheme=dataclasses.replace(scheme, **settings))}

    return [
        Line.kept("half kick", scheme.half_kick, "second order in Δt", "scheme.half_kick=false", other(half_kick=True)),
        Line.kept("mirror walls", scheme.mirror, "second order in Δx", "scheme.mirror=false", other(mirror=True)),
        Line.kept("sharpening", scheme.sharpen, "takes inertia of the affine field away", "scheme.sharpen=false",
                  other(sharpen=True)),
        Line.kept("retention", scheme.retain > 0, f"τ = {scheme.retain:g} Δx/c", "scheme.retain=0", other(retain=1.0)),
        Line.kept("elastic contact", scheme.contact == "elastic", "bodies touch the floor", "scheme.contact=rigid",
                  other(contact="elastic")),
        Line.kept("cubic splines", scheme.order == 3, "64 nodes a particle", "scheme.order=2", other(order=3)),
        Line.kept("double precision", play.double, "trajectory.double=true", "float32 suffices for a film",
                  {"trajectory": dataclasses.replace(play, double=True)}),
        Line("diagnostics", "left out", "energies and momenta are summed for simulate(diagnose=True) only"),
    ]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class _Spaced:
    """Particles as far as a scene asks for them."""

    spacing: float
    """Mean distance [m]."""
