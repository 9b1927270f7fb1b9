"""What this scene needs, what is left out, and why; decided before anything heavy starts.

A plan takes the composed components and the refined prompt, replaces every setting that was left open (``None``) by
what the scene needs, and says so line by line. The pipeline then runs the components *of the plan*: it is obeyed by
construction.
"""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diffuphy.accuracy import choose
from diffuphy.artifact import Stage
from diffuphy.material import make_mixture
from diffuphy.material.presets import candidates
from diffuphy.types import Motion, Prompt


@dataclass(frozen=True)
class Line:
    """One decision."""

    what: str
    """The part of the system decided on."""
    decision: str
    """``run``, ``cached``, ``kept``, ``left out`` or a value."""
    why: str

    @classmethod
    def kept(cls, what: str, needed: bool, why: str, why_not: str) -> "Line":
        """A part that is kept where it is needed."""
        return cls(what, "kept" if needed else "left out", why if needed else why_not)


@dataclass(frozen=True)
class Plan:
    """Components with nothing left open, and the reasons."""

    components: dict[str, Any]
    lines: tuple[Line, ...]

    def __str__(self) -> str:
        width = [max(len(getattr(line, f)) for line in self.lines) for f in ("what", "decision")]
        rows = (f"  {line.what:<{width[0]}}  {line.decision:<{width[1]}}  {line.why}" for line in self.lines)
        return "plan\n" + "\n".join(rows)

    def save(self, path: Path) -> None:
        path.write_text(json.dumps([dataclasses.asdict(line) for line in self.lines], indent=1, ensure_ascii=False))


def make_plan(components: dict[str, Any], prompt: Prompt, *, accuracy: float | None = None) -> Plan:
    """Resolve the open settings of ``components`` for ``prompt``.

    Args:
        components: one component a stage, by stage name; see ``pipeline.stages``.
        accuracy: error that the film may have, over the size of the object; None keeps the grid of the components.

    Raises:
        accuracy.Unreachable: an accuracy that no grid promises.
    """
    components, chosen = refined(components, prompt, accuracy)
    elastic, plastic, why = experts(components["material"], prompt.motion)
    material = dataclasses.replace(components["material"], elastic=elastic, plastic=plastic)
    resolved = components | {"material": material}
    resolved |= judged(components) | scored(resolved)
    lines = [
        *chosen,
        Line("elastic experts", ", ".join(elastic), why),
        Line("plastic experts", ", ".join(plastic), why),
        *mixture_lines(elastic, plastic),
        *appearance_lines(components),
        *loss_lines(material),
        *model_lines(components),
        *error_lines(components),
        *score_lines(resolved),
    ]
    return Plan(resolved, tuple(lines))


