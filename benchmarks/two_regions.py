"""Two materials in one object: an elastic bun round a plastic patty, nothing told but that there are two.

    python -m benchmarks two_regions                               # every way, three seeds
    python -m benchmarks two_regions --ways softmax --seeds 3      # another seed; what is on the page stays
    python -m benchmarks two_regions --ways --landscape 400 1500   # only: loss along E of the patty

The reference is the same drop with another draw of particles. Every region may follow any of four plastic laws, from
uniform weights: either all combinations are scanned first, or the training starts from the uniform mixture itself. The
ways differ in that, and in the gate: ``softmax`` never reaches zero, ``sparsemax`` does, ``start`` keeps what the scan
chose. Writes docs/benchmarks/two_regions.*.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

from benchmarks.speed.body import describe
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.learning.probe import Probe, table_field
from diffuphy.learning.verdict import film_field
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.material.field import harden, prune
from diffuphy.material.net import Net
from diffuphy.material.presets import lookup
from diffuphy.render.sh import from_rgb
from diffuphy.types import Gaussians, Look, Motion, Particles
from diffuphy.workspace import Workspace

OUT = Path(__file__).parents[1] / "docs" / "benchmarks"
PLASTIC = ("identity", "von_mises", "drucker_prager", "fluid")
BUN, PATTY = "gelatin", "playdoh"
LOOK = Look("sandwich", "a sandwich")
MOTION = Motion("falling", "it falls", {"": BUN, "patty": PATTY})
HALF = 0.6
"""Half the height of the sandwich over its radius."""
WAYS: dict[str, dict[str, Any]] = {
    "softmax": {},
    "sparsemax": {"gate": "sparsemax", "bias": 0.99},
    "start": {"gate": "start"},
    "uniform, softmax": {"stiffness_steps": 0, "start": 5.2},
}
"""Settings of the material stage by the name of the way."""


class Sandwich:
    """A round sandwich of three layers, coloured throughout, so that what is inside can be told by its colour."""

    parts = (SimpleNamespace(name="bun"), SimpleNamespace(name="patty"))
    colors = torch.tensor([[0.93, 0.72, 0.42], [0.25, 0.12, 0.06]])

    def object(self, look: Look) -> "Sandwich":
        return self

    def part_of(self, points: Tensor) -> Tensor:
        """The patty is the middle third of the height."""
        return (points[:, 2].abs() < HALF / 3).long()

    def bodies(self, seed: int, size: float = 0.5, n: int = 13) -> tuple[Gaussians, Particles]:
        """A Gaussian on each particle of a lattice whose place in the body is drawn."""
        generator = torch.Generator().manual_seed(seed)
        a = (torch.arange(-n, n + 1) / n)[:, None] + (torch.rand(3, generator=generator) - 0.5) / n
        x = torch.cartesian_prod(*a.T)
        x = x[(x[:, :2].norm(dim=1) < 1) & (x[:, 2].abs() < HALF)]
        G, h = len(x), size / (2 * n)
        colors = self.colors[self.part_of(x)] + 0.03 * torch.randn(G, 1, generator=generator)
        gaussians = Gaussians(
            x, torch.tensor([1.0, 0, 0, 0]).repeat(G, 1), torch.full((G, 3), 0.6 / n).log(), torch.full((G,), 4.0),
            from_rgb(colors.clamp(0, 1)),
        )  # fmt: skip
        return gaussians, Particles(x * size / 2, torch.full((G,), h**3), torch.arange(G), size / 2, (0.0, 0.0, 0.0), h)


def stage(seed: int, probe: Probe, net: Net | None = None, **settings: Any) -> FitMaterial:
    """The material stage of this case."""
    return FitMaterial(
        guidance=Analytic(layout="clip", s=0.0), library=Sandwich(), segment="colour", net=net or Net(), seed=seed,
        elastic=("neo_hookean", "hencky"), plastic=PLASTIC, probe=probe, **settings,
    )  # fmt: skip


def fit(way: str, seed: int, *, particles: int, image: int, steps: int) -> dict[str, Any]:
    """One fit: how much of each part follows the right law, errors of log10 E, losses, seconds."""
    settings = dict(WAYS[way])
    gaussians, body = Sandwich().bodies(seed)
    net = Net(seed=seed, gate=settings.pop("gate", "softmax"), bias=settings.pop("bias", 8.0))
    component = stage(seed, Probe(particles=particles, image=image, seed=2 * seed), net, steps=steps, **settings)
    begin, cpu = time.perf_counter(), time.process_time()
    case = component.case(LOOK, MOTION, gaussians, body)
    model = component.fit(case, Workspace(progress=False))
    row: dict[str, Any] = {"way": way, "seed": seed, "seconds": time.perf_counter() - begin}
    row["cpu_seconds"] = time.process_time() - cpu
    with torch.no_grad():
        found, field = film_field(case, model, gaussians, body), model()
        drops = (
            case.bench.simulate(field, gate_time=component.gate_time),
            case.bench.simulate(prune(harden(field)).field),
        )
    row["mixed"], row["hardened"] = (case.cond.score(drop, "x0") for drop in drops)
    truth = table_field(Sandwich(), LOOK, MOTION, body)
    patty = truth.w_p[:, truth.plastic.index("von_mises")] > 0
    for name, where in (("bun", ~patty), ("patty", patty)):
        law = lookup(PATTY if name == "patty" else BUN).plastic
        right = found.w_p[:, found.plastic.index(law)] if law in found.plastic else torch.zeros(len(found))
        log_E = (found.theta["E"].log10() - truth.theta["E"].log10())[where]
        row[name] = {"right": float(right[where].mean()), "error": float(log_E.mean()), "spread": float(log_E.std())}
    return row


def landscape(seed: int, *, particles: int, image: int) -> dict[str, Any]:
    """Clip loss along log10 E of the patty, all else being the table's; and how much of the body is patty, in the
    draft that is fitted and in that of the reference."""
    case = stage(seed, Probe(particles=particles, image=image, seed=2 * seed)).case(
        LOOK, MOTION, *Sandwich().bodies(seed)
    )
    table, true = case.table, float(torch.tensor(lookup(PATTY).E).log10())
    patty = table.w_p[:, table.plastic.index("von_mises")] > 0
    places, losses = [round(true + 0.2 * i, 3) for i in range(-4, 5)], []
    for log_E in places:
        E = torch.where(patty, 10.0**log_E, table.theta["E"])
        field = dataclasses.replace(table, theta=table.theta | {"E": E})
        with torch.no_grad():
            losses.append(case.cond.score(case.bench.simulate(prune(field).field), "x0"))
    drafts = case.bench.draft, case.cond.guidance.references.bench.draft
    share = [float(d.vol[Sandwich().part_of(d.x / d.scale) > 0].sum() / d.vol.sum()) for d in drafts]
    return {"seed": seed, "particles": particles, "share": share, "log_E": places, "loss": losses, "true": true}


def landscape_section(rows: list[dict[str, Any]]) -> str:
    """Where the loss is lowest along E of the patty, beside the share of the patty."""
    text = "\n## Where the loss is lowest\n\nClip loss along log₁₀ E of the patty; law, yield stress and "
    text += "bun are the reference's. The draft that is fitted and that of the reference are different draws of "
    text += "particles of one body, whose patty is a third of its height, two or three particles; each draft keeps its "
    text += "share of the volume.\n\n"
    text += "| particles | seed | patty, share of the volume: fitted | reference | lowest loss | at an error of "
    text += "| loss at the true E |\n|--:|--:|--:|--:|--:|--:|--:|\n"
    for r in rows:
        best = min(range(len(r["loss"])), key=r["loss"].__getitem__)
        off, ends = r["log_E"][best] - r["true"], best in (0, len(r["loss"]) - 1)
        beyond = ("≥ " if off > 0 else "≤ ") if ends else ""
        at_true = r["loss"][len(r["loss"]) // 2]
        text += f"| {r['particles']} | {r['seed']} | {r['share'][0]:.1%} | {r['share'][1]:.1%} | {r['loss'][best]:.1e} "
        text += f"| {beyond}{off:+.1f} | {at_true:.1e} |\n"
    return text


def page(result: dict[str, Any]) -> str:
    """A row for each way: mean over seeds, and how many were right."""
    text = "# Two materials in one object\n\n"
    text += f"An elastic bun ({BUN}) round a plastic patty ({PATTY}), four plastic laws possible for each. "
    text += f"{result['machine']}; {result['particles']} particles, {result['image']} px, at most {result['steps']} "
    text += "steps. *Right* counts seeds with the right law on at least 90 % of both parts; the rest are means over "
    text += "the seeds, or one number a seed.\n\n| way | right | bun: right law | patty: right law "
    text += "| bun: error of log₁₀ E | patty | clip loss of the mixture | hardened | CPU s |\n"
    text += "|---|--:|--:|--:|--:|--:|--:|--:|--:|\n"
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
        losses = [", ".join(f"{r[k]:.0e}" for r in rows) for k in ("mixed", "hardened")]
        text += f"| {errors[0]} | {errors[1]} | {losses[0]} | {losses[1]} "
        text += f"| {sum(r['cpu_seconds'] for r in rows) / len(rows):.0f} |\n"
    return text + (landscape_section(result["landscape"]) if result.get("landscape") else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ways", nargs="*", default=list(WAYS), choices=list(WAYS), metavar="WAY")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--landscape", nargs="*", type=int, default=[], metavar="PARTICLES",
                        help="also: loss along E of the patty, with so many particles")  # fmt: skip
    parser.add_argument("--particles", type=int, default=400)
    parser.add_argument("--image", type=int, default=40)
    parser.add_argument("--steps", type=int, default=30)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    size = {"particles": options.particles, "image": options.image, "steps": options.steps}
    result = known(options.out / "two_regions.json", size) | {"machine": describe("cpu"), **size}
    options.out.mkdir(parents=True, exist_ok=True)

    def add(kind: str, row: dict[str, Any], *keys: str) -> None:
        """Put a row in the place of the one with the same keys, and write what there is."""
        others = [r for r in result.get(kind, ()) if any(r[k] != row[k] for k in keys)]
        result[kind] = sorted([*others, row], key=lambda r: [r[k] for k in keys])
        print(json.dumps(row), flush=True)
        (options.out / "two_regions.json").write_text(json.dumps(result, indent=1))
        (options.out / "two_regions.md").write_text(page(result))

    for seed in options.seeds:
        for particles in options.landscape:
            add("landscape", landscape(seed, particles=particles, image=options.image), "particles", "seed")
        for way in options.ways:
            add("rows", fit(way, seed, **size), "way", "seed")


def known(file: Path, size: dict[str, int]) -> dict[str, Any]:
    """What was found before with problems of this size."""
    found = json.loads(file.read_text()) if file.is_file() else {}
    return found if size.items() <= found.items() else {"rows": []}


if __name__ == "__main__":
    main()
