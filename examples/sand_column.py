"""A column of sand collapses: how far it runs, how steep it lies, and how wrong both are.

    python examples/sand_column.py                                   # 2500 particles, and eight times as many
    python examples/sand_column.py --particles 150 --frames 20

Lube, Huppert, Sparks & Hallworth (2004) found that columns of height h < 1.7 r end at r (1 + 1.24 h/r); the factor
depends on the sand (Balmforth & Kerswell 2005). What is left of the grid in both numbers is read off the coarse run:
with an error of first order the difference to half the spacing is that of the finer run. Writes sand_column.mp4 and
.png, the finer run, into --out. 74 seconds of one core.
"""

import argparse
import math
from pathlib import Path

import torch

from diffuphy.material.presets import field, lookup
from diffuphy.mpm import HalfSpace, Scene, rollout
from diffuphy.render import Film, contact_sheet, write_mp4, write_png
from diffuphy.render.cloud import cloud
from diffuphy.render.film.rigs import Resting
from diffuphy.types import Trajectory
from diffuphy.workspace import Workspace

RADIUS, HEIGHT = 0.1, 0.15
"""Of the column [m]."""


def column(particles: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A lattice in a cylinder that stands on z = 0, and the volume of each point."""
    a = (math.pi * RADIUS**2 * HEIGHT / particles) ** (1 / 3)
    flat, up = torch.arange(-RADIUS, RADIUS, a) + a / 2, torch.arange(0, HEIGHT - a / 2, a) + a / 2
    x = torch.cartesian_prod(flat, flat, up)
    x = x[x[:, :2].norm(dim=1) < RADIUS]
    return x, torch.full((len(x),), a**3)


def collapse(particles: int, frames: int) -> tuple[torch.Tensor, torch.Tensor, Trajectory]:
    x, vol = column(particles)
    scene = Scene(dx=2 * float(vol[0]) ** (1 / 3), fps=60, frames=frames, boundaries=(HalfSpace(friction=0.7),))
    return x, vol, rollout(scene, x, vol, field(lookup("sand"), len(x)))


def heap(x: torch.Tensor) -> tuple[float, float]:
    """How far a heap reaches [m] and how steep its surface is [deg]: a line through the tops of eight rings between
    a quarter and nine tenths of the reach."""
    r = x[:, :2].norm(dim=1)
    reach = r.quantile(0.999).item()
    ring = ((r / reach - 0.25) / 0.65 * 8).floor().long()
    tops = torch.stack([x[ring == k, 2].quantile(0.98) for k in range(8)])
    at = (0.25 + 0.65 * (torch.arange(8) + 0.5) / 8) * reach
    slope = ((at - at.mean()) * (tops - tops.mean())).sum() / (at - at.mean()).square().sum()
    return reach, math.degrees(math.atan(-slope.item()))


def main(particles: int = 2500, frames: int = 45, out: str = "outputs/examples") -> tuple[tuple[float, float], ...]:
    coarse = heap(collapse(particles, frames)[-1].x[-1])
    x, vol, motion = collapse(8 * particles, frames)
    fine = heap(motion.x[-1])
    print(f"runs out to {fine[0]:.3f} ± {abs(fine[0] - coarse[0]):.3f} m; Lube et al. {RADIUS + 1.24 * HEIGHT:.3f} m")
    inner = lookup("sand").friction_angle
    print(f"lies at {fine[1]:.0f} ± {abs(fine[1] - coarse[1]):.0f} degrees; its friction angle is {inner:.0f}")
    layers = torch.tensor(
        [[0.87, 0.73, 0.50], [0.70, 0.35, 0.22], [0.95, 0.87, 0.70], [0.45, 0.27, 0.22], [0.85, 0.55, 0.28]]
    )
    grain = 0.85 + 0.3 * torch.rand(len(x), 1, generator=torch.Generator().manual_seed(0))
    tint = (layers[(x[:, 2] / HEIGHT * 5).long().clamp(0, 4)] * grain).clamp(0, 1)
    film = Film(width=360, height=360, camera=Resting(elevation=20.0), slow=2.0)
    clip = film(*cloud(x, vol, tint), motion, work=Workspace())
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    write_mp4(folder / "sand_column.mp4", clip.rgb, clip.fps / clip.slow)
    write_png(folder / "sand_column.png", contact_sheet(clip.rgb, fps=clip.fps))
    return coarse, fine


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=45)
    parser.add_argument("--out", default="outputs/examples")
    main(**vars(parser.parse_args()))
