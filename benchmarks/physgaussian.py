"""Scenes of PhysGaussian from trained Gaussians and scene file to film: sheets, seconds, and what the motion shows.

    python -m benchmarks.physgaussian --store outputs/physgaussian
    python -m benchmarks.physgaussian --scenes jam

Stand-ins are drawn (``_originals``) and written in the layout of the original code; scene files are the published ones,
re-typed in tests/physgaussian/published. Stored results are not computed again; their recorded seconds are used. Writes
physgaussian.json, physgaussian.md and a sheet for each scene.
"""

import argparse
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks._originals import write

ROOT = Path(__file__).resolve().parents[1]
FILES = ROOT / "tests" / "physgaussian" / "published"
STAGES = ("prompt", "gaussians", "particles", "material", "trajectory", "clip")


def sway(x: Tensor) -> dict[str, float]:
    """Displacement of the crown, the highest tenth, against the push: how often it changes its sign, and how far."""
    top = x[0, :, 2] > torch.quantile(x[0, :, 2], 0.9)
    d = (x[:, top, 0] - x[0, top, 0]).mean(1)
    foot = x[0, :, 2] < torch.quantile(x[0, :, 2], 0.1)
    return {
        "farthest [m]": float(d.abs().max()),
        "sign changes": int((d[1:-1].sign() * d[2:].sign() < 0).sum()),
        "pot moves [m]": float((x[:, foot] - x[0, foot]).abs().max()),
    }


def heap(x: Tensor) -> dict[str, float]:
    """Height of what was a body, and the slope of the heap: atan of height over half its least width."""
    low, high = torch.quantile(x[-1], 0.01, dim=0), torch.quantile(x[-1], 0.99, dim=0)
    height, wide = float(high[2] - low[2]), float((high - low)[:2].min())
    return {
        "height before [m]": float(x[0, :, 2].amax() - x[0, :, 2].amin()),
        "height after [m]": height,
        "slope [deg]": math.degrees(math.atan2(height, wide / 2)),
    }


def puddle(x: Tensor) -> dict[str, float]:
    """Height and width before and after."""
    first, last = (x[k].amax(0) - x[k].amin(0) for k in (0, -1))
    return {
        "height before [m]": float(first[2]),
        "height after [m]": float(last[2]),
        "width before [m]": float(first[0]),
        "width after [m]": float(last[0]),
    }


def dent(x: Tensor) -> dict[str, float]:
    """How deep the front, x > 0 at the height of the bar, lies behind where it was: at the deepest, and at the end."""
    front = (x[0, :, 0] > torch.quantile(x[0, :, 0], 0.9)) & ((x[0, :, 2] - x[0, :, 2].mean() - 0.04).abs() < 0.04)
    depth = (x[0, front, 0] - x[:, front, 0]).mean(1)
    return {"deepest [m]": float(depth.max()), "stays [m]": float(depth[-1])}


def cushions(x: Tensor) -> dict[str, float]:
    """Height of the middle of the upper cushion over the bed: where it begins, lowest, and the rebound after that."""
    upper = x[0, :, 2] > x[0, :, 2].amin() + 0.8
    z = x[:, upper, 2].mean(1) - x[0, :, 2].amin()
    k = int(z.argmin())
    return {"height [m]": float(z[0]), "lowest [m]": float(z[k]), "rebound [m]": float(z[k:].max() - z[k])}


@dataclass(frozen=True)
class Scene:
    """One scene file, and what it is played with."""

    name: str
    size: float
    """``scale`` of the file [m]."""
    shows: Callable[[Tensor], dict[str, float]]
    """Numbers of the motion, from places (T, N, 3) [m]."""
    options: tuple[str, ...]
    tiny: tuple[str, ...]
    """The same in seconds."""


TINY = ("film.width=64", "film.height=64")

FOUR = ("+sample.per_cell=4", "+scene.particles_per_cell=4", "+sample.max_particles=26000")
"""Four particles a cell instead of eight, where a thin wall asks for small cells."""

HOLLOW = ("sample=none",)

SCENES = {
    s.name: s
    for s in (
        Scene(
            "ficus", 1.0, sway,
            ("+sample.cells=20", "scene.seconds=2", "scene.particles=1000000", "camera.azimuth=-90"),
            ("+sample.cells=8", "scene.seconds=1", "scene.particles=1000000"),
        ),
        Scene("wolf", 1.0, heap, ("+sample.cells=20", "film.stretch=1.5"), ("+sample.cells=8",)),
        Scene("jam", 0.5, puddle, ("+sample.cells=16",), ("+sample.cells=8", "scene.seconds=1")),
        Scene(
            "can", 0.5, dent,
            ("+sample.cells=20", *HOLLOW, "scene.seconds=0.6", "camera.azimuth=-70"),
            ("+sample.cells=18", *HOLLOW, *FOUR, "scene.seconds=0.4"),
        ),
        Scene(
            "pillow", 1.0, cushions,
            ("+sample.cells=33", *FOUR, "scene.seconds=3"),
            ("+sample.cells=33", "+sample.per_cell=2", "+scene.particles_per_cell=2", "scene.seconds=2"),
        ),
    )
}  # fmt: skip
"""Scenes by name. The file of the ficus pushes each particle of a scene whose number is not published: so many sway
visibly."""


