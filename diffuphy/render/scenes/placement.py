"""Similarities: Gaussians and cameras turned, scaled and shifted together, so that every picture stays as it was."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import torch
from torch import Tensor

from diffuphy.geometry import rotations
from diffuphy.render import sh as harmonics
from diffuphy.types import Camera, Gaussians

Axis = Literal["x", "y", "z"]


@dataclass(frozen=True)
class Placement:
    """x ↦ scale · R x + shift."""

    quat: Tensor
    """The rotation R as a unit quaternion wxyz, shape (4,), float64."""
    scale: float = 1.0
    """Target over source length [-]."""
    shift: Tensor = dataclasses.field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    """Shape (3,), float64."""

    @classmethod
    def turns(cls, turns: Sequence[tuple[Axis, float]]) -> Self:
        """Rotations about fixed axes, (axis, angle [deg]), the first one first."""
        quat = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        for axis, angle in turns:
            one = torch.zeros(4, dtype=torch.float64)
            one[0], one["xyz".index(axis) + 1] = math.cos(math.radians(angle) / 2), math.sin(math.radians(angle) / 2)
            quat = product(one, quat)
        return cls(quat)

    @property
    def R(self) -> Tensor:
        """Shape (3, 3), float64."""
        return rotations(self.quat)

    def __call__(self, g: Gaussians) -> Gaussians:
        """The Gaussians moved: centres, orientations, sizes, and the directions that their colours depend on."""
        turned = bool((self.quat[1:] != 0).any())
        move = (self.scale * self.R).mT, self.shift
        return Gaussians(
            (g.means.double() @ move[0].to(g.means.device) + move[1].to(g.means.device)).to(g.means),
            product(self.quat.to(g.quats), g.quats) if turned else g.quats,
            g.log_scales + math.log(self.scale),
            g.logit_opacities,
            harmonics.rotate(g.sh, self.R.to(g.sh)) if turned else g.sh,
        )

    def camera(self, camera: Camera) -> Camera:
        """The cameras that see the moved Gaussians as ``camera`` sees them at home.

        With c = V x + t in camera axes, s c = V Rᵀ x' + s t − V Rᵀ shift; a pinhole does not see s.
        """
        view = camera.viewmats.double().cpu()
        V = view[:, :3, :3] @ self.R.mT
        moved = view.clone()
        moved[:, :3, :3] = V
        moved[:, :3, 3] = self.scale * view[:, :3, 3] - V @ self.shift
        return dataclasses.replace(camera, viewmats=moved.to(camera.viewmats))


def product(p: Tensor, q: Tensor) -> Tensor:
    """Quaternion products p q, wxyz, of (..., 4)."""
    a, b = torch.broadcast_tensors(p, q)
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(-1, keepdim=True)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + torch.linalg.cross(a[..., 1:], b[..., 1:])
    return torch.cat([w, v], dim=-1)
