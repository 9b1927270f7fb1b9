"""What a person takes away from a run: film.mp4, contact_sheet.png, gaussians.ply and report.html."""

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffuphy.artifact import SCRATCH, Done
from diffuphy.judgement import judgement
from diffuphy.plan import Plan
from diffuphy.render import contact_sheet, orbit, render_gaussians, write_mp4, write_png
from diffuphy.render.ply import write as write_ply
from diffuphy.render.report import Report, Section
from diffuphy.render.sh import from_rgb
from diffuphy.scorecard import scorecard, section
from diffuphy.types import Clip, Gaussians, MaterialField, Particles

COLD, WARM = torch.tensor([0.23, 0.30, 0.75]), torch.tensor([0.71, 0.02, 0.15])
"""Ends of the colour scale of the maps (Moreland 2009, cool–warm)."""
EXPERT_COLORS = torch.tensor(
    [
        [0.27, 0.47, 0.67],
        [0.93, 0.40, 0.47],
        [0.80, 0.73, 0.27],
        [0.13, 0.53, 0.20],
        [0.67, 0.20, 0.47],
        [0.40, 0.80, 0.93],
    ]
)
"""One colour an expert, distinguishable by colour-blind readers (Tol, bright)."""


def export(
    run_dir: Path, done: Sequence[Done], plan: Plan, *, title: str, settings: str, warnings: Sequence[str] = ()
) -> dict[str, Path]:
    """Write the deliverables of a run into ``run_dir``; returns their paths by kind.

    Args:
        title: of the report; what the user asked for.
        settings: the composed configuration, YAML.
        warnings: sentences a reader must see.
    """
    at = {d.name: d.path for d in done}
    files: dict[str, Path] = {}
    if "gaussians" in at:
        gaussians = Gaussians.load(at["gaussians"])
        files["gaussians"] = run_dir / "gaussians.ply"
        write_ply(files["gaussians"], gaussians)
    if "clip" not in at:
        return files
    clip = Clip.load(at["clip"])
    files["film"] = run_dir / "film.mp4"
    files["sheet"] = run_dir / "contact_sheet.png"
    write_mp4(files["film"], clip.rgb, clip.fps)
    sheet = contact_sheet(clip.rgb, fps=clip.fps)
    write_png(files["sheet"], sheet)
    particles, field = Particles.load(at["particles"]), MaterialField.load(at["material"])
    files["report"] = run_dir / "report.html"
    Report()(
        files["report"],
        title=title,
        film=files["film"],
        sheet=sheet.numpy(),
        views=views(gaussians),
        maps=maps(gaussians, particles, field),
        curves=curves(at),
        plan=[(line.what, line.decision, line.because) for line in plan.lines],
        settings=settings,
        stages=[{"name": d.name, "cached": d.cached, "seconds": d.seconds, "megabytes": d.megabytes} for d in done],
        numbers=numbers(at),
        warnings=list(warnings),
        sections=sections(done),
    )
    return files


def sections(done: Sequence[Done]) -> list[Section]:
    """What it is made of, how good the film is, and how wrong."""
    scores, errors = scorecard(done), judgement(done)
    parts = _summary({d.name: d.path for d in done}).get("parts", ())
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

    log_E = field.theta["E"].log10()
    lo, hi = float(log_E.min()), float(log_E.max())
    share = ((log_E - lo) / max(hi - lo, 1e-6))[:, None]
    result = [(f"log₁₀ E: {lo:.2f} (blue) to {hi:.2f} (red) Pa", paint(COLD * (1 - share) + WARM * share))]
    for kind, names, w in (("elastic", field.elastic, field.w_e), ("plastic", field.plastic, field.w_p)):
        shares = zip(names, w.mean(0).tolist(), itertools.cycle(COLOR_WORDS))
        legend = ", ".join(f"{name} {share:.0%} ({word})" for name, share, word in shares)
        palette = EXPERT_COLORS[torch.arange(len(names)) % len(EXPERT_COLORS)]
        result.append((f"{kind}: {legend}", paint(w @ palette)))
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


COLOR_WORDS = ("blue", "red", "yellow", "green", "purple", "cyan")
"""Names of EXPERT_COLORS."""

NOTES = {
    "hardened_loss": "clip loss of the field that is filmed, every particle on one law",
    "loss_at_table": "clip loss at the reference's own parameters: below it one fits discretisation",
    "held_out_motion": "mean squared pixel difference to the table's material in another motion",
    "pruning_change": "largest distance in a drop, over the object's size, with all candidates and with those left",
    "log10_E": "mean stiffness [log₁₀ Pa]",
}


def numbers(at: dict[str, Path]) -> list[tuple[str, str, str]]:
    """What the material stage says about its result."""
    values = {k: v for k, v in _summary(at).items() if isinstance(v, int | float)}
    return [(k, f"{v:.3g}", NOTES.get(k, "mean weight of this expert")) for k, v in values.items()]


def _summary(at: Mapping[str, Path]) -> dict[str, Any]:
    """What the material stage wrote about its result; nothing where the material was given."""
    file = at["material"] / SCRATCH / "summary.json" if "material" in at else None
    return json.loads(file.read_text(encoding="utf-8")) if file is not None and file.exists() else {}
