"""Where contact happens: heights at rest and in a bounce, a ball against Hertz, friction against Coulomb.

    python -m benchmarks contact            # three tables, about two minutes
    python -m benchmarks contact --quick    # one row of each

Elastic contact, as films have it, rigid planes of nodes, and the plain MLS scheme, side by side. Writes
docs/benchmarks/contact.{json,md}.
"""

import argparse
import json
import math
import platform
from pathlib import Path

import torch
from torch import Tensor

from diffuphy.mpm import HalfSpace, Scene, Scheme, rollout, simulate
from diffuphy.types import MaterialField

OUT = Path(__file__).parent.parent / "docs" / "benchmarks"
SCHEMES = {"elastic": Scheme(contact="elastic"), "rigid": Scheme(), "MLS": Scheme.mls()}
MATTER = {
    "neo-Hookean, 1 MPa": ("neo_hookean", "identity", 1e6),
    "neo-Hookean, 0.1 MPa": ("neo_hookean", "identity", 1e5),
    "neo-Hookean, 20 kPa": ("neo_hookean", "identity", 2e4),
    "plasticine (von Mises, 1 kPa)": ("hencky", "von_mises", 1e5),
    "sand": ("hencky", "drucker_prager_plane_strain", 1e6),
    "fluid": ("hencky", "fluid", 1e5),
}
G, RHO = 9.81, 1000.0


def block(cells: tuple[int, int, int], dx: float) -> tuple[Tensor, Tensor]:
    """Eight particles a cell, and their volumes."""
    axes = [(torch.arange(2 * c, dtype=torch.float64) + 0.5) * dx / 2 for c in cells]
    x = torch.cartesian_prod(*axes)
    return x, torch.full((len(x),), (dx / 2) ** 3, dtype=x.dtype)


def material(n: int, elastic: str, plastic: str, E: float, nu: float = 0.3) -> MaterialField:
    one = torch.ones(n, dtype=torch.float64)
    values = {"E": E, "nu": nu, "yield_stress": 1e3, "friction_angle": 31.0, "cohesion": 0.0}
    theta = {k: v * one for k, v in values.items()}
    return MaterialField((elastic,), (plastic,), one[:, None], one[:, None], theta, RHO * one)


def height(matter: str, scheme: Scheme, drop: float, frames: int) -> float:
    """Least height of the lowest particle above where it belongs, of a cube of 0.5 m on cells of 1/16 m [Δx]."""
    dx = 1 / 16
    x, vol = block((8, 8, 8), dx)
    scene = Scene(dx=dx, fps=100.0, frames=frames, lift=drop, boundaries=(HalfSpace(friction=0.5),), scheme=scheme)
    film = rollout(scene, x, vol, material(len(x), *MATTER[matter]))
    return float(film.x[:, :, 2].min()) / dx - 0.25


def ball(scheme: Scheme, n: int, cfl: float) -> dict[str, float]:
    """A ball of n cells' radius, E = 1 MPa, ν = 0.3, at 1 m/s: restitution, and its approach over that of Hertz."""
    R, E, dx = 0.1, 1e6, 0.1 / n
    x, vol = block((2 * n, 2 * n, 2 * n), dx)
    inside = (x - R).norm(dim=1) < R
    x, vol = x[inside], vol[inside]
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=dx, fps=1000.0, frames=60 + 80 // n, boundaries=(HalfSpace(),), lift=2 * dx,
        velocity=(0.0, 0.0, -1.0), scheme=scheme, cfl=cfl,
    )  # fmt: skip
    states = list(simulate(scene, x, vol, material(len(x), "neo_hookean", "identity", E)))
    approach = (15 * 4 / 3 * math.pi * R**3 * RHO / (16 * math.sqrt(R) * E / (1 - 0.3**2))) ** 0.4
    center = min(float(s.x[:, 2].mean()) for s in states)
    return {"e": float(states[-1].v[:, 2].mean()), "approach": (R - center) / approach}


def slide(scheme: Scheme, angle: float, mu: float) -> float:
    """Error of the distance that a block of 5³ cells slides in half a second [%]."""
    theta, T, dx = math.radians(angle), 0.5, 0.04
    x, vol = block((5, 5, 5), dx)
    gravity = (G * math.sin(theta), 0.0, -G * math.cos(theta))
    scene = Scene(
        gravity=gravity, dx=dx, fps=20.0, frames=10, boundaries=(HalfSpace(friction=mu),), lift=None, scheme=scheme
    )
    film = rollout(scene, x, vol, material(len(x), "neo_hookean", "identity", 1e6))
    d = float((film.x[-1] - film.x[0])[:, 0].mean())
    return 100 * (d / (0.5 * G * (math.sin(theta) - mu * math.cos(theta)) * T * T) - 1)


def tables(results: dict) -> str:
    """The results as Markdown."""
    names = list(SCHEMES)
    head = "| | " + " | ".join(names) + " |\n|---|" + "--:|" * len(names)
    lines = [f"# Contact\n\n{results['machine']}; float64.\n"]
    for title, key in (("at rest for half a second", "rest"), ("lowest in a fall from 0.25 m", "bounce")):
        lines.append(f"\nLowest particle above where it belongs, {title} [Δx]:\n\n{head}")
        lines += [f"| {m} | " + " | ".join(f"{row[n]:+.2f}" for n in names) + " |" for m, row in results[key].items()]
    lines.append(f"\nA ball at 1 m/s: restitution, and approach over that of Hertz:\n\n{head}")
    for case, row in results["ball"].items():
        lines.append(f"| {case} | " + " | ".join(f"{row[n]['e']:.3f}, {row[n]['approach']:+.2f}" for n in names) + " |")
    lines.append(f"\nA block on an incline: error of the distance that it slides [%]:\n\n{head}")
    lines += [f"| {c} | " + " | ".join(f"{row[n]:+.2f}" for n in names) + " |" for c, row in results["slide"].items()]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one row of each table")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    kinds = list(MATTER)[:1] if options.quick else list(MATTER)
    balls = [(4, 0.4)] if options.quick else [(4, 0.4), (4, 0.1), (6, 0.4), (8, 0.4)]
    slopes = [(35.0, 0.3)] if options.quick else [(35.0, 0.3), (35.0, 0.0), (50.0, 0.6)]
    every = SCHEMES.items()
    results = {
        "machine": f"{platform.processor() or platform.machine()}, torch {torch.__version__}",
        "rest": {m: {n: height(m, s, 0.0, 50) for n, s in every} for m in kinds},
        "bounce": {m: {n: height(m, s, 0.25, 40) for n, s in every} for m in kinds},
        "ball": {f"R = {r} Δx, CFL {c}": {n: ball(s, r, c) for n, s in every} for r, c in balls},
        "slide": {f"{a:.0f}°, μ = {mu}": {n: slide(s, a, mu) for n, s in every} for a, mu in slopes},
    }
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "contact.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.out / "contact.md").write_text(tables(results))
    print(tables(results))


if __name__ == "__main__":
    main()
