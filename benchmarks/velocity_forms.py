"""What each form of the velocity loss says of a stiffness, and what it does to its recovery.

    python -m benchmarks velocity_forms                       # two targets, twelve starts; recoveries
    python -m benchmarks velocity_forms --targets 5.0 --starts 3 --steps 0

A ball falls; its stiffness is one number, learnt by ``descent.descend`` without a network. Each form is asked at many
stiffnesses for its value and its slope: does downhill lead to the target? Then each is added to the distillation of the
clip, which is the prior's own drop with another draw of particles. Writes docs/benchmarks/velocity_forms.*.
"""

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks._draw import Curve, Plot, plots
from benchmarks.speed.body import describe
from diffuphy.learning.case import Case
from diffuphy.learning.descent import Descent, Model, descend
from diffuphy.learning.probe import Probe
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Take
from diffuphy.losses.velocity import Velocity
from diffuphy.render.sh import from_rgb
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles
from diffuphy.workspace import Workspace

OUT = Path(__file__).parents[1] / "docs" / "benchmarks"
FORMS = ("literal", "consistent", "momentum", "image")
CLIP = "clip"
"""The distillation itself, beside the forms."""
ADDED: tuple[tuple[str, float], ...] = (
    ("none", 0.0), ("image", 0.1), ("literal", 0.01), ("consistent", 0.001),
)  # fmt: skip
"""Forms and weights added to the distillation [s²/m²]."""
OFF = 0.8
"""Distance of the starts of a recovery from its target [decades]."""


class OneStiffness(Model):
    """log10 E of the whole body; everything else is the table's."""

    def __init__(self, table: MaterialField, start: float):
        super().__init__()
        self.table, self.log_E = table, torch.nn.Parameter(torch.tensor(start, dtype=torch.float64))

    def forward(self) -> MaterialField:
        E = (10**self.log_E).to(self.table.rho.dtype).expand(len(self.table))
        return dataclasses.replace(self.table, theta=self.table.theta | {"E": E})

    def groups(self) -> list[dict[str, Any]]:
        return [{"params": [self.log_E], "lr": 0.15}]


def ball(n: int = 14, size: float = 0.4) -> tuple[Gaussians, Particles]:
    """A striped ball on a lattice, a Gaussian on each particle."""
    a = (torch.arange(n) + 0.5) / n * 2 - 1
    x = torch.cartesian_prod(a, a, a)
    x = x[x.norm(dim=1) < 1]
    G, h = len(x), size / n
    stripes = (torch.sin(7 * x[:, 2:]) > 0).float()
    rgb = stripes * torch.tensor([0.9, 0.3, 0.2]) + (1 - stripes) * torch.tensor([0.95, 0.8, 0.3])
    gaussians = Gaussians(
        x, torch.tensor([1.0, 0, 0, 0]).repeat(G, 1), torch.full((G, 3), 1.2 / n).log(), torch.full((G,), 4.0),
        from_rgb(rgb),
    )  # fmt: skip
    return gaussians, Particles(x * size / 2, torch.full((G,), h**3), torch.arange(G), size / 2, (0.0, 0.0, 0.0), h)


def case(target: float) -> Case:
    """The ball on the bench; the prior knows it at 10^target Pa."""
    motion = Motion("falling", "it falls", {"": "jelly"}, 0.4)
    probe = Probe(particles=300, frames=10, image=32)
    guidance = Analytic(layout="clip", s=0.0)
    return Case.make(probe, guidance, None, Look("ball", "a ball"), motion, *ball(), override={"E": 10**target})


def asked(case: Case, log_E: float) -> dict[str, tuple[float, float]]:
    """Value of each form and of the distillation at a stiffness, and its slope for each decade."""
    model = OneStiffness(case.table, log_E)
    found: dict[str, tuple[float, float]] = {}
    for form in (CLIP, *FORMS):
        field, reports = model(), []
        velocity = Velocity("literal" if form == CLIP else form, 1.0)  # type: ignore[arg-type]
        drop = case.bench.simulate(field, report=reports, gather=(velocity.needs,) if velocity.needs else ())
        if form == CLIP:
            generator = torch.Generator().manual_seed(1)
            loss: Tensor = case.cond.distil(drop, Take.whole(10), t=0.5, generator=generator, weight="x0")
        else:
            loss = case.bench.velocity_loss(velocity, drop, field, reports, case.cond.target())
        (slope,) = torch.autograd.grad(loss, model.log_E)
        found[form] = (float(loss.detach()), float(slope))
    return found


