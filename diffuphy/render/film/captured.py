"""The places where pictures of a captured scene were taken."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Self

import torch
from torch import Tensor

from diffuphy.geometry import rotations
from diffuphy.render.scenes.capture import cameras_file
from diffuphy.render.scenes.placement import Placement
from diffuphy.types import Camera, Particles, Trajectory


@dataclass(frozen=True)
class Captured:
    """Stands where a picture of the captured scene was taken, or travels through several such places.

    The picture shows all that the captured one shows; where its sides have another ratio, it shows more.
    """

    scene: Any
    """Who knows the cameras of the scene in the object's frame: ``cameras() -> tuple of Camera``, and its
    ``floor()`` (``text2gs.load.LoadGaussians``)."""
    path: str = field(metadata={"content": cameras_file})
    """The scene's folder or its cameras.json; the film depends on what it holds."""
    views: tuple[int, ...] = (0,)
    """Which cameras, by their number in cameras.json, -1 the last. One rests; several are passed through, in equal
    times, on straight lines and the shortest turns."""
    degrees: float = 0.0
    """Turned about the vertical through the object by so much, from +x towards +y [deg]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(self.views))
        if not self.views:
            raise ValueError("camera.views is empty; name cameras of cameras.json by their number, the first is 0")

    def turned(self, degrees: float) -> Self:
        return dataclasses.replace(self, degrees=self.degrees + degrees)

    def __call__(self, trajectory: Trajectory, particles: Particles, *, width: int, height: int, floor: bool) -> Camera:
        x = trajectory.x
        found = self.scene.cameras()
        for view in self.views:
            if not -len(found) <= view < len(found):
                raise ValueError(f"camera.views has {view}, but {self.path} has cameras 0 to {len(found) - 1}")
        chosen = [resized(found[view], width, height) for view in self.views]
        place = standing(particles, self.scene.floor())
        chosen = [Placement.turns([("z", self.degrees)]).camera(place.camera(c)) for c in chosen]
        view, K = (torch.cat([getattr(c, name).double() for c in chosen]) for name in ("viewmats", "Ks"))
        if len(chosen) > 1:
            view, K = travelled(view, K, len(x))
        return Camera(view.to(x), K.to(x), width, height)


def standing(particles: Particles, ground: float | None = None) -> Placement:
    """From the object's frame to metres, as what stands around it is placed: the lowest particle at rest at z = 0, or
    the scene's own ground, at a height in the object's frame."""
    shift = torch.tensor(particles.offset, dtype=torch.float64)
    shift[2] = -particles.scale * ground if ground is not None else shift[2] - float(particles.x[:, 2].amin())
    return Placement(torch.tensor([1.0, 0, 0, 0], dtype=torch.float64), float(particles.scale), shift)


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The camera with a picture of another size, in which the whole of its own is seen."""
    share = min(width / camera.width, height / camera.height)
    K = camera.Ks.double().clone()
    K[:, :2, :2] *= share
    K[:, 0, 2] = width / 2 + share * (camera.Ks[:, 0, 2] - camera.width / 2)
    K[:, 1, 2] = height / 2 + share * (camera.Ks[:, 1, 2] - camera.height / 2)
    return Camera(camera.viewmats, K, width, height)


def travelled(view: Tensor, K: Tensor, frames: int) -> tuple[Tensor, Tensor]:
    """``frames`` cameras from the first of ``view`` (n, 4, 4) through all others to the last, in equal times.

    Centres and intrinsics go on straight lines; orientations by R(s) = exp(s log(R_b R_aᵀ)) R_a.
    """
    at = torch.linspace(0, len(view) - 1, frames, dtype=view.dtype)
    a = at.long().clamp_max(len(view) - 2)
    s = (at - a)[:, None]
    R, centre = view[:, :3, :3], -(view[:, :3, :3].mT @ view[:, :3, 3:])[..., 0]
    turn = s * _axis_angle(R[a + 1] @ R[a].mT)
    half = torch.linalg.vector_norm(turn, dim=1, keepdim=True) / 2
    quat = torch.cat([half.cos(), turn / 2 * torch.sinc(half / math.pi)], dim=1)
    out = torch.eye(4, dtype=view.dtype).repeat(frames, 1, 1)
    out[:, :3, :3] = rotations(quat) @ R[a]
    out[:, :3, 3] = -(out[:, :3, :3] @ torch.lerp(centre[a], centre[a + 1], s)[..., None])[..., 0]
    return out, torch.lerp(K[a], K[a + 1], s[..., None])


def _axis_angle(R: Tensor) -> Tensor:
    """Axis times angle (n, 3) [rad], angle in [0, π], of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return torch.from_numpy(Rotation.from_matrix(R.numpy()).as_rotvec())
