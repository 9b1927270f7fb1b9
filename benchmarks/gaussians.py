"""Text to Gaussians: how close the pictures from unseen cameras come to the prior's object, and what it costs.

    python benchmarks/gaussians.py                         # five objects, three minutes each at most
    python benchmarks/gaussians.py --objects burger --steps 300

Held-out PSNR is the mean over cameras that the fit never saw, over white, against the library object that the fit chose
(the sibling of the highest PSNR). Gaussians are those handed on: cleaned, nothing hidden. Writes
docs/benchmarks/gaussians.{json,md,png}.
"""

import argparse
import json
import platform
import time
from pathlib import Path

import torch
from torch import Tensor

from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.render import render_gaussians
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.params import nearest_distance
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Gaussians, Look
from diffuphy.workspace import Workspace

OBJECTS = ("burger", "duck", "pancakes", "snowman", "cake")
OUT = Path(__file__).parent.parent / "docs" / "benchmarks"


def psnr(a: Tensor, b: Tensor) -> Tensor:
    """−10 log₁₀ mean (a − b)² over each picture, shape (C,) [dB]."""
    return -10 * torch.log10((a.clamp(0, 1) - b.clamp(0, 1)).square().flatten(1).mean(1))


def held_out(gaussians: Gaussians, library: Library, look: Look, cameras: Orbits) -> dict[str, object]:
    """Mean and worst PSNR over cameras of another seed [dB], the sibling it is measured against, and the pictures."""
    camera, white = cameras(), torch.ones(3)
    picture = render_gaussians(gaussians, camera, background=white).rgb
    references, _ = library(look, camera, white)
    scores = torch.stack([psnr(picture, references[:, k]) for k in range(references.shape[1])])  # (K, C)
    best = int(scores.mean(1).argmax())
    return {
        "psnr": scores[best].mean().item(),
        "worst": scores[best].min().item(),
        "sibling": best,
        "pictures": (picture, references[:, best]),
    }


def matter(gaussians: Gaussians, library: Library, look: Look, sibling: int) -> dict[str, float]:
    """What the physics will ask: how opaque, how isotropic, how near the surface the Gaussians are."""
    o = torch.sigmoid(gaussians.logit_opacities)
    s = gaussians.log_scales.exp()
    distance, _ = library.object(look, sibling).sdf(gaussians.means)
    return {
        "median_opacity": o.median().item(),
        "opaque_share": (o > 0.5).float().mean().item(),
        "median_ratio": (s.amax(1) / s.amin(1)).median().item(),
        "outside_share": (distance > 0.05).float().mean().item(),
        "spacing": nearest_distance(gaussians.means, 1).median().item(),
    }


def measure(name: str, fit: FitGaussians, library: Library, work: Workspace) -> dict[str, object]:
    look = Look(name, f"a {name}")
    wall, cpu = time.perf_counter(), time.process_time()
    gaussians = fit(look, work=work)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    unseen = Orbits(bank=24, size=fit.cameras.size, seed=fit.cameras.seed + 1)
    score = held_out(gaussians, library, look, unseen)
    row = {"object": name, "gaussians": len(gaussians), "wall_s": wall, "cpu_s": cpu}
    return row | score | matter(gaussians, library, look, int(score["sibling"]))  # type: ignore[arg-type]


def table(rows: list[dict[str, object]]) -> str:
    columns = list(rows[0])
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        lines.append(
            "| " + " | ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in (row[c] for c in columns)) + " |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--steps", type=int, default=FitGaussians.steps)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows, strips = [], []
    for name in arguments.objects:
        library = Library(seed=arguments.seed)  # a fresh one: an empty cache of pictures is part of the cost
        fit = FitGaussians(Analytic(library), steps=arguments.steps, seed=arguments.seed)
        row = measure(name, fit, library, Workspace())
        picture, reference = row.pop("pictures")  # type: ignore[misc]
        strips.append(torch.cat([torch.cat(list(picture[::6]), 1), torch.cat(list(reference[::6]), 1)], 1))
        rows.append(row)
        print(table(rows[-1:]), flush=True)
    machine = {
        "machine": platform.machine(),
        "torch": torch.__version__,
        "threads": 1,
        "steps": arguments.steps,
        "seed": arguments.seed,
    }
    (arguments.out / "gaussians.json").write_text(json.dumps({**machine, "rows": rows}, indent=1))
    (arguments.out / "gaussians.md").write_text(f"# Gaussians\n\n{__doc__}\n{table(rows)}")
    from PIL import Image

    Image.fromarray((torch.cat(strips).clamp(0, 1) * 255).round().byte().numpy()).save(arguments.out / "gaussians.png")


if __name__ == "__main__":
    main()
