"""How exact gradients are, how they grow with the horizon, and from where on cutting them pays.

    python -m benchmarks gradients            # some minutes on one core: docs/numerics/gradients.md
    python -m benchmarks gradients --quick    # one stiffness and short films, to see that it runs

A cube of two cells and 64 particles flies, bounces, falls again and again, or slides. The adjoint in float64 is held
against central differences, that in float32 against it; and the gradient of a fit to another film, exact and cut every
few frames (``window``), against the slope of its loss over ten per cent of stiffness, which is what a descent needs.
"""

import argparse
import csv
import dataclasses
import math
import platform
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor

from benchmarks._draw import Curve, Plot, plots
from benchmarks.verification.bodies import Body, block
from diffuphy.mpm import HalfSpace, Scene, Scheme, State, simulate
from diffuphy.types import SimulationDiverged

DOCS = Path(__file__).resolve().parents[1] / "docs"
DX, FPS, FALL = 0.05, 50.0, (0.0, 0.0, -9.81)
FREE = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=FPS, boundaries=(), lift=None)
FLOOR = Scene(
    gravity=FALL, dx=DX, fps=FPS, boundaries=(HalfSpace(friction=0.3),), scheme=Scheme(contact="elastic"), lift=0.1
)
SCENES = {
    "flies": FREE,
    "bounces once": dataclasses.replace(FLOOR, gravity=(0.0, 0.0, 0.0), lift=0.05, velocity=(0.0, 0.0, -1.0)),
    "falls again and again": FLOOR,
    "slides": dataclasses.replace(FLOOR, lift=0.0, velocity=(1.0, 0.0, 0.0)),
}
"""What the cube does; it vibrates as well."""
STIFF = (1e4, 1e5, 1e6, 1e7)
HORIZONS = (1, 2, 4, 8, 16, 32, 64)
"""Frames."""
STEPS = (1e-3, 1e-4, 1e-5, 1e-6)
"""Of the differences in ln E; the best counts, since which it is depends on the horizon."""
WINDOWS = (1, 4, 16)
"""Frames between cuts."""
SECANT = 0.05
"""Change of ln E over which a descent is to go down."""
TARGET = 1.5
"""Stiffness of the film to be matched, over that of the guess."""

Row = dict[str, str | float]


def cube(dtype: torch.dtype = torch.float64) -> Body:
    """The cube, off the lattice."""
    return block((2, 2, 2), DX, (0.013, 0.021, 0.337)).to(dtype)


def substep(E: float) -> float:
    """A step that is stable for a stiffness 10 % higher, and the same for all those nearby [s]."""
    top = dataclasses.replace(cube(), E=TARGET * 1.1 * E)
    return 1.0 / FPS / math.ceil((top.c + 4.0) / (0.4 * DX * FPS))


def film(
    scene: Scene, E: float, log_E: Tensor, shake: Tensor, frames: int, *, grad: bool = True, window: int | None = None
) -> Iterator[State]:
    """States of the cube of stiffness E exp(log_E) that is shaken at first; the substep goes by E alone."""
    body = cube(shake.dtype)
    young = E * log_E.exp() * torch.ones_like(body.vol)
    material = dataclasses.replace(body.field, theta=body.field.theta | {"E": young.to(shake.dtype)})
    options = {"frames": frames, "dt": substep(E) * (1 + 1e-9), "velocity": shake, "grad": grad}
    return simulate(scene, body.x, body.vol, material, window=window, **options)  # type: ignore[arg-type]


def shaken(dtype: torch.dtype = torch.float64) -> Tensor:
    """Velocities at first [m/s]."""
    return 0.2 * torch.sin(9.0 * cube(dtype).x)


def weights(dtype: torch.dtype = torch.float64) -> Tensor:
    """A direction in the space of all places."""
    a = torch.randn(cube().x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(9))
    return (a / a.norm()).to(dtype)


def adjoint(scene: Scene, E: float, horizons: Sequence[int], dtype: torch.dtype) -> dict[int, tuple[float, Tensor]]:
    """∂(a·x)/∂ln E [m] and ∂(a·x)/∂v0 [s] after some numbers of frames."""
    log_E, v = torch.zeros((), dtype=dtype, requires_grad=True), shaken(dtype).requires_grad_()
    states, found = list(film(scene, E, log_E, v, max(horizons))), {}
    for n in horizons:
        to_E, to_v = torch.autograd.grad((weights(dtype) * states[n].x).sum(), [log_E, v], retain_graph=True)
        found[n] = float(to_E), to_v.double()
    return found


