"""How true a film's own error estimate is, what halving the grid spacing brings, and the curves behind ``accuracy=``.

    python -m benchmarks errors                   # all tables, about six minutes
    python -m benchmarks errors --quick           # one scene of each, coarser
    python -m benchmarks errors --scenes "torus clay falling"
    python -m benchmarks errors --accept          # default spacing and half of it, on a scene that built no page

Each scene is filmed with 16 cells along the body; the reference has 32, the drafts of the estimate 8. With an error of
first order the film is wrong by twice its difference to the reference. Writes docs/benchmarks/errors.json, the table of
docs/numerics/errors.md, and diffuphy/accuracy.json.
"""

import argparse
import dataclasses
import json
import math
import platform
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from diffuphy.accuracy import CURVES, FAMILIES
from diffuphy.errors import Estimate, split
from diffuphy.judgement import BAND
from diffuphy.material import presets
from diffuphy.mpm import Scheme, rollout
from diffuphy.mpm.restrict import restrict
from diffuphy.mpm.trajectory import Simulate
from diffuphy.render.clip import Film
from diffuphy.types import Errors, Motion, Particles
from diffuphy.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "numerics" / "errors.md"
SIZE, SECONDS, FPS = 0.5, 1.2, 30.0
SCENES = (
    "ball rubber falling", "brick jelly thrown", "torus clay falling", "tower sand collapsing", "brick snow falling",
    "brick wood sliding", "tower plasticine squashed", "ball dough melting",
)  # fmt: skip
"""Body, material, motion. None of them made the curves or settled a constant."""
ACCEPT = "dumbbell cheese falling"
"""Neither."""
SWEPT = {
    "elastic": "brick rubber falling", "plastic": "brick clay falling", "granular": "brick sand collapsing",
    "paste": "brick honey melting", "fluid": "brick water collapsing",
}  # fmt: skip
"""The scene that stands for a family of materials in the curves."""


def body(kind: str, cells: int) -> Particles:
    """A body of ``SIZE``, eight particles a cell; tilted where it would else fit into the lattice."""
    h = SIZE / cells / 2
    a = (torch.arange(2 * cells, dtype=torch.float64) + 0.5) * h - SIZE / 2
    x = torch.cartesian_prod(a, a, a)
    round_z, long = x[:, :2].norm(dim=1), x[:, 0].abs()
    inside = {
        "ball": x.norm(dim=1) < SIZE / 2,
        "brick": (x[:, 2].abs() < SIZE / 4) & (x[:, 1].abs() < SIZE / 3),
        "torus": (round_z - 0.32 * SIZE).square() + x[:, 2].square() < (0.18 * SIZE) ** 2,
        "tower": round_z < SIZE / 4,
        "dumbbell": ((long - 0.28 * SIZE).square() + x[:, 1:].square().sum(1) < (0.22 * SIZE) ** 2)
        | ((long < 0.3 * SIZE) & (x[:, 1:].norm(dim=1) < 0.12 * SIZE)),
    }[kind]
    x = x[inside]
    if kind in ("brick", "torus", "dumbbell"):
        c, s = math.cos(0.3), math.sin(0.3)
        x = x @ x.new_tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T
    nobody = torch.full((len(x),), -1)
    vol = torch.full((len(x),), h**3)
    return Particles(x.float(), vol, nobody, 1.0, (0.0, 0.0, 0.0), h)


@dataclass(frozen=True)
class Filmed:
    """A film, its reference and its estimate."""

    errors: Errors
    difference: Tensor
    """Film less reference, shape (T, M, 3) [m]."""
    coarser: Tensor
    """Draft less reference, (T, M', 3) [m]."""
    weight: Tensor
    weights: Tensor
    """Shares in the mass, of the particles of the film and of the draft."""
    seconds: float
    """Processor time of the film [s]."""
    cost: float
    """That of the estimate over it [-]."""


def coarse(fine: Particles, rho: Tensor) -> tuple[Particles, object]:
    """The same body with twice the spacing."""
    r = restrict(fine.x, fine.vol, rho, spacing=fine.spacing, side=2 * fine.spacing)
    parts = Particles(r.x.float(), r.vol.float(), fine.gaussian[r.near], fine.scale, fine.offset, 2 * fine.spacing)
    return parts, r


