"""The body on the bench, and the clips that it is identified from."""

import dataclasses
import math
from typing import Literal

import torch
from torch import Tensor

from diffuphy.learning.probe import Bench, Probe
from diffuphy.losses.takes import Take
from diffuphy.mpm import Scheme
from diffuphy.render import Skin
from diffuphy.render.sh import from_rgb
from diffuphy.types import Camera, Gaussians, Particles

SIZE = 0.3
"""Diameter of the ball [m]: the probe's speed is meant for this size."""
COLORS = torch.tensor([[[0.85, 0.30, 0.20], [0.95, 0.75, 0.30]], [[0.20, 0.35, 0.75], [0.60, 0.80, 0.95]]])
"""Two shades for one half and two for the other."""
PROBE = Probe(frames=8, scheme=Scheme(contact="elastic"))
"""The product's drop, one impact and the rise after it."""
GRAINS = dataclasses.replace(PROBE, scheme=Scheme(contact="elastic", sharpen=False, retain=0.0), view=60.0)
"""The same for grains: what is sharpened and retained is noise there, which works against the flow; and a heap runs out
of a picture of 40°."""
Reference = Literal["same", "fine"]
Split = Literal["z", "x"]
"""Axis from one half of the ball to the other: the upper half on the lower one, or two beside each other as the camera
sees them."""
AXES = {"x": 0, "z": 2}


def skin_of_ball(count: int = 3000, split: Split = "z") -> Gaussians:
    """Gaussians on the surface of a ball of radius 1, evenly spread (a Fibonacci lattice), chequered so that turning
    and stretching are seen; the halves in different colours."""
    i = torch.arange(count, dtype=torch.float64) + 0.5
    z, turn = 1 - 2 * i / count, math.pi * (1 + math.sqrt(5)) * i
    r = (1 - z * z).sqrt()
    means = torch.stack([r * turn.cos(), r * turn.sin(), z], 1).float()
    dark = ((3 * torch.atan2(means[:, 1], means[:, 0])).sin() * (4 * means[:, 2]).sin() > 0).long()
    return Gaussians(
        means,
        torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        torch.full((count, 3), math.log(0.7 * math.sqrt(4 * math.pi / count))),
        torch.full((count,), 4.0),
        from_rgb(COLORS[(means[:, AXES[split]] > 0).long(), dark]),
    )


def ball(n: int, seed: int) -> Particles:
    """About n particles of a ball: a jittered lattice whose phase is the seed's, with the volume of the ball."""
    generator = torch.Generator().manual_seed(seed)
    radius, volume = SIZE / 2, math.pi / 6 * SIZE**3
    h = (volume / n) ** (1 / 3)
    k = torch.arange(-math.ceil(radius / h) - 1, math.ceil(radius / h) + 2, dtype=torch.float64)
    phase = torch.rand(3, generator=generator, dtype=torch.float64)
    x = h * (torch.cartesian_prod(k, k, k) + phase)
    x = x[x.norm(dim=1) < radius]
    x = x + 0.25 * h * (2 * torch.rand(x.shape, generator=generator, dtype=torch.float64) - 1)
    each = torch.full((len(x),), volume / len(x))
    none = torch.full((len(x),), -1)
    return Particles(x.float(), each, none, radius, (0.0, 0.0, 0.0), (volume / len(x)) ** (1 / 3))


def bench(probe: Probe, *, seed: int, finer: float = 1.0, split: Split = "z") -> Bench:
    """The probe's experiment on the ball.

    Args:
        seed: of the particles, and of where on the grid the ball comes down.
        finer: Δx and the Courant number are divided by it, the number of particles multiplied by its cube.
        split: where the colours of the skin change.
    """
    body, gaussians = ball(round(probe.particles * finer**3), seed), skin_of_ball(split=split)
    dx = body.spacing * probe.particles_per_cell ** (1 / 3)
    # the floor lies on a plane of nodes, so the phase of the grid is where the ball is
    phase = dx * torch.rand(2, generator=torch.Generator().manual_seed(seed + 1000)).double()
    up = torch.tensor([float(phase[0]), float(phase[1]), (0.5 + probe.gap) * SIZE])
    scene = dataclasses.replace(probe.scene(dx, SIZE), lift=None, cfl=probe.cfl / finer)
    camera = probe.camera(body, SIZE)
    body = dataclasses.replace(body, x=body.x + up, offset=tuple(up.tolist()))
    return Placed(probe, scene, body, Skin.bind(gaussians, body, k=probe.skin), camera, SIZE)


class Placed(Bench):
    """A bench whose body may be anywhere over the floor: cameras and their axis of turning go with it."""

    def camera_of(self, take: Take) -> Camera:
        camera = super().camera_of(take)
        back = torch.eye(4)
        back[:2, 3] = -torch.tensor(self.draft.offset[:2])
        return dataclasses.replace(camera, viewmats=camera.viewmats @ back)


def halves(draft: Particles, split: Split = "z") -> Tensor:
    """Region of each particle, 1 for the half towards which the axis points, shape (N,)."""
    return (draft.x[:, AXES[split]] > draft.offset[AXES[split]]).long()