def differences(scene: Scene, E: float, horizons: Sequence[int], h: float) -> dict[int, float]:
    """The first of them by central differences of h."""
    ends = []
    for sign in (1.0, -1.0):
        log_E = torch.tensor(sign * h, dtype=torch.float64)
        ends.append(list(film(scene, E, log_E, shaken(), max(horizons), grad=False)))
    return {n: float((weights() * (ends[0][n].x - ends[1][n].x)).sum()) / (2 * h) for n in horizons}


def exactness(name: str, E: float, horizons: Sequence[int], steps: Sequence[float]) -> list[Row]:
    """Gradients of one scene: growth, error against differences, error of float32."""
    scene = SCENES[name]
    double = adjoint(scene, E, horizons, torch.float64)
    single = adjoint(scene, E, horizons, torch.float32)
    by_step = [differences(scene, E, horizons, h) for h in steps]
    rows: list[Row] = []
    for n in horizons:
        g, to_v = double[n]
        best = min(abs(d[n] - g) for d in by_step) / abs(g)
        rows.append(
            {
                "scene": name, "E": E, "frames": n, "time": n / FPS, "substeps": round(n / FPS / substep(E)),
                "d_ln_E": g, "d_v0": float(to_v.norm()), "growth": float(to_v.norm()) * FPS / n,
                "differences": best, "float32_E": abs(single[n][0] - g) / abs(g),
                "float32_v0": float((single[n][1] - to_v).norm() / to_v.norm()),
            }
        )  # fmt: skip
    return rows


def mismatch(states: Sequence[State], goal: Sequence[State], n: int) -> Tensor:
    """Mean square distance from another film over the first n frames [m²]."""
    pairs = zip(states[1 : n + 1], goal[1 : n + 1], strict=True)
    return torch.stack([(a.x - b.x).square().sum(1).mean() for a, b in pairs]).mean()


def truncation(name: str, E: float, horizons: Sequence[int], windows: Sequence[int]) -> list[Row]:
    """d ln L/d ln E of the fit to a film TARGET times as stiff: exact, cut, and over a tenth of E."""
    scene, top = SCENES[name], max(horizons)
    fixed = [
        list(film(scene, E, torch.tensor(math.log(k), dtype=torch.float64), shaken(), top, grad=False))
        for k in (TARGET, math.exp(SECANT), math.exp(-SECANT))
    ]
    slopes: dict[int | None, dict[int, float]] = {}
    for window in (None, *windows):
        log_E = torch.zeros((), dtype=torch.float64, requires_grad=True)
        states = list(film(scene, E, log_E, shaken(), top, window=window))
        slopes[window] = {}
        for n in horizons:
            loss = mismatch(states, fixed[0], n)
            try:
                (g,) = torch.autograd.grad(loss, [log_E], retain_graph=True)
                slopes[window][n] = float(g) / float(loss.detach())
            except SimulationDiverged:
                slopes[window][n] = math.inf
    rows: list[Row] = []
    for n in horizons:
        up, down = (float(mismatch(s, fixed[0], n)) for s in fixed[1:])
        secant = (math.log(up) - math.log(down)) / (2 * SECANT)
        row: Row = {"scene": name, "E": E, "frames": n, "time": n / FPS, "secant": secant}
        row |= {"exact" if w is None else f"window {w}": slopes[w][n] for w in slopes}
        rows.append(row)
    return rows


def off(row: Row, which: str) -> float:
    """Distance of a slope from that over a tenth of E, over itself."""
    return abs(float(row[which]) - float(row["secant"])) / abs(float(row["secant"]))


