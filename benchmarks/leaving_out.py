"""What leaving a feature out saves: time, launches, bytes; and that it never costs.

    python -m benchmarks leaving_out [--particles 8000] [--repeat 9]

Every feature of the elimination matrix is run absent and at work on one body, the two taking turns, with a second run
of the first between them: its ratio to the first is what noise alone does. Processor time of one thread, kernels built
before. Writes docs/numerics/leaving_out.{json,md}.
"""

import argparse
import dataclasses
import gc
import json
import math
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from benchmarks.speed.body import describe, material
from benchmarks.speed.page import table
from diffuphy.mpm import Acceleration, HalfSpace, Held, InBox, Scene, Schedule, Scheme, State, simulate

ROOT = Path(__file__).resolve().parents[1]

FREE = Scheme(half_kick=False, mirror=False, sharpen=False, retain=0.0)
"""No part of the scheme that can be left out."""

DEFAULT = Scheme()
FLOOR = HalfSpace(friction=0.5)
FAR = HalfSpace(point=(0.0, 0.0, -100.0), friction=0.5)
STILL = Schedule(times=(0.0, 1.0), offsets=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))

VALUES = {"E": 2e4, "yield_stress": 50.0, "hardening": 0.0, "residual": 0.2, "E_N": 1e5, "relaxation_time": 0.01}
"""Parameters with which everything that can act does [SI]."""


@dataclass(frozen=True)
class Feature:
    """Something a scene may do without."""

    absent: Mapping[str, Any]
    """Settings of ``scene`` without it."""
    present: Mapping[str, Any]
    """Settings with it, at work."""
    neutral: Mapping[str, Any] | None = None
    """Settings with it, in which it does nothing; None where there are none."""
    why_not: str = ""
    """Why there is no neutral setting."""
    words: frozenset[str] = field(default_factory=frozenset)
    """Functions that its kernels call, and those of a scene without it do not."""
    launches: int = 0
    """Kernels a round that go with it."""
    particle: int = 0
    """Numbers of a particle's state that go with it."""
    node: int = 0
    """Rows of a node that go with it."""


def _feature(
    absent: Any, present: Any, neutral: Any = None, why_not: str = "", words: str = "", **counts: int
) -> Feature:
    return Feature(absent, present, neutral, why_not, frozenset(words.split()), **counts)


def _with(scheme: Scheme = FREE, **part: Any) -> dict[str, Any]:
    return {"scheme": dataclasses.replace(scheme, **part)}


BARE = {"scheme": FREE}
HENCKY = BARE | {"elastic": ("hencky",)}
METAL = HENCKY | {"plastic": ("von_mises",)}
HARDENING = HENCKY | {"plastic": ("von_mises_hardening",)}
TWO = HENCKY | {"elastic": ("hencky", "neo_hookean")}
SMOOTH, ROUGH, SLIP = (BARE | {"walls": (w,)} for w in (HalfSpace(), FLOOR, HalfSpace(kind="slip")))
EDGE = InBox(low=(-1.0, -1.0, -1.0), high=(0.1, 1.0, 1.0))
"""A part of the block."""
SUMS = {"walls": (FLOOR,), "gather": ("impulse", "expected_dv")}

