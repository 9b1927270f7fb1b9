"""Stiffness and yield stress learnt together: how much nearer training brings each, from four sides.

    python -m benchmarks stiffness_and_yield              # two minutes; goes on where it was killed
    python -m benchmarks stiffness_and_yield --seeds 5    # more draws of the particles

A ball of playdoh falls; the clip is that of another draw of its particles. Laws are known, E and σ_Y start at twice or
half of the truth, ``material.learn=[E,yield_stress]``. Writes docs/benchmarks/stiffness_and_yield.*.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import torch

from benchmarks.identify.bodies import SIZE, ball, skin_of_ball
from benchmarks.identify.rows import Rows, Stopwatch, machine
from diffuphy.learning.descent import descend
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.learning.probe import Probe
from diffuphy.learning.scan import region_values
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.types import Look, Motion
from diffuphy.workspace import Workspace

OUT = Path(__file__).parents[1] / "docs" / "benchmarks"
LEARNT = ("E", "yield_stress")
STARTS = {"both twice": (2.0, 2.0), "both half": (0.5, 0.5), "E twice, σ_Y half": (2.0, 0.5),
          "E half, σ_Y twice": (0.5, 2.0)}  # fmt: skip
"""Factors of E and σ_Y to start from."""
PARTICLES = 12_000
"""Of the ball; the drafts keep some."""


def train(start: tuple[float, float], seed: int, *, particles: int, steps: int) -> dict[str, Any]:
    """Factors of E and σ_Y that remain of a start, and the clip loss before and after."""
    stage = FitMaterial(
        guidance=Analytic(layout="clip", s=0.0), probe=Probe(particles=particles, seed=2 * seed), learn=LEARNT,
        elastic=("hencky",), plastic=("von_mises",), patience=0, seed=seed,
    )  # fmt: skip
    motion = Motion("falling", "a playdoh ball falling", {"": "playdoh"}, SIZE)
    case = stage.case(Look("ball", "a ball"), motion, skin_of_ball(), ball(PARTICLES, seed))
    (true,) = region_values(case.table, case.labels)
    off = {name: factor * true["theta"][name] for name, factor in zip(LEARNT, start, strict=True)}
    model = stage.model(case, [true | {"plastic": "von_mises", "theta": true["theta"] | off}])
    begin = descend(case, model, stage.descent(0), Workspace(progress=False)).score
    watch = Stopwatch()
    run = descend(case, model, stage.descent(steps), Workspace(progress=False))
    with torch.no_grad():
        theta = model().theta
    found = [math.exp(float(theta[name].log().mean())) / true["theta"][name] for name in LEARNT]
    return {"found": found, "loss": [begin, run.score], "at": run.at, "seconds": watch.seconds}


def taken_off(start: float, found: float) -> float:
    """Share of the error |ln factor| that training took off; negative where it grew."""
    return 1 - abs(math.log(found)) / abs(math.log(start))


def page(rows: list[dict[str, Any]]) -> str:
    """A row for each start: means over the seeds, and the range."""
    first = rows[0]
    text = "# Stiffness and yield stress together\n\n"
    text += f"A ball of playdoh of {SIZE} m, {first['particles']} particles, laws known, {first['steps']} steps of "
    text += "`material.learn=[E,yield_stress]`; the clip is that of another draw of particles. *Taken off*: share of "
    text += "the error of ln E and ln σ_Y that training took off, mean over the seeds and range; negative where it "
    text += f"grew. Seconds are processor times. {machine()}.\n\n"
    text += "| start | seeds | taken off ln E | taken off ln σ_Y | clip loss before | after | seconds |\n"
    text += "|---|--:|--:|--:|--:|--:|--:|\n"
    for name, start in STARTS.items():
        if not (its := [r for r in rows if r["start"] == name]):
            continue
        shares = []
        for i, factor in enumerate(start):
            s = [100 * taken_off(factor, r["found"][i]) for r in its]
            shares.append(f"{sum(s) / len(s):.0f} % ({min(s):.0f} to {max(s):.0f})")
        before, after = (sum(r["loss"][i] for r in its) / len(its) for i in (0, 1))
        seconds = sum(r["seconds"] for r in its) / len(its)
        text += f"| {name} | {len(its)} | {shares[0]} | {shares[1]} | {before:.1e} | {after:.1e} | {seconds:.0f} |\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", nargs="+", default=list(STARTS), choices=list(STARTS), metavar="START")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--particles", type=int, default=400)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    size = {"particles": options.particles, "steps": options.steps}
    rows = Rows(options.out / "stiffness_and_yield.json", ("start", "seed", *size))
    for seed in range(options.seeds):
        for name in options.starts:
            if not rows.has(start=name, seed=seed, **size):
                rows.add(start=name, seed=seed, **size, **train(STARTS[name], seed, **size))
    same = [r for r in rows.rows if size.items() <= r.items()]
    (options.out / "stiffness_and_yield.md").write_text(page(same))


if __name__ == "__main__":
    main()
