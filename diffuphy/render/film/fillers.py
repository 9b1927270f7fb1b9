"""The inside of a body: Gaussians of the particles that carry none, drawn where the body has opened."""

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from diffuphy.geometry import volume_ratio
from diffuphy.render.sh import polar
from diffuphy.render.skin import Skin, nearest
from diffuphy.types import Gaussians, Particles

ALIKE = 8
"""Gaussians from which a filler takes its opacity and colour."""

BONDS = 12
"""Neighbours at rest that cover a filler: those of a densely packed ball."""

PARTED = 1.0
"""How far a neighbour must be from where the filler's own deformation would have it, to be gone [particle spacings]."""


@dataclass(frozen=True)
class Fillers:
    """Gaussians of interior particles.

    They inherit opacity and colour from the nearest Gaussians, weighted by 1/d², and are balls of the particle's
    volume, covariance r² 1 with r = (3 V / 4π)^{1/3} (Xie et al., PhysGaussian, 2024, section 3.5). A filler is hidden
    as long as its neighbours at rest move with it, and drawn once one has gone:

        exposed_p = max_k |x_k − x_p − F_p (X_k − X_p)| > PARTED · spacing

    At rest, and in any affine motion, none is drawn: the picture is that of the Gaussians alone, to the last bit. Of
    the deformation of matter that has come apart a drawn filler keeps volume and rotation, J^{1/3} polar(F): it is no
    patch of a surface, and sheared ones stick out as hairs.
    """

    first: int
    """Where their Gaussians begin among those of the skin; they are in the order of ``index``."""
    index: Tensor
    """Their particles, shape (M,), int64."""
    bonds: Tensor
    """Particles next to each at rest, shape (M, K), int64."""
    arm: Tensor
    """X_k − X_p, from a filler to its neighbours at rest, shape (M, K, 3) [m]."""
    reach: float
    """Distance from which a neighbour is gone [m]."""

    def exposed(self, x: Tensor, F: Tensor) -> Tensor:
        """Which are drawn, shape (M,): for particles at ``x`` (N, 3) deformed by ``F`` (N, 3, 3)."""
        apart = x[self.bonds] - x[self.index, None] - (F[self.index, None] @ self.arm[..., None])[..., 0]
        return (apart.square().sum(-1) > self.reach**2).any(1)

    def drawn(
        self, gaussians: Gaussians, means: Tensor, F_g: Tensor, x: Tensor, F: Tensor, Fe: Tensor | None = None
    ) -> tuple[Gaussians, Tensor, Tensor]:
        """``gaussians`` at rest, their centres (G, 3) [m] and deformations (G, 3, 3), without the hidden fillers.

        Args:
            x, F: of the particles, (N, 3) [m] and (N, 3, 3). Fe: elastic part of F; None where nothing flows.
        """
        shown = self.exposed(x, F)
        keep = torch.ones(len(means), dtype=torch.bool, device=means.device)
        keep[self.first : self.first + len(shown)] = shown
        if bool(shown.any()):
            at = self.first + shown.nonzero()[:, 0]
            F_g = F_g.clone()
            own = self.index[shown]
            J = volume_ratio(F[own], None if Fe is None else Fe[own]).to(F_g)
            F_g[at] = J.abs()[:, None, None] ** (1 / 3) * polar(F_g[at])
        return (
            Gaussians(**{f.name: getattr(gaussians, f.name)[keep] for f in fields(Gaussians)}),
            means[keep],
            F_g[keep],
        )


def with_fillers(skin: Skin, particles: Particles) -> tuple[Skin, Fillers | None]:
    """``skin`` with the Gaussians of the particles that carry none behind its own; the same and None where nothing is
    filled."""
    rest = skin.gaussians
    index = (particles.gaussian < 0).nonzero()[:, 0].to(rest.means.device)
    if not len(index):
        return skin, None
    x = particles.x.to(rest.means)
    distance, of = nearest(x[index], rest.means, min(ALIKE, len(rest)))
    weight = 1 / (distance**2).clamp_min((1e-3 * particles.spacing) ** 2)
    weight = weight / weight.sum(1, keepdim=True)
    opacity = (weight * rest.logit_opacities[of].sigmoid()).sum(1)
    radius = (3 * particles.vol.to(rest.means)[index] / (4 * math.pi)) ** (1 / 3)
    quats = torch.zeros_like(rest.quats[:1]).expand(len(index), 4).clone()
    quats[:, 0] = 1
    sh = (weight[..., None, None] * rest.sh[of]).sum(1)
    balls = Gaussians(x[index], quats, radius.log()[:, None].expand(-1, 3), opacity.logit(eps=1e-6), sh)
    joined = Gaussians(
        **{f.name: torch.cat([getattr(rest, f.name), getattr(balls, f.name)]) for f in fields(Gaussians)}
    )
    k = skin.index.shape[1]
    whole = torch.zeros(len(index), k).to(skin.weight)
    whole[:, 0] = 1  # a filler follows its own particle, which lies in its centre
    follows = Skin(
        joined,
        torch.cat([skin.index, index[:, None].expand(-1, k)]),
        torch.cat([skin.weight, whole]),
        torch.cat([skin.arm, torch.zeros(len(index), k, 3).to(skin.arm)]),
    )
    bonds = nearest(x[index], x, min(BONDS + 1, len(x)))[1][:, 1:]  # the nearest is the filler itself
    return follows, Fillers(len(rest), index, bonds, x[bonds] - x[index, None], PARTED * particles.spacing)
