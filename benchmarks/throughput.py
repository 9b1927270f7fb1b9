"""Million particle-substeps per second of processor time, forward and backward, by material and number of particles.

    python benchmarks/throughput.py [--particles 20000 100000] [--repeat 7]

Processor time of this process, the best of some frames: on a shared machine the fastest one is the least disturbed.
A cube of neo-Hookean, Hencky or flowing material falls freely with 8 particles a cell; walls cost below 1 %.
"""

import argparse
import dataclasses
import json
import math
import os
import platform
import time
from pathlib import Path

import torch

from diffuphy.material import make_mixture
from diffuphy.mpm.rollout import _span
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.solver import Solver
from diffuphy.mpm.state import REAL, State, initial_state, make_matter
from diffuphy.types import MaterialField

CASES = {
    "neo-Hookean": (("neo_hookean",), ("identity",)),
    "fixed corotated": (("fixed_corotated",), ("identity",)),
    "Hencky, von Mises": (("hencky",), ("von_mises",)),
    "3 elastic, 3 plastic": (
        ("neo_hookean", "fixed_corotated", "hencky"),
        ("identity", "von_mises", "drucker_prager"),
    ),
}
N_SUB = 10


def measure(case: str, n: int, dtype: torch.dtype, repeat: int) -> dict[str, float | str | int]:
    """Best frame of ``repeat``: throughput forward, and time of backward relative to forward."""
    elastic, plastic = CASES[case]
    side = math.ceil(n ** (1 / 3))
    spacing = 0.5 / side
    generator = torch.Generator().manual_seed(0)
    a = torch.arange(side, dtype=dtype)
    x = torch.cartesian_prod(a, a, a)[:n]
    x = (x + 0.5 + 0.4 * (torch.rand(x.shape, generator=generator, dtype=dtype) - 0.5)) * spacing
    n = len(x)
    vol = torch.full((n,), spacing**3, dtype=dtype)
    values = {"E": 1e5, "nu": 0.3, "yield_stress": 1e3, "friction_angle": 30.0, "cohesion": 0.0}
    theta = {k: torch.full((n,), v, dtype=dtype) for k, v in values.items()}
    weights = [torch.full((n, len(k)), 1 / len(k), dtype=dtype) for k in (elastic, plastic)]
    field = MaterialField(elastic, plastic, *weights, theta, torch.full((n,), 1000.0, dtype=dtype))
    scene = Scene(dx=2 * spacing, boundaries=(), spin=(0.0, 0.0, 3.0))
    mixture = make_mixture(elastic, plastic, REAL[dtype])
    matter = make_matter(field, vol, mixture.params, dtype)
    solver = Solver(mixture, scene.boundaries, scene.gravity, dtype, "cpu")
    state = initial_state(scene, x, matter, mixture, 0.1 * torch.sin(10 * x))
    span, _ = _span(scene, state, torch.full((n,), 11.6), None)
    span = dataclasses.replace(span, n_sub=N_SUB)
    forward, backward, kept_backward = [], [], []
    for _ in range(repeat + 1):
        begin = time.process_time()
        solver.advance(state, matter, span)
        forward.append(time.process_time() - begin)
        *_, kept = solver.advance(state, matter, span, keep=True)
        for times, source in ((backward, None), (kept_backward, kept)):
            parts = (state.x, state.v, state.C, state.He, state.H, state.log_J)
            bars = State(*(None if t is None else torch.ones_like(t) for t in parts))
            begin = time.process_time()
            solver.advance_adjoint(state, matter, span, bars, (True, True, True, True), kept=source)
            times.append(time.process_time() - begin)
    return {
        "case": case,
        "particles": n,
        "precision": str(dtype).split(".")[1],
        "forward_M_per_s": round(n * N_SUB / min(forward[1:]) / 1e6, 2),
        "backward_over_forward": round(min(backward[1:]) / min(forward[1:]), 2),
        "backward_over_forward_kept": round(min(kept_backward[1:]) / min(forward[1:]), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, nargs="+", default=[2000, 20000, 100000])
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--double", action="store_true", help="float64 as well")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs" / "benchmarks")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for dtype in (torch.float32, torch.float64) if options.double else (torch.float32,):
        for n in options.particles:
            for case in CASES:
                rows.append(measure(case, n, dtype, options.repeat))
                print(json.dumps(rows[-1]), flush=True)
    machine = f"one of {os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "throughput.json").write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))
    (options.out / "throughput.md").write_text(page(machine, rows))


def page(machine: str, rows: list[dict]) -> str:
    """The rows as a page."""
    text = f"# Simulation\n\n{machine}; process time, best of several. Kept: the forward pass keeps its substeps.\n\n"
    text += "| laws | particles | precision | forward [M particle-substeps/s] | backward/forward | the same, kept |\n"
    text += "|---|---|---|---|---|---|\n"
    for r in rows:
        text += f"| {r['case']} | {r['particles']} | {r['precision']} | {r['forward_M_per_s']} "
        text += f"| {r['backward_over_forward']} | {r['backward_over_forward_kept']} |\n"
    return text


if __name__ == "__main__":
    main()
