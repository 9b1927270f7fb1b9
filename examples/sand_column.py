"""A column of sand collapses: how far it runs, how steep it lies, and how wrong that is.

    python examples/sand_column.py
    python examples/sand_column.py 1500 12                 # particles of the coarse run, frames

Lube, Huppert, Sparks & Hallworth (2004) found that columns of height h < 1.7 r end at r (1 + 1.24 h/r). The same again on half the grid spacing says how much
of the distance to that the grid is; the factor 1.24 itself depends on the sand (Balmforth & Kerswell 2005).
"""

import math
import sys
from pathlib import Path

import torch

from diffuphy.material.presets import field, lookup
from diffuphy.mpm import HalfSpace, Scene, rollout
from diffuphy.render import Film, contact_sheet, write_mp4, write_png
from diffuphy.render.cloud import cloud
from diffuphy.workspace import Workspace


def column(particles: int, r: float = 0.1, h: float = 0.1) -> tuple[torch.Tensor, torch.Tensor]:
    """A lattice in a cylinder that stands on z = 0."""
    a = (math.pi * r**2 * h / particles) ** (1 / 3)
    flat, up = torch.arange(-r, r, a) + a / 2, torch.arange(0, h - a / 2, a) + a / 2
    x = torch.cartesian_prod(flat, flat, up)
    x = x[x[:, :2].norm(dim=1) < r]
    return x, torch.full((len(x),), a**3)


def collapse(particles: int, frames: int):
    x, vol = column(particles)
    scene = Scene(dx=2 * float(vol[0]) ** (1 / 3), fps=60, frames=frames, boundaries=(HalfSpace(friction=0.6),))
    motion = rollout(scene, x, vol, field(lookup("sand"), len(x)))
    reach = motion.x[-1, :, :2].norm(dim=1).quantile(0.999).item()
    return x, vol, motion, reach


def main(particles: int = 4000, frames: int = 60, out: str = "outputs/examples/sand_column") -> tuple[float, float]:
    x, vol, motion, coarse = collapse(particles, frames)
    *_, fine = collapse(8 * particles, frames)
    print(f"runs out to {coarse:.3f} m, on half the spacing {fine:.3f} m; Lube et al.: {0.1 * (1 + 1.24):.3f} m")
    sand = torch.tensor([0.76, 0.62, 0.40]) * (
        0.75 + 0.5 * torch.rand(len(x), 1, generator=torch.Generator().manual_seed(0))
    )
    clip = Film(width=256, height=192)(*cloud(x, vol, sand), motion, work=Workspace())
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    write_mp4(f"{out}.mp4", clip.rgb, clip.fps)
    write_png(f"{out}.png", contact_sheet(clip.rgb, fps=clip.fps))
    return coarse, fine


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:])