# ---------------------------------------------------------------------- pages
def draw(path: Path, exact: list[Row], cut: list[Row]) -> None:
    """Growth, errors, and what cutting does."""
    names, stiff = (list(dict.fromkeys(r[k] for r in exact)) for k in ("scene", "E"))
    middle = 1e5 if 1e5 in stiff else stiff[0]
    hard = max(float(r["E"]) for r in cut)

    def curves(rows: list[Row], by: str, values: Sequence[str | float], y: str) -> list[Curve]:
        every = []
        for k, value in enumerate(values):
            label = value if isinstance(value, str) else f"E = {value:.0e} Pa".replace("e+0", "e")
            every.append(Curve(label, [(float(r["time"]), max(float(r[y]), 1e-16)) for r in rows if r[by] == value], k))
        return every

    at_middle = [r for r in exact if r["E"] == middle]
    falls = [r for r in exact if r["scene"] == "falls again and again"]
    slopes = [r for r in cut if r["E"] == hard]
    which = [k for k in slopes[0] if k == "exact" or k.startswith("window")]
    cuts = [Curve(w, [(float(r["time"]), off(r, w)) for r in slopes], k) for k, w in enumerate(which)]
    per_time, error, fall = "|dx/dv0| / t", "relative error", "falls again and again"
    several = [
        (f"Growth by stiffness, {fall}", per_time, curves(falls, "E", stiff, "growth")),
        (f"Growth by motion, E = {middle:.0e} Pa", per_time, curves(at_middle, "scene", names, "growth")),
        ("d/d ln E: float64 against differences", error, curves(falls, "E", stiff, "differences")),
        ("d/d ln E: float32 against float64", error, curves(falls, "E", stiff, "float32_E")),
        ("d/dv0: float32 against float64, by motion", error, curves(at_middle, "scene", names, "float32_v0")),
        (f"Slope of a fit against that over 10 % of E, {hard:.0e} Pa", error, cuts),
    ]
    plots(path, "Gradients through time", [Plot(title, "horizon [s]", y, c) for title, y, c in several])


def generated(machine: str, exact: list[Row], cut: list[Row]) -> str:
    """The measured part of the page."""
    text = f"Measured on {machine}.\n\n![Growth and errors of gradients](gradients.png)\n\n### Growth and exactness\n\n"
    text += "| motion | E [Pa] | horizon [s] | substeps | \\|∂x/∂v0\\|/t | adjoint − differences | float32, ∂/∂ln E "
    text += "| float32, ∂/∂v0 |\n|---|--:|--:|--:|--:|--:|--:|--:|\n"
    for r in exact:
        text += f"| {r['scene']} | {r['E']:.0e} | {r['time']:.2f} | {r['substeps']} | {r['growth']:.3g} "
        text += f"| {r['differences']:.1e} | {r['float32_E']:.1e} | {r['float32_v0']:.1e} |\n"
    which = [k for k in cut[0] if k == "exact" or k.startswith("window")]
    text += "\n### Where cutting pays\n\nSlope d ln L/d ln E of the fit; bold: nearest to that over a tenth of E.\n\n"
    text += "| motion | E [Pa] | horizon [s] | over a tenth of E | " + " | ".join(which) + " |\n"
    text += "|---|--:|--:|--:|" + "--:|" * len(which) + "\n"
    for r in cut:
        nearest = min(which, key=lambda w, row=r: off(row, w))
        words = [f"**{r[w]:.3g}**" if w == nearest else f"{r[w]:.3g}" for w in which]
        text += f"| {r['scene']} | {r['E']:.0e} | {r['time']:.2f} | {r['secant']:.3g} | " + " | ".join(words) + " |\n"
    return text + "\n"


def save(path: Path, rows: list[Row]) -> None:
    """Raw numbers."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows([{k: f"{v:.6g}" if isinstance(v, float) else v for k, v in r.items()} for r in rows])


def main() -> int:
    from benchmarks.stability.report import put

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one stiffness, two motions, short films")
    parser.add_argument("--out", type=Path, help="a folder for everything; by default docs/")
    options = parser.parse_args()
    torch.set_num_threads(1)
    horizons = HORIZONS[:3] if options.quick else HORIZONS
    jobs = [("falls again and again", E) for E in (STIFF[1:2] if options.quick else STIFF)]
    if not options.quick:
        jobs += [(name, 1e5) for name in SCENES if name != "falls again and again"]
    exact = [r for name, E in jobs for r in exactness(name, E, horizons, STEPS[2:] if options.quick else STEPS)]
    stiff = STIFF[1:2] if options.quick else STIFF
    cut = [r for E in stiff for r in truncation("falls again and again", E, horizons, WINDOWS)]
    raw, pages = (DOCS / "benchmarks" / "gradients", DOCS / "numerics") if options.out is None else (options.out,) * 2
    for folder in (raw, pages):
        folder.mkdir(parents=True, exist_ok=True)
    save(raw / "exactness.csv", exact)
    save(raw / "truncation.csv", cut)
    draw(pages / "gradients.png", exact, cut)
    minutes = time.process_time() / 60
    machine = f"one core ({platform.machine()}), torch {torch.__version__}, in {minutes:.1f} minutes of it"
    text = generated(machine, exact, cut)
    put(pages / "gradients.md", {"measured": text})
    print(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
