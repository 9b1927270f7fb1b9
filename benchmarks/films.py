"""Prompts from sentence to film: seconds and memory of each stage, first preview, pictures.

    python -m benchmarks.films --store outputs

Stored results are not computed again; their recorded seconds are used. Writes films.json, films.md and films.png.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import torch

ROOT = Path(__file__).resolve().parents[1]
PROMPTS = (
    "a rubber burger falling on a surface",
    "a gravel pile falling then collapsing",
    "pancakes melting",
    "a jelly bouncing",
    "a sand snowman collapsing",
)
STAGES = ("prompt", "gaussians", "particles", "material", "trajectory", "clip")


def run(prompt: str, store: Path, options: list[str]) -> Path:
    """Make the film; returns its run folder."""
    command = [sys.executable, "train.py", f"prompt={prompt}", f"store={store}", "device=cpu", *options]
    done = subprocess.run(command, cwd=ROOT, check=True, stderr=subprocess.PIPE, text=True)
    film = next(line for line in done.stderr.splitlines() if line.startswith("film "))
    return (ROOT / film.split(maxsplit=1)[1]).parent


def first_preview(folder: Path) -> float:
    """Seconds from the first metric of the Gaussians' stage to its first picture [s]."""
    work = folder / "2_gaussians" / "work"
    pictures = sorted(p.stat().st_mtime for p in (work / "previews").glob("*.png"))
    begin = json.loads((folder / "1_prompt" / "meta.json").read_text())
    started = (folder / "1_prompt" / "meta.json").stat().st_mtime
    return pictures[0] - started + begin["seconds"] if pictures else float("nan")


def measure(prompt: str, folder: Path) -> dict:
    metas = {s: json.loads((folder / f"{i}_{s}" / "meta.json").read_text()) for i, s in enumerate(STAGES, 1)}
    return {
        "prompt": prompt,
        "seconds": {s: m["seconds"] for s, m in metas.items()},
        "total": round(sum(m["seconds"] for m in metas.values()), 1),
        "megabytes": max(m["megabytes"] for m in metas.values()),
        "first_preview": round(first_preview(folder), 1),
        "material": json.loads((folder / "4_material" / "work" / "summary.json").read_text()),
    }


def strip(folder: Path, frames: int = 6, side: int = 240) -> torch.Tensor:
    """Evenly spaced frames of a film side by side, shape (side, frames · side, 3)."""
    from diffuphy.types import Clip

    rgb = Clip.load(folder / "6_clip").rgb
    chosen = rgb[torch.linspace(0, len(rgb) - 1, frames).round().long()].permute(0, 3, 1, 2)
    small = torch.nn.functional.interpolate(chosen, size=(side, side), mode="area")
    return torch.cat(list(small.permute(0, 2, 3, 1)), 1)


def table(rows: list[dict], machine: str) -> str:
    head = f"# Films\n\n{machine}. Kernels that were not cached are compiled on the way.\n\n"
    head += "| prompt | Gaussians | material | trajectory | clip | all [s] | first preview [s] | memory [MB] |\n"
    head += "|---|---|---|---|---|---|---|---|\n"
    cells = (
        f"| {r['prompt']} | {r['seconds']['gaussians']:.0f} | {r['seconds']['material']:.0f} "
        f"| {r['seconds']['trajectory']:.0f} | {r['seconds']['clip']:.0f} | {r['total']:.0f} "
        f"| {r['first_preview']:.0f} | {r['megabytes']:.0f} |\n"
        for r in rows
    )
    return head + "".join(cells) + "\n![films](films.png)\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=ROOT / "outputs")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks")
    parser.add_argument("--prompts", nargs="+", default=PROMPTS)
    parser.add_argument("--options", nargs="*", default=[], help="more settings, such as experiment=tiny")
    options = parser.parse_args()
    folders = [run(prompt, options.store.resolve(), options.options) for prompt in options.prompts]
    rows = [measure(p, f) for p, f in zip(options.prompts, folders, strict=True)]
    machine = f"{os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "films.json").write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))
    (options.out / "films.md").write_text(table(rows, machine))
    from diffuphy.render import write_png

    write_png(options.out / "films.png", torch.cat([strip(f) for f in folders]))
    print(table(rows, machine))


if __name__ == "__main__":
    main()