def experts(material: Any, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
    """Candidate experts: those the configuration names, else those the materials of the prompt may be."""
    words = sorted(set(motion.materials.values()))
    elastic, plastic = candidates(words, melting=motion.verb == "melting")
    chosen = (tuple(material.elastic) or elastic, tuple(material.plastic) or plastic)
    why = "named in the configuration" if material.elastic or material.plastic else f"what {', '.join(words)} may be"
    return (*chosen, why)


def mixture_lines(elastic: tuple[str, ...], plastic: tuple[str, ...]) -> list[Line]:
    mixture = make_mixture(elastic, plastic)
    flows = [p for p in plastic if p != "identity"]
    gradients = (
        Line("deformation gradients", "two", "the elastic part makes stress, the total one moves the Gaussians")
        if mixture.is_plastic
        else Line("deformation gradients", "one", "without plasticity the elastic part is the total one")
    )
    return [
        Line.kept("return mapping", bool(flows), f"{', '.join(flows)} may flow", "nothing flows"),
        gradients,
        Line.kept(
            "principal decomposition",
            mixture.decomposes,
            "some expert works in principal stretches",
            "every expert has a direct form",
        ),
        Line.kept(
            "mixture weights",
            len(elastic) * len(plastic) > 1,
            f"{len(elastic)} elastic, {len(plastic)} plastic experts",
            "one law",
        ),
    ]


def appearance_lines(components: dict[str, Any]) -> list[Line]:
    degree = components["gaussians"].sh_degree
    harmonics = (
        Line("spherical harmonics", f"degree {degree}", "view-dependent colour asked for")
        if degree
        else Line("spherical harmonics", "left out", "degree 0: colours do not depend on the view, nothing to rotate")
    )
    fill = Line.kept(
        "interior fill",
        components["particles"].fill != "none",
        "distilled Gaussians are a shell; the inside needs particles",
        "sample.fill=none",
    )
    return [harmonics, fill]


def loss_lines(material: Any) -> list[Line]:
    velocity = material.velocity
    return [
        Line.kept("video SDS", bool(material.steps), "it trains the material", "material.steps=0"),
        Line("velocity loss", velocity.form, f"weight {velocity.weight:g}")
        if velocity is not None and velocity.weight > 0
        else Line("velocity loss", "left out", "weight 0"),
        Line.kept(
            "enumeration",
            bool(material.stiffness_steps),
            "finds the basin before descending",
            "material.stiffness_steps=0",
        ),
    ]


def model_lines(components: dict[str, Any]) -> list[Line]:
    backends = {type(components[s].guidance).__name__ for s in ("gaussians", "material")}
    heavy = sorted(backends - {"Analytic"})
    if heavy:
        return [Line("diffusion models", ", ".join(heavy), "asked for by guidance")]
    why = "the embedded prior answers; diffusers and transformers are never imported"
    return [Line("diffusion models", "left out", why)]


def refined(components: dict[str, Any], prompt: Prompt, accuracy: float | None) -> tuple[dict[str, Any], list[Line]]:
    """Grid, spline and precision for an accuracy that was asked for."""
    if accuracy is None:
        return components, []
    choice = choose(accuracy, prompt.motion)
    why = f"an error of {choice.error:.1%} of the size, from the curves for {', '.join(choice.families)} matter"
    return choice.applied(components), [Line(f"accuracy {accuracy:g}", str(choice), why)]


def judged(components: dict[str, Any]) -> dict[str, Any]:
    """The error estimate, made of the run that it judges."""
    if "errors" not in components:
        return {}
    estimate = components["errors"]
    scene, film = estimate.scene or components["trajectory"], estimate.film or components["clip"]
    return {"errors": dataclasses.replace(estimate, scene=scene, film=film)}


def error_lines(components: dict[str, Any]) -> list[Line]:
    if "errors" not in components:
        return []
    e = components["errors"]
    if e.error == "off":
        return [Line("error estimate", "left out", "report.error=off")]
    drafts = ["twice the grid spacing", *["half the time step"] * e.time, *["the other precision"] * e.precision]
    return [Line("error estimate", "kept", f"coarse drafts with {', '.join(drafts)}")]


def scored(components: dict[str, Any]) -> dict[str, Any]:
    """The evaluation, made of the run that it scores, of what this machine can compute."""
    if "evaluate" not in components or components["evaluate"].score == "off":
        return {}
    return {"evaluate": components["evaluate"].planned(components)}


def score_lines(components: dict[str, Any]) -> list[Line]:
    if "evaluate" not in components:
        return []
    e = components["evaluate"]
    if e.score == "off":
        return [Line("scores", "left out", "evaluate.score=off")]
    reasons: dict[str, list[str]] = {}
    for name, why in e.absent.items():
        reasons.setdefault(why, []).append(name)
    left = [Line(", ".join(names), "left out", why) for why, names in reasons.items()]
    return [Line("scores", "kept", "physical checks, silhouettes and colours need no weights"), *left]


def stage_lines(stages: list[Stage], cached: dict[str, Path], until: str, force: list[str]) -> list[Line]:
    """Which stages run. Keys are content-addressed, so what follows a stage that must run is known only afterwards."""
    lines = []
    known = True
    for stage in stages[: [s.name for s in stages].index(until) + 1]:
        if stage.name in cached and stage.name not in force:
            lines.append(Line(f"stage {stage.name}", "cached", "same settings, same inputs"))
            continue
        if stage.name in force:
            why = "forced"
        else:
            why = "not in the store" if known else "unless its inputs come out unchanged"
        lines.append(Line(f"stage {stage.name}", "run", why))
        known = False
    return lines
