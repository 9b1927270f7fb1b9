"""Stiffness of a burger by the whole stage, by what the steps of its training look at.

Objects come straight from the procedural library (no distillation), so that only the material stage is measured. The
reference is the same drop with another draw of particles.
"""

import time
from pathlib import Path
from typing import Any

import torch

from benchmarks.identify.rows import Rows
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material.presets import lookup
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Gaussians, Look, MaterialField, Motion
from diffuphy.workspace import Workspace

TAKES = {
    "all frames": Takes(),
    "windows of 6": Takes("window", count=6),
    "blocks of 6": Takes("consecutive", count=6),
    "every 2nd": Takes("strided", stride=2),
    "8 cameras": Takes(views=8),
    "white background": Takes(background="white"),
    "random backgrounds": Takes(background="random"),
    "8 cameras, random backgrounds": Takes(views=8, background="random"),
}


def dressed(subject: str, *, count: int = 8000, seed: int = 0) -> tuple[Look, Gaussians]:
    """A library object as Gaussians on its surface, round, opaque, in the object's colours."""
    look = Look(subject, f"a {subject}")
    points, colors = Library().object(look).surface(count, torch.Generator().manual_seed(seed))
    spacing = torch.tensor((12.0 / count) ** 0.5)  # a body of side 2 has a surface of about 12
    n = len(points)
    return look, Gaussians(
        points,
        torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
        (0.6 * spacing).log().expand(n, 3).clone(),
        torch.full((n,), 4.0),
        from_rgb(colors),
    )


def fit(subject: str, material: str, *, count: int = 8000, **settings: Any) -> tuple[MaterialField, float]:
    """Fit the material of a library object; returns the field and the seconds it took."""
    look, gaussians = dressed(subject, count=count)
    motion = Motion("falling", f"a {material} {subject} falling", {"": material})
    particles = Sample()(gaussians, motion, work=Workspace())
    guidance = Analytic(layout="clip", s=0.0)
    component = FitMaterial(guidance=guidance, library=Library(), velocity=Velocity(weight=0.0), **settings)
    start = time.perf_counter()
    field = component(look, motion, gaussians, particles, work=Workspace(progress=True))
    return field, time.perf_counter() - start


def study(out: Path, steps: int) -> Rows:
    """log10 E of a stiff and of a soft burger, each from about a decade off, by what the steps look at."""
    rows = Rows(out / "identify_takes.json", ("material", "takes"))
    for material, off in (("rubber", -1.0), ("jelly", 0.9)):
        preset = lookup(material)
        truth = torch.tensor(preset.E).log10().item()
        settings = dict(elastic=(preset.elastic,), plastic=("identity",), stiffness_steps=0, steps=steps)
        for name, choice in TAKES.items():
            if not rows.has(material=material, takes=name):
                begin = time.process_time()
                field, _ = fit("burger", material, count=4000, start=truth + off, takes=choice, **settings)
                error = field.theta["E"].log10().mean().item() - truth
                rows.add(material=material, takes=name, error=error, seconds=time.process_time() - begin, steps=steps)
    return rows


def section(found: dict[str, Any]) -> str:
    """What steps look at, and what comes out: a row for each choice, a column for each material."""
    steps = found.get("steps") or found["rows"][0]["steps"]
    rows = {name: {r["material"]: r for r in found["rows"] if r["takes"] == name} for name in TAKES}
    text = f"\n## Stiffness of a burger, by what the steps look at\n\n{found['machine']}, {steps} steps, "
    text += "one seed; seconds of processor time.\n\n"
    text += "| `takes` | rubber: error of log₁₀ E | jelly | seconds, rubber | jelly |\n"
    text += "|---|--:|--:|--:|--:|\n"
    for name, by in rows.items():
        errors, seconds = (
            " | ".join(f"{by[m][k]:{f}}" for m in by) for k, f in (("error", "+.3f"), ("seconds", ".0f"))
        )
        text += f"| {name} | {errors} | {seconds} |\n"
    return text