def command(scene: Scene, gaussians: Path, store: Path, *, tiny: bool = False) -> list[str]:
    """The arguments of ``train.py``."""
    return [f"prompt=a {scene.name} moving", "gaussians=physgaussian", f"gaussians.path={gaussians}",
            "scene=physgaussian", "camera=resting", f"scene.file={FILES / scene.name}.json",
            f"refine.default_size={scene.size}", f"store={store}", "device=cpu",
            "report.error=off", "evaluate.score=off", *((*scene.tiny, *TINY) if tiny else scene.options)]  # fmt: skip


def run(scene: Scene, store: Path, count: int, options: list[str], *, tiny: bool = False) -> Path:
    """Make the film of a scene; returns its run folder."""
    captured = write(store / "captured" / scene.name, scene.name, count)
    call = [sys.executable, "train.py", *command(scene, captured, store / scene.name, tiny=tiny), *options]
    done = subprocess.run(call, cwd=ROOT, stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    film = next(line for line in done.stderr.splitlines() if line.startswith("film "))
    return (ROOT / film.split(maxsplit=1)[1]).parent


def measure(scene: Scene, folder: Path) -> dict[str, Any]:
    """Seconds, particles, and what the motion shows."""
    from diffuphy.types import Trajectory

    metas = {s: json.loads((folder / f"{i}_{s}" / "meta.json").read_text()) for i, s in enumerate(STAGES, 1)}
    trajectory = Trajectory.load(folder / "5_trajectory")
    return {
        "scene": scene.name,
        "particles": trajectory.x.shape[1],
        "film": (len(trajectory.x) - 1) / trajectory.fps,
        "seconds": {s: m["seconds"] for s, m in metas.items()},
        "shows": scene.shows(trajectory.x),
    }


HEAD = """# PhysGaussian's scenes

From a trained scene in the layout of the original code and a PhysGaussian scene file to a film. The Gaussians are
stand-ins, drawn and covered with Gaussians (`benchmarks/_originals.py`); the scene files are those of
`tests/physgaussian/published`: ficus, wolf and pillow as PhysGaussian publishes them, jam and can as its README there
says. `python -m benchmarks.physgaussian` makes this page.

{machine}; one process, seconds by the wall clock, beside whatever else the machine does.

| scene | particles | film [s] | simulation [s] | pictures [s] | what the motion shows |
|---|---|---|---|---|---|
"""

WORDS = {
    "ficus": """The pot is held by a sticky `cuboid`; a `particle_impulse` at the beginning sets the crown swaying. The
file pushes each particle of its scene by 0.18 N for 0.1 ms; how many those were is not published,
`scene.particles=1000000` is chosen so that the sway is seen.""",
    "wolf": """Sand of 30° friction, set free layer by layer from the nose to the tail in 1.5 s by
`release_particles_sequentially`, onto a floor that holds.""",
    "jam": """Foam with a yield stress of 50 Pa falls 0.15 m onto a floor that holds, and flows until its weight no
longer shears it.""",
    "can": """A shell of metal (`sample=none`) on a floor that holds; a bar, a sticky `cuboid`, pushes it in for
0.25 s and is gone.""",
    "pillow": """A bed that is held, and two cushions in the air, each held by a `cuboid`, the lower one for 0.5 s and
the upper one for 1 s. `sim_area` of the file is applied. What is held is a wall for the cushions, which bounce off it
and come to lie on it.""",
}
"""What happens in each scene."""


def page(rows: list[dict[str, Any]], machine: str) -> str:
    """The page of the documentation."""
    text = HEAD.format(machine=machine)
    for r in rows:
        shows = ", ".join(f"{name.split(' [')[0]} {value:.3g}{unit(name)}" for name, value in r["shows"].items())
        text += (
            f"| {r['scene']} | {r['particles']} | {r['film']:.3g} | {r['seconds']['trajectory']:.0f} "
            f"| {r['seconds']['clip']:.0f} | {shows} |\n"
        )
    for r in rows:
        text += f"\n## {r['scene']}\n\n{WORDS[r['scene']]}\n\n![{r['scene']}](physgaussian/{r['scene']}.png)\n"
    return text


def unit(name: str) -> str:
    """ " m" of "height [m]"."""
    return " " + name.partition("[")[2].rstrip("]") if "[" in name else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=ROOT / "outputs" / "physgaussian")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks")
    parser.add_argument("--scenes", nargs="+", choices=tuple(SCENES), default=tuple(SCENES))
    parser.add_argument("--count", type=int, default=8000, help="Gaussians of each stand-in")
    parser.add_argument("--tiny", action="store_true", help="seconds instead of minutes")
    parser.add_argument("--options", nargs="*", default=["film.width=256", "film.height=256"], help="more settings")
    options = parser.parse_args()
    folders = {
        name: run(SCENES[name], options.store.resolve(), options.count, options.options, tiny=options.tiny)
        for name in options.scenes
    }
    rows = [measure(SCENES[name], folder) for name, folder in folders.items()]
    machine = f"{os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}"
    sheets = options.out / "physgaussian"
    sheets.mkdir(parents=True, exist_ok=True)
    for name, folder in folders.items():
        small(folder / "contact_sheet.png", sheets / f"{name}.png")
    (options.out / "physgaussian.json").write_text(json.dumps({"machine": machine, "rows": rows}, indent=1) + "\n")
    text = page(rows, machine)
    (options.out / "physgaussian.md").write_text(text)
    print(text)


def small(source: Path, target: Path) -> None:
    """A sheet in 128 colours."""
    from PIL import Image

    Image.open(source).convert("RGB").quantize(128).save(target, optimize=True)


if __name__ == "__main__":
    main()
