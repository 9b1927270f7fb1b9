"""Walls that move: a pin rolls over dough. A wall is one line; the film shows it too.

    python examples/moving_walls.py                                  # 6000 particles, 1.3 s at 30 frames a second
    python examples/moving_walls.py --particles 500 --frames 12

Writes moving_walls.mp4 and .png into --out and prints how thick the dough is where the pin has been.
38 seconds of one core.
"""

import argparse
import dataclasses
import math
from pathlib import Path

import numpy as np
import torch

from diffuphy.material.presets import field, lookup
from diffuphy.mpm import Cylinder, HalfSpace, Scene, rollout
from diffuphy.render import Film, contact_sheet, write_mp4, write_png
from diffuphy.render.cloud import cloud
from diffuphy.render.film.rigs import Resting
from diffuphy.types import Trajectory
from diffuphy.workspace import Workspace

LENGTH, DEPTH, HEIGHT = 0.30, 0.20, 0.10
"""Of the dough [m]."""
GAP, RADIUS, SPEED = 0.05, 0.07, 0.5
"""Under the pin [m], its radius [m], and how fast it goes [m/s]."""


def lattice(*sides: float, spacing: float) -> torch.Tensor:
    """Points in a box that stands on z = 0 about the z axis."""
    line = [(torch.arange(max(1, round(s / spacing))) + 0.5) * spacing for s in sides]
    return torch.cartesian_prod(line[0] - sides[0] / 2, line[1] - sides[1] / 2, line[2])


def with_pin(motion: Trajectory, pin: Cylinder, spacing: float) -> tuple[Trajectory, torch.Tensor, torch.Tensor]:
    """The motion with the pin as further particles; their places at first and their colours."""
    line = torch.arange(-RADIUS, RADIUS + spacing, spacing / 2)
    along = torch.arange(-pin.height / 2, pin.height / 2 + spacing, spacing / 2)
    skin = torch.cartesian_prod(line, along, line)
    r = skin[:, ::2].norm(dim=1)
    rim = (RADIUS - r).abs() < spacing / 3
    cap = (r < RADIUS) & (skin[:, 1].abs() > along[-1] - spacing / 3)
    skin, r = skin[rim | cap], r[rim | cap]
    angle = torch.atan2(skin[:, 2], skin[:, 0]) % (math.pi / 2)
    wood = torch.where((angle < 0.35)[:, None], torch.tensor([0.45, 0.27, 0.13]), torch.tensor([0.80, 0.60, 0.36]))
    pose = pin.pose(torch.arange(len(motion.x)).double().numpy() / motion.fps)
    turn, place = torch.from_numpy(pose.rotation).float(), torch.from_numpy(pose.place).float()
    x = torch.einsum("tij,nj->tni", turn, skin) + place[:, None]
    F = turn[:, None].expand(-1, len(skin), 3, 3)
    joined = dataclasses.replace(
        motion,
        x=torch.cat([motion.x, x], 1),
        v=torch.cat([motion.v, torch.zeros_like(x)], 1),
        F=torch.cat([motion.F, F], 1),
    )
    return joined, x[0], wood


def main(particles: int = 6000, frames: int = 40, out: str = "outputs/examples") -> float:
    a = (LENGTH * DEPTH * HEIGHT / particles) ** (1 / 3)
    x = lattice(LENGTH, DEPTH, HEIGHT, spacing=a)
    vol = torch.full((len(x),), a**3)
    pin = Cylinder(
        center=(-0.26, 0, GAP + RADIUS), axis=(0, 1, 0), radius=RADIUS, height=0.4,
        velocity=(SPEED, 0, 0), angular_velocity=(0, SPEED / RADIUS, 0), friction=0.5,
    )  # fmt: skip
    scene = Scene(dx=2 * a, fps=30, frames=frames, boundaries=(HalfSpace(friction=0.8), pin))
    motion = rollout(scene, x, vol, field(lookup("playdoh"), len(x)))
    end, now = motion.x[-1], pin.pose(np.array([frames / scene.fps])).place[0, 0]
    thick = end[end[:, 0] < now - RADIUS, 2].quantile(0.98).item() + a / 2
    print(f"{thick * 100:.1f} cm thick behind the pin, which leaves {GAP * 100:.1f} cm; {HEIGHT * 100:.1f} cm before")
    stripes = torch.where(
        ((x[:, 0] / 0.05).floor() % 2 == 0)[:, None], torch.tensor([0.93, 0.45, 0.42]), torch.tensor([0.96, 0.83, 0.55])
    )
    shown, pin_x, wood = with_pin(motion, pin, a)
    rgb = torch.cat([stripes, wood])
    actors = cloud(torch.cat([x, pin_x]), torch.full((len(rgb),), a**3), rgb)
    film = Film(width=360, height=360, camera=Resting(azimuth=-72.0, elevation=20.0))
    clip = film(*actors, shown, work=Workspace())
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    write_mp4(folder / "moving_walls.mp4", clip.rgb, clip.fps)
    write_png(folder / "moving_walls.png", contact_sheet(clip.rgb, fps=clip.fps))
    return thick


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=6000)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--out", default="outputs/examples")
    main(**vars(parser.parse_args()))