FEATURES = {
    "plasticity": _feature(HENCKY, METAL, METAL | {"yield_stress": 1e30}, words="flow", particle=9),
    "decomposition": _feature(
        BARE, HENCKY, why_not="another form of the law: the same stress, rounded elsewhere", words="decompose sqrt"
    ),
    "several elastic experts": _feature(HENCKY, TWO, TWO | {"first": True}),
    "memory": _feature(
        METAL, HARDENING | {"hardening": 1e4}, words="stress_h", particle=1,
        why_not="with hardening 0 the return is that of von Mises, rounded elsewhere",
    ),
    "viscous branch": _feature(
        BARE, BARE | {"branches": ("maxwell",)}, why_not="its modulus is at least 100 Pa", words="branch_stress",
        particle=9,
    ),
    "walls": _feature(BARE, ROUGH, BARE | {"walls": (FAR,)}, words="act surface"),
    "friction": _feature(SMOOTH, ROUGH, BARE | {"walls": (HalfSpace(friction=0.0),)}, words="length"),
    "moving walls": _feature(
        ROUGH, BARE | {"walls": (HalfSpace(friction=0.5, velocity=(0.3, 0.0, 0.0)),)},
        BARE | {"walls": (HalfSpace(friction=0.5, schedule=STILL),)},
    ),
    "drives": _feature(
        BARE, BARE | {"drives": (Acceleration(acceleration=(5.0, 0.0, 0.0)),)},
        BARE | {"drives": (Acceleration(acceleration=(0.0, 0.0, 0.0)),)}, words="accelerate",
    ),
    "held matter": _feature(
        _with(sharpen=True), _with(sharpen=True) | {"drives": (Held(where=EDGE),)},
        _with(sharpen=True) | {"drives": (Held(where=EDGE, start=1e3),)}, words="mark join stops", node=3,
    ),
    "gravity": _feature(BARE | {"gravity": (0.0, 0.0, 0.0)}, BARE, BARE | {"gravity": (0.0, 0.0, -0.0)}),
    "retention": _feature(BARE, _with(retain=1.0), why_not="with a memory of velocities their gradient is turned too"),
    "sharpening": _feature(
        BARE, _with(sharpen=True), why_not="its coefficient belongs to the spline", words="sharpened gradient corner",
        launches=2, node=2,
    ),
    "mirror walls": _feature(
        SLIP, _with(mirror=True) | {"walls": (HalfSpace(kind="slip"),)},
        why_not="a mirror reflects, a wall without it sets nodes", words="folded image seen", launches=1, node=1,
    ),
    "half kick": _feature(BARE, _with(half_kick=True), why_not="one more round a frame"),
    "elastic contact": _feature(
        ROUGH, _with(contact="elastic") | {"walls": (FLOOR,)}, why_not="another law of contact", launches=1, node=1
    ),
    "gradient": _feature({}, {"grad": True}, {"grad": True}),
    "sums": _feature({"walls": (FLOOR,)}, SUMS, SUMS, launches=1),
    "diagnostics": _feature({}, {"diagnose": True}, {"diagnose": True}),
}  # fmt: skip
"""The features of a simulation."""


@dataclass(frozen=True)
class Setting:
    """A block that turns and falls a little, ready to be simulated."""

    scene: Scene
    x: torch.Tensor
    vol: torch.Tensor
    field: Any
    options: Mapping[str, Any]

    def states(self, report: list[Any]) -> list[State]:
        """The states of its film."""
        return list(simulate(self.scene, self.x, self.vol, self.field, report=report, threads=1, **self.options))


def setting(
    *, cells: int = 2, elastic: tuple[str, ...] = ("neo_hookean",), plastic: tuple[str, ...] = ("identity",),
    branches: tuple[str, ...] = (), first: bool = False, walls: Any = (), drives: Any = (), scheme: Scheme = DEFAULT,
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81), grad: bool = False, gather: tuple[str, ...] = (),
    diagnose: bool = False, frames: int = 2, **theta: float,
) -> Setting:  # fmt: skip
    """The block of a feature: ``cells`` grid cells along its shorter sides, 8 particles each.

    Args:
        first: all weight on the first elastic expert instead of equal weights.
        theta: parameters, instead of ``VALUES``.
    """
    dx, laws = 0.1 / cells, (elastic, plastic, branches)
    axes = [(torch.arange(2 * k) + 0.5) * 0.5 * dx for k in (cells + 1, cells, cells)]
    x = torch.cartesian_prod(*axes) + torch.tensor([0.0, 0.0, 0.5 * dx])
    f = material(laws, len(x), torch.float32)
    values = {k: v for k, v in (VALUES | theta).items() if k in f.theta}
    f = dataclasses.replace(f, theta=f.theta | {k: torch.full_like(f.rho, v) for k, v in values.items()})
    if first:
        f = dataclasses.replace(f, w_e=torch.zeros_like(f.w_e).index_fill(1, torch.tensor(0), 1.0))
    scene = Scene(
        dx=dx, fps=60.0, frames=frames, lift=None, gravity=gravity, velocity=(0.2, 0.1, -0.5), spin=(1.0, 2.0, 3.0),
        boundaries=walls, drives=drives, scheme=scheme,
    )  # fmt: skip
    return Setting(
        scene, x, torch.full((len(x),), (0.5 * dx) ** 3), f, dict(grad=grad, gather=gather, diagnose=diagnose)
    )


def cost(s: Setting) -> float:
    """Processor time of a particle and round [s]."""
    report: list[Any] = []
    begin = time.process_time()
    s.states(report)
    seconds = time.process_time() - begin
    return seconds / len(s.x) / sum(r.n_sub for r in report)


