"""The skin: Gaussians follow the particles."""

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from diffuphy.types import Gaussians, Particles


@dataclass(frozen=True)
class Skin:
    """Moves G Gaussians with N particles: first-order motion of the k nearest particles at rest.

        x_g = Σ_k w_gk (x_k + F_k (X_g - X_k)),   F_g = Σ_k w_gk F_k

    With k = 1 a Gaussian that is carried by a particle follows that one (Xie et al., PhysGaussian, 2024, eq. 8). The
    average over several particles is linear blend skinning; it hides the steps between particles that stand for many
    Gaussians.
    """

    gaussians: Gaussians
    """The Gaussians at rest, in metres."""
    index: Tensor
    """The particles each Gaussian follows, shape (G, k), int64."""
    weight: Tensor
    """Their shares, rows sum to 1, shape (G, k)."""
    arm: Tensor
    """X_g - X_k, from particle to Gaussian at rest, shape (G, k, 3) [m]."""

    @classmethod
    def bind(cls, gaussians: Gaussians, particles: Particles, k: int = 1) -> Self:
        """Tie ``gaussians`` (object frame) to ``particles`` (metres).

        The shares fall off as exp(-d² / 2 d̄²) with the root mean square distance d̄ of the k particles.

        Raises:
            ValueError: k < 1, fewer than k particles, or a particle that carries no existing Gaussian.
        """
        if not 1 <= k <= len(particles):
            raise ValueError(f"k must be between 1 and the number of particles, {len(particles)}, got {k}")
        rest = to_metres(gaussians, particles)
        distance, index = nearest(rest.means, particles.x, k)
        if k == 1:
            index = _follow_carriers(index, particles, len(gaussians))
            weight = torch.ones_like(distance)
        else:
            spread = distance.square().mean(dim=1, keepdim=True)
            # all k particles may lie on the Gaussian itself: then they share equally
            weight = torch.softmax(-0.5 * distance.square() / spread.clamp_min(torch.finfo(distance.dtype).tiny), dim=1)
        arm = rest.means[:, None] - particles.x[index].to(rest.means)
        return cls(rest, index, weight, arm)

    def __call__(self, x: Tensor, F: Tensor) -> tuple[Tensor, Tensor]:
        """Centres (G, 3) [m] and deformations (G, 3, 3) for particles at ``x`` (N, 3) deformed by ``F`` (N, 3, 3).

        Differentiable in both.
        """
        if self.index.shape[1] == 1:
            one = self.index[:, 0]
            F_g = F[one]
            return x[one] + (F_g @ self.arm[:, 0, :, None])[..., 0], F_g
        F_k = F[self.index]
        moved = x[self.index] + (F_k @ self.arm[..., None])[..., 0]
        return (self.weight[..., None] * moved).sum(1), (self.weight[..., None, None] * F_k).sum(1)


def to_metres(gaussians: Gaussians, particles: Particles) -> Gaussians:
    """The Gaussians in the frame of the particles: x = scale · means + offset, log-scales shifted by ln(scale)."""
    if not particles.scale > 0:
        raise ValueError(f"particles.scale must be positive [m per object unit], got {particles.scale}")
    offset = gaussians.means.new_tensor(particles.offset)
    shift = gaussians.means.new_tensor(particles.scale).log()
    return replace(gaussians, means=particles.scale * gaussians.means + offset, log_scales=gaussians.log_scales + shift)


def nearest(points: Tensor, among: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Distances and indices (G, k) of the k nearest of ``among`` (N, 3), nearest first; ties go to any."""
    from scipy.spatial import KDTree

    tree = KDTree(among.detach().cpu().double().numpy())
    distance, index = tree.query(points.detach().cpu().double().numpy(), k=list(range(1, k + 1)))
    return torch.from_numpy(distance).to(points), torch.from_numpy(index).to(points.device, torch.int64)


def _follow_carriers(index: Tensor, particles: Particles, count: int) -> Tensor:
    """Replace the nearest particle by the one that carries the Gaussian, where there is one."""
    carrier = particles.gaussian >= 0
    carried = particles.gaussian[carrier].to(index.device)
    if carried.numel() and int(carried.max()) >= count:
        raise ValueError(
            f"particles carry Gaussian {int(carried.max())}, but there are only {count}; sample the particles again"
        )
    index = index.clone()
    index[carried, 0] = carrier.nonzero()[:, 0].to(index.device)
    return index
