"""How true a film's own error estimate is, what halving the grid spacing brings, and the curves behind ``accuracy=``.

    python -m benchmarks errors                   # all tables, about six minutes
    python -m benchmarks errors --quick           # one scene of each, coarser
    python -m benchmarks errors --only accept     # default spacing and half of it, on a scene that built no page

Each scene is filmed with 12 cells along the body; the reference has 24, the drafts of the estimate 6. With an error of
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
from typing import Any

import torch
from torch import Tensor

from diffuphy.accuracy import CURVES
from diffuphy.errors import Estimate, split
from diffuphy.judgement import BAND, FALL
from diffuphy.material import presets
from diffuphy.mpm import Scheme, rollout
from diffuphy.mpm.restrict import Restriction, restrict
from diffuphy.mpm.trajectory import Simulate
from diffuphy.render.film.clip import Film
from diffuphy.types import Errors, Motion, Particles
from diffuphy.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "benchmarks"
PAGE = ROOT / "docs" / "numerics" / "errors.md"
MADE = "python -m benchmarks errors --only curves"
LEAST, MOST = 0.5, 2.0
"""Orders between which the schemes are known to lie; three coarse grids may show anything [-]."""
SIZE, SECONDS, FPS = 0.5, 1.0, 30.0
SCENES = (
    "ball rubber falling", "brick jelly thrown", "torus clay falling", "tower sand collapsing", "brick snow falling",
    "brick wood sliding", "tower plasticine squashed", "ball dough melting",
)  # fmt: skip
"""Body, material, motion. None of them made the curves or settled a constant."""
ACCEPT = "dumbbell cheese falling"
"""Neither."""
SWEPT = {
    "elastic": ("ball jelly falling", 0.6),
    "plastic": ("ball playdoh falling", 0.6),
    "granular": ("ball sand falling", 0.6),
    "paste": ("ball honey falling", 0.6),
    "fluid": ("ball water collapsing", 0.4),
}
"""The scene that stands for a family of materials in the curves, and its length [s]; water splashes after that, and the
spray is turned inside out."""


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


def coarse(fine: Particles, rho: Tensor) -> tuple[Particles, Restriction]:
    """The same body with twice the spacing."""
    r = restrict(fine.x, fine.vol, rho, spacing=fine.spacing, side=2 * fine.spacing)
    parts = Particles(r.x.float(), r.vol.float(), fine.gaussian[r.near], fine.scale, fine.offset, 2 * fine.spacing)
    return parts, r


def filmed(scene: str, cells: int, simulate: Simulate, estimate: Estimate) -> Filmed:
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
    errors = dataclasses.replace(estimate, scene=simulate, film=Film())(
        motion, particles, field, trajectory, work=Workspace()
    )
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
    row |= {"order": math.log2(max(float(far / near) - 1.0, 0.1))}
    # with half the spacing the report would show the difference to the reference, half of what is true here
    reported, halved = (math.hypot(row[f"com_{k}"], row[f"shape_{k}"]) for k in ("estimate", "true"))
    return row | {"factor": 2 * reported / halved}


def sweep(quick: bool) -> dict[str, dict[str, dict[str, float]]]:
    """Curves of ``diffuphy.accuracy`` for each family of materials and degree of the spline."""
    cells, found = (6, 12)[not quick], {}
    for family, (scene, seconds) in list(SWEPT.items())[: 1 if quick else None]:
        of: dict[str, dict[str, float]] = {}
        for degree in (2, 3):
            simulate = Simulate(seconds=seconds, scheme=Scheme(order=degree, contact="elastic"))
            f = filmed(scene, cells, simulate, Estimate(time=False, precision=degree == 2))
            p = min(max(judge(f)["order"], LEAST), MOST)
            e = float(torch.hypot(*split(f.difference, f.weight)).max()) / SIZE / (1 - 0.5**p)
            rounding = float(f.errors.parts["precision"].max()) / SIZE if degree == 2 else of["2"]["rounding"]
            price = f.seconds / of["2"]["seconds"] if of else 1.0
            of[str(degree)] = {
                "error": e, "order": p, "cells": cells, "finest": 2 * cells, "price": price, "rounding": rounding,
                "seconds": f.seconds,
            }  # fmt: skip
            print(family, degree, rounded(of[str(degree)]), flush=True)
        found[family] = {degree: {k: v for k, v in rounded(c).items() if k != "seconds"} for degree, c in of.items()}
    return found


def accept(cells: int) -> dict[str, float]:
    """What the report says with these cells and with twice as many, on a scene that built no page."""
    kind, word, verb = ACCEPT.split()
    motion, said = Motion(verb, ACCEPT, {"": word}, SIZE), []
    fine = body(kind, 2 * cells)
    half, _ = coarse(fine, torch.full((len(fine),), presets.lookup(word).rho))
    simulate = Simulate(seconds=0.6, fps=FPS)
    for particles in (half, fine):
        field = presets.field(presets.lookup(word), len(particles))
        trajectory = simulate(motion, particles, field, work=Workspace())
        estimate = Estimate(time=False, scene=simulate, film=Film())
        errors = estimate(motion, particles, field, trajectory, work=Workspace())
        said.append(math.hypot(float(errors.com.max()), float(errors.shape.max())) / SIZE)
        print(f"{ACCEPT}: {len(particles)} particles, reported error {said[-1]:.2%} of the size", flush=True)
    return {"cells": cells, "reported": said[0], "halved": said[1], "factor": said[0] / said[1]}


def rounded(row: dict[str, float]) -> dict[str, float]:
    return {k: float(f"{v:.3g}") for k, v in row.items()}


def scene_table(rows: dict[str, dict[str, float]]) -> str:
    each = "estimate | true | index | held"
    lines = [f"| scene | centre: {each} | shape: {each} | order | factor | cost |\n|---|{'--:|' * 11}"]
    for name, r in rows.items():
        cells = [
            f"{r[k + '_estimate']:.1%} | {r[k + '_true']:.1%} | {r[k + '_index']:.2f} | {r[k + '_held']:.0%}"
            for k in ("com", "shape")
        ]
        lines.append(f"| {name} | {' | '.join(cells)} | {r['order']:.1f} | {r['factor']:.1f} | {r['cost']:.0%} |")
    index, held = ([r[f"{k}_{what}"] for r in rows.values() for k in ("com", "shape")] for what in ("index", "held"))
    words = f"Indices lie between {min(index):.2f} and {max(index):.2f}; the band held in {min(held):.0%} of the frames"
    return "\n".join([*lines, "", f"{words} of the worst scene, in {sum(held) / len(held):.0%} of all."])


def curve_table(found: dict[str, dict[str, dict[str, float]]]) -> str:
    lines = ["| matter | splines | e₀ | n₀ | p | price | float32 |\n|---|---|--:|--:|--:|--:|--:|"]
    for family, of in found.items():
        for degree, c in of.items():
            spline = {"2": "quadratic", "3": "cubic"}[degree]
            lines.append(
                f"| {family} | {spline} | {c['error']:.1%} | {c['cells']:g} | {c['order']:.2f} | {c['price']:.2f} "
                f"| {c['rounding']:.0e} |"
            )
    return "\n".join(lines)


def fall(rows: dict[str, dict[str, float]]) -> tuple[float, float, float]:
    """By what half the spacing divides an error: least, geometric mean and greatest of the scenes, to two digits."""
    logs = [math.log(r["factor"]) for r in rows.values()]
    least, mean, most = (math.exp(v) for v in (min(logs), sum(logs) / len(logs), max(logs)))
    return math.floor(10 * least) / 10, round(mean, 1), math.ceil(10 * most) / 10


def accept_words(a: dict[str, float]) -> str:
    return (
        f"*{ACCEPT}*, which built neither table: with {a['cells']:g} cells the report says {a['reported']:.1%} of the "
        f"size, with {2 * a['cells']:g} it says {a['halved']:.1%}: a factor of {a['factor']:.2f}; claimed are "
        f"{FALL[1]:g}, from {FALL[0]:g} to {FALL[2]:g}."
    )


def filled(page: str, name: str, text: str) -> str:
    """The page with ``text`` between the marks of a part.

    Raises:
        ValueError: a page without them.
    """
    begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the page has no part between {begin.strip()} and {end}; add both lines")
    return f"{before}{begin}{text}\n{end}{after}"


def write(out: Path, results: dict[str, Any]) -> None:
    """The JSON, and what of the page is made from it."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "errors.json"
    before = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    file.write_text(json.dumps(before | results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    page = PAGE.read_text(encoding="utf-8")
    parts = {"scenes": scene_table, "curves": curve_table, "accept": accept_words}
    for name, words in parts.items():
        if name in results:
            page = filled(page, name, words(results[name]))
    (out / PAGE.name).write_text(page, encoding="utf-8") if out != OUT else PAGE.write_text(page, encoding="utf-8")
    if "curves" in results:
        where = CURVES if out == OUT else out / CURVES.name
        where.write_text(json.dumps({"made by": MADE, "curves": results["curves"]}, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one scene of each, coarser")
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--only", choices=("scenes", "curves", "accept"), help="one part; the others stay as they are")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    results: dict[str, Any] = {"machine": f"{platform.processor() or platform.machine()}, torch {torch.__version__}"}
    if options.only in (None, "scenes"):
        results["scenes"] = {}
        for scene in options.scenes[: 1 if options.quick else None]:
            row = judge(filmed(scene, 8 if options.quick else 12, Simulate(seconds=SECONDS, fps=FPS), Estimate()))
            results["scenes"][scene] = rounded(row)
            print(scene, results["scenes"][scene], flush=True)
    if options.only in (None, "curves"):
        results["curves"] = sweep(options.quick)
    if options.only in (None, "accept"):
        results["accept"] = rounded(accept(10 if options.quick else 28))
    write(options.out, results)
    for name, words in (("scenes", scene_table), ("curves", curve_table), ("accept", accept_words)):
        if name in results:
            print(f"\n{words(results[name])}")


if __name__ == "__main__":
    main()
