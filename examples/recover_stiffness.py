"""A gradient through a whole simulation: how stiff is a ball that was seen to bounce?

    python examples/recover_stiffness.py
    python examples/recover_stiffness.py --particles 300 --steps 6

Newton's method on log E with the derivative of the trajectory from the adjoint: no finite differences, no network.
10 seconds of one core.
"""

import argparse
import dataclasses
import math

import torch

from diffuphy.material.presets import field, lookup
from diffuphy.mpm import HalfSpace, Scene, rollout


def ball(particles: int, radius: float = 0.15) -> tuple[torch.Tensor, torch.Tensor]:
    """Points on a lattice inside a sphere that touches z = 0, and the volume of each."""
    h = (4 / 3 * math.pi * radius**3 / particles) ** (1 / 3)
    line = torch.arange(-radius, radius, h) + h / 2
    x = torch.cartesian_prod(line, line, line)
    x = x[x.norm(dim=1) < radius]
    return x + torch.tensor([0.0, 0.0, radius]), torch.full((len(x),), h**3)


def main(particles: int = 1000, steps: int = 8) -> tuple[float, list[float]]:
    x, vol = ball(particles)
    scene = Scene(
        dx=2 * float(vol[0]) ** (1 / 3), fps=60, frames=24, velocity=(0, 0, -1.5), lift=0.02, boundaries=(HalfSpace(),)
    )
    rubber = field(lookup("rubber"), len(x))

    def height(log_E: torch.Tensor) -> torch.Tensor:
        """Of the centre of mass at each frame [m]."""
        matter = dataclasses.replace(rubber, theta=rubber.theta | {"E": (10**log_E).expand(len(x))})
        return rollout(scene, x, vol, matter, grad=log_E.requires_grad).x[:, :, 2].mean(1)

    truth = 5.3
    seen = height(torch.tensor(truth))
    log_E, path = torch.tensor(4.6, requires_grad=True), []
    for step in range(steps):
        off = height(log_E) - seen
        loss = (off**2).mean()
        (slope,) = torch.autograd.grad(loss, log_E)
        with torch.no_grad():
            log_E -= (2 * loss / slope).clamp(-0.3, 0.3) if slope != 0 else 0.0  # the least that a square can have is 0
        path.append(log_E.item())
        print(f"step {step + 1}: E = {10 ** path[-1]:.4g} Pa, off by {off.abs().max().item() * 1e3:.2f} mm")
    print(f"truth: E = {10**truth:.4g} Pa")
    return truth, path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=8)
    main(**vars(parser.parse_args()))
