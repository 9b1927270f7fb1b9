"""What a person takes away from a run: its film and other outputs, contact_sheet.png, gaussians.ply and report.html."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffuphy.artifact import SCRATCH, Done
from diffuphy.formats import Options, Run, write
from diffuphy.judgement import judgement
from diffuphy.plan import Plan
from diffuphy.render import contact_sheet, orbit, render_gaussians, write_png
from diffuphy.render.film.colormap import CATEGORY_WORDS, Scale, quantity
from diffuphy.render.film.paint import Mixed
from diffuphy.render.film.video import playback
from diffuphy.render.report import Report, Section
from diffuphy.render.scenes.ply import write as write_ply
from diffuphy.render.sh import from_rgb
from diffuphy.scorecard import scorecard, section
from diffuphy.types import Clip, Gaussians, MaterialField, Particles

FILM = "mp4"
"""The format of a film that everybody can play."""


def export(
    run_dir: Path,
    done: Sequence[Done],
    plan: Plan,
    *,
    title: str,
    settings: str,
    warnings: Sequence[str] = (),
    outputs: Sequence[str] = (FILM,),
) -> dict[str, Path]:
    """Write the deliverables of a run into ``run_dir``; returns their paths by kind.

    Args:
        title: of the report; what the user asked for.
        settings: the composed configuration, YAML.
        warnings: sentences a reader must see.
        outputs: formats (``formats.FORMATS``).
    """
    at = {d.name: d.path for d in done}
    files: dict[str, Path] = {}
    if "gaussians" in at:
        gaussians = Gaussians.load(at["gaussians"])
        files["gaussians"] = run_dir / "gaussians.ply"
        write_ply(files["gaussians"], gaussians)
    if "clip" not in at:
        return files
    run = Run(at, title, around=getattr(plan.components["clip"], "around", None))
    clip = run.clip
    for name, paths in write(run, outputs, Options(run_dir)).items():
        kind = "film" if name == FILM else name
        files |= {kind if k == 0 else f"{kind} {k + 1}": path for k, path in enumerate(paths)}
    files["sheet"] = run_dir / "contact_sheet.png"
    sheet = contact_sheet(clip.rgb, fps=clip.fps)
    write_png(files["sheet"], sheet)
    files["report"] = run_dir / "report.html"
    Report()(
        files["report"],
        title=title,
        film=next((files[kind] for kind in ("film", "webm", "gif") if kind in files), None),
        sheet=sheet.numpy(),
        views=views(gaussians),
        maps=maps(gaussians, run.particles, run.field),
        curves=curves(at),
        plan=[(line.what, line.decision, line.because) for line in plan.lines],
        settings=settings,
        stages=[{"name": d.name, "cached": d.cached, "seconds": d.seconds, "megabytes": d.megabytes} for d in done],
        numbers=numbers(at),
        warnings=[*warnings, *speed(clip), *limited(at["clip"])],
        sections=sections(done),
    )
    return files


def speed(clip: Clip) -> list[str]:
    """What a reader must know of how fast a film is played."""
    if clip.slow == 1.0:
        return []
    how = f"{clip.slow:g} times slower" if clip.slow > 1 else f"{1 / clip.slow:g} times faster"
    return [
        f"The film is played {how} than it happens: {clip.fps:g} frames of a second as {playback(clip):g} a second."
    ]


def limited(clip: Path) -> list[str]:
    """What a reader must know of matter that the film draws shorter than it is stretched."""
    found = _summary(clip)
    if not found.get("limited_frames"):
        return []
    most, frames = found["limited_most"], found["limited_frames"]
    return [
        f"In {frames} frames matter is drawn shorter than it is stretched, at most {most} of {found['particles']} "
        "particles: film.stretch limits them, where matter has flowed or torn apart."
    ]


def sections(done: Sequence[Done]) -> list[Section]:
    """What it is made of, how good the film is, and how wrong."""
    scores, errors = scorecard(done), judgement(done)
    parts = next((_summary(d.path).get("parts", ()) for d in done if d.name == "material"), ())
    made_of = [Section("What it is made of", words=parts)] if parts else []
    return [*made_of, *([section(scores)] if scores else []), *([errors.section()] if errors else [])]


def views(gaussians: Gaussians, size: int = 200) -> list[tuple[str, Any]]:
    """The object from four sides and from above."""
    named = [("front", 0, 12), ("left", 90, 12), ("back", 180, 12), ("right", 270, 12), ("above", 30, 65)]
    camera = orbit([a for _, a, _ in named], torch.tensor([float(e) for *_, e in named]), 3.4, width=size, height=size)
    with torch.no_grad():
        rgb = render_gaussians(gaussians, camera, background=torch.ones(3)).rgb.clamp(0, 1)
    return [(name, image.numpy()) for (name, *_), image in zip(named, rgb, strict=True)]


def maps(gaussians: Gaussians, particles: Particles, field: MaterialField, size: int = 260) -> list[tuple[str, Any]]:
    """The object painted by stiffness and by the laws each particle follows."""
    owner = torch.full((len(gaussians),), -1, dtype=torch.long)
    carried = particles.gaussian >= 0
    owner[particles.gaussian[carried]] = torch.arange(len(particles))[carried]
    visible = owner >= 0
    index = owner[visible]
    camera = orbit([35.0], 18.0, 3.4, width=size, height=size)

    def paint(colors: Tensor) -> Any:
        painted = Gaussians(
            gaussians.means[visible],
            gaussians.quats[visible],
            gaussians.log_scales[visible],
            gaussians.logit_opacities[visible],
            from_rgb(colors[index]),
        )
        with torch.no_grad():
            return render_gaussians(painted, camera, background=torch.ones(3)).rgb[0].clamp(0, 1).numpy()

    stiffness = Scale.of(field.theta["E"], "log")
    ends = [quantity(value, "Pa") for value in (stiffness.lo, stiffness.hi)]
    result = [(f"E: {ends[0]} (dark) to {ends[1]} (bright)", paint(stiffness.colors(field.theta["E"])))]
    for kind in ("elastic", "plastic"):
        laws = Mixed.of(field, kind)
        said = ", ".join(f"{name} {share:.0%} ({CATEGORY_WORDS[k]})" for name, share, k in laws.entries)
        result.append((f"{kind}: {said}", paint(laws.colors)))
    return result


def curves(at: dict[str, Path]) -> dict[str, list[tuple[int, float]]]:
    """Loss of each long stage from its ``metrics.jsonl``; a step written twice by an interrupted run counts once."""
    found: dict[str, dict[int, float]] = {}
    for stage, key in (("gaussians", "sds"), ("gaussians", "gaussians"), ("material", "loss"), ("material", "log10_E")):
        file = at[stage] / SCRATCH / "metrics.jsonl"
        rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
        values = {row["step"]: row[key] for row in rows if isinstance(row.get(key), int | float)}
        if values:
            found[f"{stage}: {key}"] = values
    return {name: sorted(values.items()) for name, values in found.items()}


NOTES = {
    "hardened_loss": "clip loss of the field that is filmed, every particle on one law",
    "loss_at_table": "clip loss at the reference's own parameters: below it one fits discretisation",
    "held_out_motion": "mean squared pixel difference to the table's material in another motion",
    "pruning_change": "largest distance in a drop, over the object's size, with all candidates and with those left",
    "log10_E": "mean stiffness [log₁₀ Pa]",
}


def numbers(at: dict[str, Path]) -> list[tuple[str, str, str]]:
    """What the material stage says about its result."""
    values = {k: v for k, v in _summary(at["material"]).items() if isinstance(v, int | float)}
    return [(k, f"{v:.3g}", NOTES.get(k, "mean weight of this expert")) for k, v in values.items()]


def _summary(stage: Path) -> dict[str, Any]:
    """What a stage said about its result; nothing if it said nothing."""
    file = stage / SCRATCH / "summary.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