def filmed(scene: str, cells: int, simulate: Simulate) -> Filmed:
    """One scene: reference with twice the cells, film, estimate."""
    kind, word, verb = scene.split()
    motion = Motion(verb, scene, {"": word}, SIZE)
    preset = presets.melt(presets.lookup(word)) if verb == "melting" else presets.lookup(word)
    fine = body(kind, 2 * cells)
    particles, r = coarse(fine, torch.full((len(fine),), preset.rho))
    field = presets.field(preset, len(particles))
    rollout(simulate.scene(motion, particles), particles.x, particles.vol, field, frames=1)  # compiles
    start = time.process_time()
    trajectory = simulate(motion, particles, field, work=Workspace())
    middle = time.process_time()
    errors = Estimate(scene=simulate, film=Film())(motion, particles, field, trajectory, work=Workspace())
    end = time.process_time()
    moved = fine.x + (trajectory.x[0] - particles.x)[0]
    s = simulate.scene(motion, particles)
    s = dataclasses.replace(s, dx=s.dx / 2, lift=None)
    true = rollout(s, moved, fine.vol, presets.field(preset, len(fine))).x
    reference = torch.stack([r(frame) for frame in true])
    draft = restrict(trajectory.x[0], particles.vol, field.rho, spacing=particles.spacing, side=2 * particles.spacing)
    s = dataclasses.replace(s, dx=4 * s.dx)
    again = rollout(s, draft.x.float(), draft.vol.float(), draft.field(field)).x
    coarser = again.double() - torch.stack([draft(frame) for frame in reference])
    weights = (r.mass / r.mass.sum(), draft.mass / draft.mass.sum())
    return Filmed(
        errors, trajectory.x.double() - reference, coarser, *weights, middle - start, (end - middle) / (middle - start)
    )


def judge(f: Filmed) -> dict[str, float]:
    """Estimate over truth, and what they are."""
    com, shape = (2 * e for e in split(f.difference, f.weight))  # first order: twice what is left after halving
    row: dict[str, float] = {"cost": f.cost, "seconds": f.seconds}
    for name, true, estimate in (("com", com, f.errors.com), ("shape", shape, f.errors.shape)):
        there = true > 1e-3 * SIZE
        ratio = (estimate.double() / true)[there]
        row |= {
            f"{name}_true": float(true.max()) / SIZE,
            f"{name}_estimate": float(estimate.max()) / SIZE,
            f"{name}_index": float(estimate.max() / true.max()),
            f"{name}_held": float((ratio > 1 / BAND).double().mean()) if bool(there.any()) else 1.0,
        }
    far, near = (torch.hypot(*split(e, w)).max() for e, w in ((f.coarser, f.weights), (f.difference, f.weight)))
    return row | {"order": math.log2(max(float(far / near) - 1.0, 0.1))}


def sweep(quick: bool) -> dict[str, dict]:
    """Relative error against cells, for each family, degree of spline: e = a cells^-p, p from three grids."""
    curves: dict[str, dict] = {}
    cells = 6 if quick else 12
    for family, scene in list(SWEPT.items())[: 1 if quick else None]:
        for degree in (2,) if quick else (2, 3):
            simulate = Simulate(seconds=0.7, scheme=Scheme(order=degree, contact="elastic"))
            f = filmed(scene, cells, simulate)
            row = judge(f)
            p = min(max(row["order"], 0.5), 2.0)
            e = float(torch.hypot(*split(f.difference, f.weight)).max()) / SIZE / (1 - 0.5**p)
            curves.setdefault(family, {})[str(degree)] = {
                "error": e,
                "order": round(p, 2),
                "cells": cells,
                "seconds": f.seconds,
            }
            print(family, degree, curves[family][str(degree)], flush=True)
    return curves


def table(rows: dict[str, dict]) -> str:
    head = "| scene | centre: estimate | true | index | held | shape: estimate | true | index | held | order | cost |\n"
    head += "|---|" + "--:|" * 10 + "\n"
    return head + "".join(
        f"| {name} | "
        + " | ".join(
            f"{100 * r[k + '_estimate']:.1f} % | {100 * r[k + '_true']:.1f} % | {r[k + '_index']:.2f} | {r[k + '_held']:.0%}"
            for k in ("com", "shape")
        )
        + f" | {r['order']:.1f} | {r['cost']:.0%} |\n"
        for name, r in rows.items()
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one scene, coarser")
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--only", choices=("scenes", "curves", "accept"))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    cells = 8 if options.quick else 16
    rows = {}
    for scene in options.scenes[: 1 if options.quick else None]:
        rows[scene] = judge(filmed(scene, cells, Simulate(seconds=SECONDS, fps=FPS)))
        print(scene, {k: round(v, 3) for k, v in rows[scene].items()}, flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
