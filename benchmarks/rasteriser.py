"""The rasteriser: what a picture and its gradient cost on this machine, and how exact the gradient is.

    python benchmarks/rasteriser.py                        # both tables, about two minutes
    python benchmarks/rasteriser.py --threads 1 --repeats 21

A ball of G Gaussians with every orientation, one view of R x R pixels, loss on colour and coverage. Milliseconds are
medians over the repeats, of the process (user and system time of all threads) and of the clock; forward and backward
include projection, bounds and binning. Errors are relative to the dense torch reference in float64.
Writes docs/benchmarks/rasteriser.{json,md}.
"""

import argparse
import json
import platform
import statistics
import time
from pathlib import Path

import torch
from torch import Tensor

from diffuphy.render import Dense, Warp, orbit, rasterize
from diffuphy.types import Camera

OUT = Path(__file__).parent.parent / "docs" / "benchmarks"
CASES = ((3_000, 64), (10_000, 64), (3_000, 128), (10_000, 128), (50_000, 128), (10_000, 256), (50_000, 384))


def ball(count: int, dtype: torch.dtype = torch.float32) -> list[Tensor]:
    """Means, quats, scales, opacities, colours of a shell of radius 1; footprints shrink as G^-½, as an object's do."""
    g = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    means = d * (0.7 + 0.3 * torch.rand(count, 1, generator=g))
    scales = 1.2 * count**-0.5 * torch.exp(0.3 * torch.randn(count, 3, generator=g))
    quats, colors = torch.randn(count, 4, generator=g), torch.rand(count, 3, generator=g)
    opacities = torch.sigmoid(1.5 * torch.randn(count, generator=g) + 0.5)
    return [x.to(dtype) for x in (means, quats, scales, opacities, colors)]


def cost(count: int, size: int, backend: Warp, repeats: int) -> dict[str, float]:
    """Median milliseconds of one view."""
    operands = [x.requires_grad_() for x in ball(count)]
    camera = orbit([30.0], 20.0, 3.0, width=size, height=size)
    process, clock = [], []
    for _ in range(repeats + 3):
        p0, c0 = time.process_time(), time.perf_counter()
        image = rasterize(*operands, camera, backend=backend)
        p1, c1 = time.process_time(), time.perf_counter()
        (image.rgb.sum() + image.alpha.sum()).backward()
        process.append((p1 - p0, time.process_time() - p0))
        clock.append((c1 - c0, time.perf_counter() - c0))
    kept = [list(zip(*rows[3:], strict=True)) for rows in (process, clock)]
    (forward, both), (forward_clock, both_clock) = ([1e3 * statistics.median(x) for x in rows] for rows in kept)
    return {"forward": forward, "both": both, "forward_clock": forward_clock, "both_clock": both_clock}


def error(backend: Warp, dtype: torch.dtype) -> dict[str, float]:
    """Relative error of the gradient with respect to each operand, in two views."""
    camera = orbit([30.0, 200.0], [20.0, -10.0], 3.0, width=48, height=40)
    camera = Camera(camera.viewmats.double(), camera.Ks.double(), 48, 40)
    weight = torch.randn(2, 40, 48, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def gradients(rasteriser: Warp | Dense, kind: torch.dtype) -> list[Tensor]:
        leaves = [x.to(kind).requires_grad_() for x in ball(300, dtype)]
        image = rasterize(*leaves, camera, backend=rasteriser)
        channels = torch.cat([image.rgb, image.alpha[..., None], image.depth[..., None]], dim=-1)
        return list(torch.autograd.grad((channels * weight.to(kind)).sum(), leaves))

    pairs = zip(gradients(backend, dtype), gradients(Dense(), torch.float64), strict=True)
    names = ("means", "quats", "scales", "opacities", "colors")
    return {n: ((a.double() - b).norm() / b.norm()).item() for n, (a, b) in zip(names, pairs, strict=True)}


def tables(results: dict) -> str:
    """The results as Markdown."""
    lines = [f"# Rasteriser\n\n{results['machine']}; {results['repeats']} repeats, {results['threads']} thread(s).\n"]
    lines += ["| Gaussians | px | driver | forward | forward + backward | clock |", "|--:|--:|---|--:|--:|--:|"]
    for r in results["cost"]:
        row = f"| {r['gaussians']} | {r['size']} | {r['driver']} | {r['forward']:.1f} ms | {r['both']:.1f} ms |"
        lines.append(row + f" {r['both_clock']:.1f} ms |")
    lines += ["\n| driver | dtype | means | quats | scales | opacities | colors |", "|---|---|--:|--:|--:|--:|--:|"]
    for r in results["error"]:
        values = " | ".join(f"{r[n]:.1e}" for n in ("means", "quats", "scales", "opacities", "colors"))
        lines.append(f"| {r['driver']} | {r['dtype']} | {values} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    backends = {d: Warp(driver=d, threads=options.threads) for d in ("tile", "pixel")}
    results = {
        "machine": f"{platform.processor() or platform.machine()}, torch {torch.__version__}",
        "repeats": options.repeats,
        "threads": options.threads,
        "cost": [
            {"gaussians": g, "size": s, "driver": d} | cost(g, s, b, options.repeats)
            for g, s in CASES
            for d, b in backends.items()
        ],
        "error": [
            {"driver": d, "dtype": str(t).removeprefix("torch.")} | error(b, t)
            for t in (torch.float64, torch.float32)
            for d, b in backends.items()
        ],
    }
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "rasteriser.json").write_text(json.dumps(results, indent=1))
    (options.out / "rasteriser.md").write_text(tables(results))
    print(tables(results))


if __name__ == "__main__":
    main()
