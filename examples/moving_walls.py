"""Walls that move: a drum turns with jelly in it, a plate comes down on clay. Each wall is one line.

python examples/moving_walls.py
python examples/moving_walls.py 800 12                 # particles, frames
"""

import math
import sys
from pathlib import Path

import torch

from diffuphy.material.presets import field, lookup
from diffuphy.mpm import Box, HalfSpace, Scene, rollout
from diffuphy.render import Film, contact_sheet, write_mp4, write_png
from diffuphy.render.cloud import cloud
from diffuphy.workspace import Workspace


def block(particles: int, size: float = 0.2) -> tuple[torch.Tensor, torch.Tensor]:
    a = size / round(particles ** (1 / 3))
    line = torch.arange(a / 2, size, a)
    x = torch.cartesian_prod(line - size / 2, line - size / 2, line)
    return x, torch.full((len(x),), a**3)


def main(particles: int = 4000, frames: int = 45, out: str = "outputs/examples/moving_walls") -> float:
    x, vol = block(particles)
    dx, fps = 2 * float(vol[0]) ** (1 / 3), 30.0
    down, stop = -0.12, 1.0  # the plate [m/s], and when it goes away [s]
    walls = (
        HalfSpace(friction=0.5),
        Box(
            center=(0, 0, 0.2 + 0.5 * (a := 4 * dx)), size=(0.6, 0.6, a), velocity=(0, 0, down), end=stop, friction=0.5
        ),
        HalfSpace(point=(-0.11, 0, 0), normal=(math.cos(0.3), 0, math.sin(0.3)), start=stop, velocity=(0.15, 0, 0)),
    )
    scene = Scene(dx=dx, fps=fps, frames=frames, boundaries=walls)
    motion = rollout(scene, x, vol, field(lookup("clay"), len(x)))
    pressed = motion.x[min(frames, int(stop * fps)), :, 2].max().item()
    print(f"pressed to {pressed:.3f} m, where the plate stops: {0.2 + down * stop:.3f} m")
    layers = torch.where(
        (x[:, 2] / 0.2 * 5 % 2 < 1)[:, None], torch.tensor([0.72, 0.36, 0.25]), torch.tensor([0.55, 0.26, 0.2])
    )
    clip = Film(width=256, height=192)(*cloud(x, vol, layers), motion, work=Workspace())
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    write_mp4(f"{out}.mp4", clip.rgb, clip.fps)
    write_png(f"{out}.png", contact_sheet(clip.rgb, fps=clip.fps))
    return pressed


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:])
