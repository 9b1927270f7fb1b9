"""Checks that any film of matter must pass: momentum, energy, walls, volume, from positions and velocities alone."""

from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.geometry import volume_ratio
from diffuphy.types import Trajectory


@dataclass(frozen=True)
class World:
    """What acts on a body, as far as the checks need it."""

    gravity: tuple[float, float, float]
    """Acceleration [m/s²]."""
    walls: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
    """Resting planes, (point [m], unit normal out of the wall)."""
    reach: float
    """How far from a wall a particle already feels it [m]: a cell and a half of the grid."""
    closed: bool
    """Nothing else acts: no drive, no moving wall, no wall of another shape."""


def height(x: Tensor, world: World) -> Tensor:
    """Distance from the nearest wall, negative inside it, (..., 3) → (...) [m]; ∞ without walls."""
    far = torch.full_like(x[..., 0], torch.inf)
    for point, normal in world.walls:
        far = torch.minimum(far, (x - x.new_tensor(point)) @ x.new_tensor(normal))
    return far


def momentum(trajectory: Trajectory, mass: Tensor, world: World) -> Tensor:
    """Error of the momentum in each frame of free flight, over that which gravity gives in a frame, shape (n,), n ≥ 0.

        |Σ m Δv − Σ m g Δt| / (Σ m |g| Δt)

    A frame is free if no particle is within reach of a wall at its start or end, or would be at a constant velocity.

    Args:
        mass: of the particles, (N,) [kg].
    """
    x, v, dt = trajectory.x.double(), trajectory.v.double(), 1 / trajectory.fps
    share = (mass / mass.sum()).double()
    low = height(x, world).amin(1)
    ahead = height(x + v * dt, world).amin(1)
    free = (torch.minimum(torch.minimum(low[:-1], ahead[:-1]), low[1:]) > world.reach).nonzero()[:, 0]
    g = x.new_tensor(world.gravity)
    velocity = torch.einsum("n,tnd->td", share, v)
    return ((velocity[1:] - velocity[:-1] - g * dt).norm(dim=1) / (g.norm() * dt))[free]


def energy(trajectory: Trajectory, mass: Tensor, world: World, size: float) -> Tensor:
    """Kinetic and potential energy of each frame less that of the first, over a scale, shape (T,).

        (E(t) − E(0)) / (K(0) + M |g| size),   E = Σ m |v|²/2 − Σ m g·x

    A body that begins unstrained among resting walls can never be above 0: what is missing is stored in it or lost.

    Args:
        mass: (N,) [kg].
        size: longest side of the object [m]; lifting it by as much is the scale.
    """
    v, x = trajectory.v.double(), trajectory.x.double()
    share = (mass / mass.sum()).double()
    g = x.new_tensor(world.gravity)
    kinetic = torch.stack([(share * f.square().sum(-1)).sum() / 2 for f in v])
    total = kinetic - torch.einsum("n,tnd->td", share, x) @ g
    return (total - total[0]) / (kinetic[0] + g.norm() * size)


def penetration(trajectory: Trajectory, world: World) -> Tensor:
    """Depth of the deepest particle behind a wall, shape (T,) [m]; 0 if none is."""
    return torch.stack([(-height(f, world)).amax().clamp_min(0) for f in trajectory.x])


def volume(trajectory: Trajectory, vol: Tensor) -> tuple[Tensor, float]:
    """Volume over that of the first frame, shape (T,), and the share of particles that are ever inverted, J ≤ 0, by
    ``geometry.volume_ratio``.

    Args:
        vol: rest volumes, (N,) [m³].
    """
    elastic = [None] * len(trajectory.F) if trajectory.Fe is None else trajectory.Fe
    J = torch.stack([volume_ratio(F, Fe) for F, Fe in zip(trajectory.F, elastic, strict=True)])  # (T, N)
    share = (vol / vol.sum()).double()
    total = J @ share
    return total / total[0], float((J <= 0).any(0).double().mean())


def pace(trajectory: Trajectory, mass: Tensor) -> Tensor:
    """Root mean square speed of each frame, shape (T,) [m/s]."""
    share = (mass / mass.sum()).to(trajectory.v)
    return torch.stack([(share * f.square().sum(-1)).sum().sqrt() for f in trajectory.v])


def strain(trajectory: Trajectory, vol: Tensor) -> Tensor:
    """Root mean square Green strain |FᵀF − I|/2 of each frame, shape (T,)."""
    share = (vol / vol.sum()).double()
    eye = torch.eye(3, dtype=torch.float64, device=vol.device)
    frames = (F.double() for F in trajectory.F)
    return torch.stack([(share * ((F.mT @ F - eye) / 2).square().sum((1, 2))).sum().sqrt() for F in frames])