def measure(name: str, cells: int, repeat: int) -> dict[str, Any]:
    """Time with the feature over that without it, and what repeating the latter gives."""
    f = FEATURES[name]
    absent, again, present = (setting(cells=cells, frames=1, **s) for s in (f.absent, f.absent, f.present))
    times: list[tuple[float, float, float]] = []
    gc.disable()
    for _ in range(repeat + 1):
        a, p, b = cost(absent), cost(present), cost(again)
        times.append((a, b, p))
        gc.collect()
    gc.enable()
    kept = times[1:]  # the first turn builds kernels
    noise = [math.log(b / a) for a, b, _ in kept]
    ratio = [math.log(2 * p / (a + b)) for a, b, p in kept]
    return {
        "feature": name,
        "ns": 1e9 * statistics.median(min(a, b) for a, b, _ in kept),
        "ratio": math.exp(statistics.median(ratio)),
        "noise": math.exp(statistics.median(map(abs, noise))) - 1.0,
        "launches": f.launches,
        "particle": 4 * f.particle,
        "node": 32 * f.node,
        "words": " ".join(sorted(f.words)),
        "neutral": "equal to the last bit" if f.neutral is not None else f"none: {f.why_not}",
    }


PAGE = """# Leaving out

A run pays for what its scene has, and for nothing else. The plan says line by line what is left out, why, and what that
saves; this page says how it is known.

*How a part is left out.* Kernels are generated for one scene: the laws of its candidates, its walls, the parts of its
scheme; what is absent is not in their text, so that it costs no branch, no register and no byte. State that only some
laws have (a second deformation gradient, what hardens, a viscous branch) is not allocated for others. A loss of weight
0 is not evaluated, and the sums that it would compare with are not gathered; a prior that nobody asked for is not
imported. After the training, experts with a weight below 10⁻³ in every particle are pruned before the film: the report
says which, and how far a drop moves by it (`pruning_change`).

*How that is tested* (`tests/test_leave_out.py`, `tests/test_leave_out_stages.py`). For each feature three runs: absent,
neutral, at work. Where a neutral setting exists, absent and neutral agree in every bit of x, v, C and Fe; where there
is none, the table says why. Absent, its functions are not in the generated source, a round launches as many kernels
fewer, and a particle and a node have as many bytes less. At work, it changes the result, so that the equality says
something.
One exception to the last bit: with plasticity the *total* deformation gradient, which only moves the Gaussians, is an
array of its own, and rounds on its own (2·10⁻⁸ here).

Outside the simulation the same holds of the velocity loss (weight 0 is no velocity loss, bit by bit), harmonics (zero
coefficients are degree 0), interior fill (a solid has none), unused experts (one-hot weights are the pruned mixture);
and of what is only run or not: the scan, the gradient with its kernels, shadow, decomposition of what is not stretched,
report and film of a run that ends before, packages of diffusion models.
"""

NOTES = """Time: with the feature over without it, median over turns; noise: the same of two runs without it.
Launches a round, bytes of a particle's state and of a node, functions in the source: with the feature, less without.
Gravity and the motion of a wall are data: there is nothing to generate. A gradient costs nothing forward under the
default scheme, which goes through its nodes twice anyway.

"""


def page(machine: str, rows: list[dict[str, Any]]) -> str:
    """Text and table."""
    head = ["feature", "without [ns]", "time with it", "noise", "launches", "B a particle", "B a node", "functions",
            "neutral setting"]  # fmt: skip
    body = [
        [r["feature"], f"{r['ns']:.0f}", f"× {r['ratio']:.2f}", f"{r['noise']:.0%}", r["launches"], r["particle"],
         r["node"], f"`{r['words']}`" if r["words"] else "", r["neutral"]]
        for r in rows
    ]  # fmt: skip
    return f"{PAGE}\n## What each feature of a simulation costs\n\n{machine}. {NOTES}{table(head, body)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=10, help="grid cells along the shorter sides of the block")
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--features", nargs="+", default=list(FEATURES), choices=list(FEATURES))
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "numerics")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for name in options.features:
        rows.append(measure(name, options.cells, options.repeat))
        print(json.dumps(rows[-1]), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "leaving_out.json").write_text(json.dumps({"machine": describe(), "rows": rows}, indent=1))
    (options.out / "leaving_out.md").write_text(page(describe(), rows), encoding="utf-8")


if __name__ == "__main__":
    main()