def recovered(case: Case, start: float, form: str, weight: float, steps: int) -> float:
    """log10 E found from a start with a form added to the distillation; all steps are taken."""
    model = OneStiffness(case.table, start)
    velocity = None if form == "none" else Velocity(form, weight)  # type: ignore[arg-type]
    settings = Descent(steps=steps, velocity=velocity, patience=0, check=steps)
    descend(case, model, settings, Workspace(progress=False))
    return float(model.log_E.detach())


def page(result: dict[str, Any]) -> str:
    """Agreement of the slopes, recoveries, the figure."""
    scan, rows = result["scan"], result["recovered"]
    text = "# The forms of the velocity loss, measured\n\n"
    text += f"A ball of 0.4 m on the drop test (300 particles, 10 frames of 32 × 32 px), {result['machine']}. "
    text += "`python -m benchmarks velocity_forms`. See [the velocity loss](../velocity.md) for what the forms are.\n\n"
    text += "## Does downhill lead to the target?\n\nShare of starts whose negative slope points to the target; starts "
    text += "within 0.15 decades of it are left out.\n\n| | " + " | ".join(f"target {t:g}" for t in result["targets"])
    text += " | median size of the slope |\n|---|" + "--:|" * (len(result["targets"]) + 1) + "\n"
    for form in (CLIP, *FORMS):
        cells = []
        for target in result["targets"]:
            far = [r for r in scan if r["target"] == target and abs(r["start"] - target) > 0.15]
            cells.append(f"{sum(r[form][1] * (r['start'] - target) > 0 for r in far)} of {len(far)}")
        sizes = sorted(abs(r[form][1]) for r in scan)
        text += f"| {form} | {' | '.join(cells)} | {sizes[len(sizes) // 2]:.1e} |\n"
    text += "\n![Value of each form against stiffness](velocity_forms.png)\n"
    if rows:
        text += f"\n## What it does to a recovery\n\n{result['steps']} steps from {OFF} decades below and above; error "
        text += "of log₁₀ E.\n\n| form | weight [s²/m²] | " + " | ".join(
            f"{t:g} from {t + s * OFF:g}" for t in result["targets"] for s in (-1, 1)
        )
        text += " |\n|---|--:|" + "--:|" * (2 * len(result["targets"])) + "\n"
        done = {(r["form"], r["weight"]) for r in rows}
        for form, weight in (a for a in ADDED if a in done):
            mine = [r for r in rows if (r["form"], r["weight"]) == (form, weight)]
            text += f"| {form} | {weight:g} | " + " | ".join(f"{r['found'] - r['target']:+.3f}" for r in mine) + " |\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", nargs="+", type=float, default=[4.6, 5.4])
    parser.add_argument("--starts", type=int, default=12, help="stiffnesses asked, from 10^3.8 to 10^6 Pa")
    parser.add_argument("--steps", type=int, default=16, help="of a recovery; 0 leaves recoveries out")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    starts = torch.linspace(3.8, 6.0, options.starts, dtype=torch.float64).tolist()
    scan, rows = [], []
    for target in options.targets:
        made = case(target)
        scan += [{"target": target, "start": s} | asked(made, s) for s in starts]
        print(f"target {target}: asked", flush=True)
    result = {"machine": describe("cpu"), "targets": options.targets, "steps": options.steps}
    result |= {"scan": scan, "recovered": rows}
    write(options.out, result)
    for form, weight in ADDED if options.steps else ():
        for target in options.targets:
            made = case(target)
            for start in (target - OFF, target + OFF):
                found = recovered(made, start, form, weight, options.steps)
                rows.append({"form": form, "weight": weight, "target": target, "start": start, "found": found})
                print(json.dumps(rows[-1]), flush=True)
        write(options.out, result)


def write(out: Path, result: dict[str, Any]) -> None:
    """What is known so far: numbers, page, figure."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "velocity_forms.json").write_text(json.dumps(result, indent=1))
    (out / "velocity_forms.md").write_text(page(result))
    several = [
        Plot(form, "E [Pa]", "m2/s2" if form != CLIP else "clip loss", [
            Curve(f"target {t:g}", [(10 ** r["start"], r[form][0]) for r in result["scan"] if r["target"] == t], i)
            for i, t in enumerate(result["targets"])
        ])
        for form in (CLIP, *FORMS)
    ]  # fmt: skip
    plots(out / "velocity_forms.png", "Value of each form where the stiffness is E", several)


if __name__ == "__main__":
    main()
