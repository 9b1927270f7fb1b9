"""Two materials in one object: an elastic bun round a plastic patty, nothing told but that there are two.

    python -m benchmarks two_regions                               # every way, three seeds
    python -m benchmarks two_regions --ways softmax uniform --seeds 0

The reference is the same drop with another draw of particles. Every region may follow any of four plastic laws, from
uniform weights: either all combinations are scanned first, or the training starts from the uniform mixture itself. The
ways differ in that, and in the gate: ``softmax`` never reaches zero, ``sparsemax`` does, ``start`` keeps what the scan
chose. Writes docs/benchmarks/two_regions.*.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import torch

from benchmarks.identify import dressed
from benchmarks.speed.body import describe
from diffuphy.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.material.net import Net
from diffuphy.material.presets import lookup
from diffuphy.mpm.sample import Sample
from diffuphy.probe import Probe, table_field
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Look, Motion
from diffuphy.workspace import Workspace

OUT = Path(__file__).parents[1] / "docs" / "benchmarks"
PLASTIC = ("identity", "von_mises", "drucker_prager", "fluid")
BUN, PATTY = "gelatin", "playdoh"
WAYS: dict[str, dict[str, Any]] = {
    "softmax": {},
    "softmax, best of the scan alone": {"refine": 1},
    "sparsemax": {"gate": "sparsemax", "bias": 0.99},
    "start": {"gate": "start"},
    "uniform, softmax": {"stiffness_steps": 0, "start": 5.2},
    "uniform, sparsemax": {"stiffness_steps": 0, "start": 5.2, "gate": "sparsemax", "bias": 0.99},
}
"""Settings of the material stage by the name of the way."""


def fit(way: str, seed: int, *, particles: int, image: int, steps: int) -> dict[str, Any]:
    """One fit: how much of each part follows the right law, errors of log10 E, losses, seconds."""
    settings = dict(WAYS[way])
    look, gaussians = dressed("burger", count=4000, seed=seed)
    look = Look(look.subject, look.text, negative="cheese, lettuce, tomato")
    motion = Motion("falling", "a burger falling", {"": BUN, "patty": PATTY})
    body = Sample()(gaussians, motion, work=Workspace())
    net = Net(seed=seed, gate=settings.pop("gate", "softmax"), bias=settings.pop("bias", 8.0))
    stage = FitMaterial(
        guidance=Analytic(layout="clip", s=0.0), library=Library(), net=net, steps=steps, seed=seed,
        elastic=("neo_hookean", "hencky"), plastic=PLASTIC,
        probe=Probe(particles=particles, image=image, seed=2 * seed), **settings,
    )  # fmt: skip
    begin, cpu = time.perf_counter(), time.process_time()
    work = Workspace(progress=False)
    found = stage(look, motion, gaussians, body, work=work)
    row: dict[str, Any] = {"way": way, "seed": seed, "seconds": time.perf_counter() - begin}
    row["cpu_seconds"] = time.process_time() - cpu
    truth = table_field(Library(), look, motion, body)
    patty = truth.w_p[:, truth.plastic.index("von_mises")] > 0
    for name, where in (("bun", ~patty), ("patty", patty)):
        law = lookup(PATTY if name == "patty" else BUN).plastic
        right = found.w_p[:, found.plastic.index(law)] if law in found.plastic else torch.zeros(len(found))
        log_E = (found.theta["E"].log10() - truth.theta["E"].log10())[where]
        row[name] = {"right": float(right[where].mean()), "error": float(log_E.mean()), "spread": float(log_E.std())}
    return row


def page(result: dict[str, Any]) -> str:
    """A row for each way: mean over seeds, and how many were right."""
    text = "# Two materials in one object\n\n"
    text += f"An elastic bun ({BUN}) round a plastic patty ({PATTY}), four plastic laws possible for each. "
    text += f"{result['machine']}; {result['particles']} particles, {result['image']} px, at most {result['steps']} "
    text += "steps. *Right* counts seeds with the right law on at least 90 % of both parts; the rest are means over "
    text += (
        "the seeds.\n\n| way | right | bun: right law | patty: right law | bun: error of log₁₀ E | patty | CPU s |\n"
    )
    text += "|---|--:|--:|--:|--:|--:|--:|\n"
    for way in WAYS:
        rows = [r for r in result["rows"] if r["way"] == way]
        if not rows:
            continue
        right = sum(min(r["bun"]["right"], r["patty"]["right"]) >= 0.9 for r in rows)

        def mean(part: str, key: str, rows: list = rows) -> float:
            return sum(r[part][key] for r in rows) / len(rows)

        errors = (
            ", ".join(f"{r['bun']['error']:+.2f}" for r in rows),
            ", ".join(f"{r['patty']['error']:+.2f}" for r in rows),
        )
        text += f"| {way} | {right} of {len(rows)} | {mean('bun', 'right'):.0%} | {mean('patty', 'right'):.0%} "
        text += f"| {errors[0]} | {errors[1]} | {sum(r['cpu_seconds'] for r in rows) / len(rows):.0f} |\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ways", nargs="+", default=list(WAYS), choices=list(WAYS), metavar="WAY")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--particles", type=int, default=500)
    parser.add_argument("--image", type=int, default=48)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    size = {"particles": options.particles, "image": options.image, "steps": options.steps}
    rows = []
    for way in options.ways:
        for seed in options.seeds:
            rows.append(fit(way, seed, **size))
            print(json.dumps(rows[-1]), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    result = {"machine": describe("cpu"), **size, "rows": rows}
    (options.out / "two_regions.json").write_text(json.dumps(result, indent=1))
    (options.out / "two_regions.md").write_text(page(result))


if __name__ == "__main__":
    main()
