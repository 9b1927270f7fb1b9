"""Does the material stage find what the reference clip is made of?

    python benchmarks/identify.py stiffness      # one-material burger, enumeration off, three starts
    python benchmarks/identify.py experts        # four balls, enumeration on, two seeds
    python benchmarks/identify.py gravel         # weight on Drucker–Prager
    python benchmarks/identify.py takes          # stiffness, by what the steps look at

Objects come straight from the procedural library (no distillation), so that only the material stage is measured. The
reference is the same drop with another draw of particles. Writes docs/benchmarks/identify_<what>.json.
"""

import argparse
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import torch

from diffuphy.learning.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material.presets import lookup
from diffuphy.mpm.sample import Sample
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Gaussians, Look, MaterialField, Motion
from diffuphy.workspace import Workspace

OUT = Path(__file__).parent.parent / "docs" / "benchmarks"
PLASTIC = ("identity", "von_mises", "drucker_prager", "fluid")
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


def weights(field: MaterialField) -> dict[str, float]:
    return dict(zip(field.plastic, field.w_p.mean(0).tolist(), strict=True))


def stiffness(steps: int) -> list[dict]:
    """log10 E of a rubber burger from three starts, without a scan."""
    preset = lookup("rubber")
    truth = torch.tensor(preset.E).log10().item()
    rows = []
    settings = dict(elastic=(preset.elastic,), plastic=("identity",), stiffness_steps=0, steps=steps)
    for start in (truth - 1.9, truth - 1.0, min(truth + 0.7, 6.2)):
        field, seconds = fit("burger", "rubber", start=start, **settings)
        found = field.theta["E"].log10()
        mean, spread = found.mean().item(), found.std().item()
        rows.append({"start": start, "truth": truth, "found": mean, "spread": spread, "seconds": seconds})
        print(f"start {start:.2f}  truth {truth:.2f}  found {mean:.3f} ± {spread:.3f}  {seconds:.0f} s", flush=True)
    return rows


def experts(steps: int) -> list[dict]:
    """The right plastic expert for four balls, two seeds each."""
    rows = []
    for material in ("jelly", "plasticine", "sand", "water"):
        preset = lookup(material)
        for seed in (0, 1):
            settings = dict(elastic=(preset.elastic,), plastic=PLASTIC, steps=steps, seed=seed)
            field, seconds = fit("ball", material, **settings)
            found = weights(field)
            best = max(found, key=found.__getitem__)
            row = {"material": material, "seed": seed, "truth": preset.plastic, "found": found, "seconds": seconds}
            rows.append(row | {"log10_E": field.theta["E"].log10().mean().item()})
            mark = "right" if best == preset.plastic else "WRONG"
            print(f"{material:<11} seed {seed}  {best:<15} {mark}  {found}  {seconds:.0f} s", flush=True)
    return rows


def gravel(steps: int) -> list[dict]:
    preset = lookup("gravel")
    field, seconds = fit("gravel pile", "gravel", elastic=(preset.elastic,), plastic=PLASTIC, steps=steps)
    print(f"gravel {weights(field)}  {seconds:.0f} s")
    return [{"found": weights(field), "seconds": seconds}]


def takes(steps: int) -> list[dict]:
    """log10 E of a stiff and of a soft burger, each from about a decade off, by what the steps look at."""
    rows = []
    for material, off in (("rubber", -1.0), ("jelly", 0.9)):
        preset = lookup(material)
        truth = torch.tensor(preset.E).log10().item()
        settings = dict(elastic=(preset.elastic,), plastic=("identity",), stiffness_steps=0, steps=steps)
        for name, choice in TAKES.items():
            begin = time.process_time()
            field, _ = fit("burger", material, count=4000, start=truth + off, takes=choice, **settings)
            error = field.theta["E"].log10().mean().item() - truth
            row = {"material": material, "takes": name, "error": error, "seconds": time.process_time() - begin}
            rows.append(row)
            print(f"{material:<7} {name:<30} {error:+.3f}  {row['seconds']:.0f} s", flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("stiffness", "experts", "gravel", "takes"))
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    rows = {"stiffness": stiffness, "experts": experts, "gravel": gravel, "takes": takes}[options.what](options.steps)
    options.out.mkdir(parents=True, exist_ok=True)
    machine = f"{os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}"
    (options.out / f"identify_{options.what}.json").write_text(
        json.dumps({"machine": machine, "steps": options.steps, "rows": rows}, indent=1)
    )
    (options.out / "identify.md").write_text(page(options.out))


def page(folder: Path) -> str:
    """All results that are in ``folder`` as one page."""
    found = {
        p.stem.removeprefix("identify_"): json.loads(p.read_text()) for p in sorted(folder.glob("identify_*.json"))
    }
    text = "# What the material stage recovers\n\nThe reference is the same drop with another draw of particles.\n"
    if "stiffness" in found:
        text += f"\n## Stiffness of a rubber burger, no scan\n\n{found['stiffness']['machine']}\n\n"
        text += "| start log₁₀ E | truth | found | spread | error | seconds |\n|---|---|---|---|---|---|\n"
        for r in found["stiffness"]["rows"]:
            text += f"| {r['start']:.2f} | {r['truth']:.2f} | {r['found']:.3f} | {r['spread']:.3f} "
            text += f"| {r['found'] - r['truth']:+.3f} | {r['seconds']:.0f} |\n"
    if "experts" in found:
        text += f"\n## Plastic law of four balls, with the scan\n\n{found['experts']['machine']}\n\n"
        text += "| material | seed | truth | found | log₁₀ E found | seconds |\n|---|---|---|---|---|---|\n"
        for r in found["experts"]["rows"]:
            laws = ", ".join(f"{k} {v:.0%}" for k, v in r["found"].items())
            text += (
                f"| {r['material']} | {r['seed']} | {r['truth']} | {laws} | {r['log10_E']:.2f} | {r['seconds']:.0f} |\n"
            )
    if "gravel" in found:
        (r,) = found["gravel"]["rows"]
        laws = ", ".join(f"{k} {v:.0%}" for k, v in r["found"].items())
        text += f"\n## Gravel pile\n\n{found['gravel']['machine']}: {laws}, {r['seconds']:.0f} s.\n"
    if "takes" in found:
        text += takes_section(found["takes"])
    return text


def takes_section(found: dict[str, Any]) -> str:
    """What steps look at, and what comes out: a row for each choice, a column for each material."""
    rows = {name: {r["material"]: r for r in found["rows"] if r["takes"] == name} for name in TAKES}
    text = f"\n## Stiffness of a burger, by what the steps look at\n\n{found['machine']}, {found['steps']} steps, "
    text += "one seed; seconds of processor time.\n\n"
    text += "| `takes` | rubber: error of log₁₀ E | jelly | seconds, rubber | jelly |\n"
    text += "|---|--:|--:|--:|--:|\n"
    for name, by in rows.items():
        errors, seconds = (
            " | ".join(f"{by[m][k]:{f}}" for m in by) for k, f in (("error", "+.3f"), ("seconds", ".0f"))
        )
        text += f"| {name} | {errors} | {seconds} |\n"
    return text


if __name__ == "__main__":
    main()
