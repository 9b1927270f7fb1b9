"""What finding the material asks for."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffuphy.plan.line import Line


def loss_lines(components: Mapping[str, Any], device: str = "cpu") -> list[Line]:
    """Scan, gradient and losses of the material.

    Args:
        device: where the run will be.
    """
    fit = components["material"]
    if hasattr(fit, "plan"):  # a rival of our own method
        return [
            Line("method", fit.NAME, "docs/methods.md says what it reproduces"),
            *(Line(*said) for said in fit.plan()),
        ]
    if not hasattr(fit, "steps"):
        what = ", ".join(fit.words) + " by label" if hasattr(fit, "words") else f"{len(fit.pieces)} pieces"
        return [Line("material", "given", f"{what}, with laws and parameters: nothing is learnt")]
    velocity = fit.velocity
    gathered = (velocity is not None and velocity.weight > 0 and velocity.needs) or ""
    defaults = {f.name: f.default for f in dataclasses.fields(fit)}

    def other(name: str) -> dict[str, Any]:
        return {"material": dataclasses.replace(fit, **{name: defaults[name]})}

    return [
        Line.kept("video SDS", bool(fit.steps), "it trains the material", "material.steps=0", other("steps")),
        *(clip_lines(fit) if fit.steps else ()),
        Line.kept("gradient", bool(fit.steps), "training goes back through the simulation",
                  "nothing is trained: no adjoint kernel, no state kept"),
        Line("velocity loss", velocity.form, f"weight {velocity.weight:g}")
        if velocity is not None and velocity.weight > 0
        else Line("velocity loss", "left out", "weight 0"),
        Line.kept("gathered sums", bool(gathered) and bool(fit.steps), f"the velocity loss needs {gathered}",
                  "no loss needs impulses or forces"),
        Line.kept("enumeration", bool(fit.stiffness_steps), "finds the basin before descending",
                  "material.stiffness_steps=0", other("stiffness_steps")),
        *([_launches(device)] if fit.stiffness_steps else ()),
        Line("certainty", "left out", "material.pixel_noise is null") if fit.pixel_noise is None
        else Line("certainty", "stated", f"standard errors at a pixel noise of {fit.pixel_noise:g}"),
        *(training_lines(fit) if fit.steps else ()),
    ]  # fmt: skip


def _launches(device: str) -> Line:
    if device.startswith("cuda"):
        return Line("hypotheses", "batched", "those of one time step in one launch")
    return Line("hypotheses", "one by one", "on a CPU one launch of all takes no less time")


def training_lines(fit: Any) -> list[Line]:
    """What is learnt, from how many starts, and when it ends."""
    choice = bool(fit.stiffness_steps) and len(fit.plastic) > 1
    few = choice and fit.refine > 1 and fit.refine_steps > 0
    gates = {
        "softmax": "every candidate keeps a share; hardened for the film",
        "sparsemax": "shares reach zero exactly; hardened for the film",
        "start": "laws are those of the scan; no other law is simulated in training",
    }
    mixed = len(fit.elastic) * len(fit.plastic) > 1
    return [
        Line("learnt parameters", ", ".join(fit.learn), "the others are the table's"),
        Line("gate", fit.net.gate, gates[fit.net.gate]) if mixed else Line("gate", "left out", "one law"),
        *([Line("encoder", "pre-trained", f"weights of {Path(given).name}")] if (given := fit.net.pretrained) else ()),
        Line.kept("refinement", few, f"the {fit.refine} best choices of laws take {fit.refine_steps} steps each",
                  "one choice of laws" if not choice else "material.refine=1 or refine_steps=0"),
        Line.kept("early stop", bool(fit.patience), f"{fit.patience} scores without progress end the training",
                  "material.patience=0"),
    ]  # fmt: skip


def clip_lines(fit: Any) -> list[Line]:
    """What a step looks at, and what is kept of it for the way back."""
    takes, total = fit.takes, fit.probe.frames
    block = f"{takes.shown(total)} of {total} frames"
    frames = {
        "all": f"all {total} frames",
        "consecutive": f"{block}, blocks in turn",
        "strided": f"{block}, every {takes.stride}th",
        "window": f"{block}, from a random start",
    }[takes.frames]
    camera = "one camera" if takes.views == 1 else f"one of {takes.views} cameras"
    background = {"own": "its own", "white": "a white", "random": "a random"}[takes.background]
    whole = not getattr(fit.guidance, "frames_alone", False)
    widths = ", ".join(f"{share:.3g}" for share in fit.descent().blur if share)
    return [
        Line("clip of a step", frames, f"{camera}, {background} background"),
        Line("low-pass", "first", f"blurred by {widths} of the picture: sharp ones mislead a start that is too soft")
        if widths
        else Line("low-pass", "left out", "after a scan the clip is near" if fit.stiffness_steps else "material.blur"),
        Line(
            "graph of the clip", "autoencoder alone", "the prior encodes clips whole; frames are drawn again one by one"
        )
        if whole
        else Line("graph of the clip", "left out", "frames are drawn and encoded again one by one"),
    ]


def model_lines(components: Mapping[str, Any]) -> list[Line]:
    """Weights that are loaded, and the memory that they and their work take."""
    pictures, clips = components["gaussians"], components["material"]
    lines = []
    if hasattr(pictures, "guidance") and type(pictures.guidance).__name__ != "Analytic":
        lines.append(_model_line(pictures.guidance, pictures.views, "pictures"))
    if type(getattr(clips, "guidance", None)).__name__ not in ("Analytic", "NoneType"):
        lines.append(_model_line(clips.guidance, clips.probe.frames, "frames"))
    if (shape := getattr(pictures, "shape", None)) is not None:
        lines.append(_model_line(shape.guidance, shape.copies, "clouds"))
    return lines or [Line("diffusion models", "left out", "guidance is the embedded prior, which needs none")]


def _model_line(guidance: Any, count: int, what: str) -> Line:
    name = type(guidance).__name__
    if not hasattr(guidance, "footprint"):
        return Line("diffusion model", name, "asked for by guidance; what it takes is not predicted")
    try:
        footprint = guidance.footprint(count)
    except FileNotFoundError as missing:
        return Line("diffusion model", name, str(missing))
    return Line("diffusion model", name, f"{count} {what} at a time: {footprint.parts}", megabytes=footprint.peak / 1e6)
