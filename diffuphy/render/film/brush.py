"""How a view becomes a picture: the colours of the Gaussians, and what the rasteriser's image is turned into."""

import dataclasses
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from diffuphy.render.film import colormap
from diffuphy.render.film.around import Scenery
from diffuphy.render.film.colormap import Scale
from diffuphy.render.film.paint import IMAGES, Moment, Painter, onto_gaussians, painter
from diffuphy.render.film.paths import boxes
from diffuphy.render.image import Image
from diffuphy.render.sh import from_rgb
from diffuphy.render.skin import Skin
from diffuphy.types import Camera, Gaussians, MaterialField, Trajectory


class Brush(Protocol):
    """Draws one view of a film."""

    def gaussians(self, now: Moment) -> Gaussians:
        """The Gaussians at rest, in the colours of this moment."""
        ...

    def picture(self, image: Image, camera: Camera) -> Tensor:
        """Premultiplied colours (H, W, 3) of the first view of ``image``."""
        ...

    def legend(self, height: int) -> Tensor | None:
        """Card for a film of ``height`` px, rgba (h, w, 4); None where there is nothing to say."""
        ...


def brush(
    view: str, skin: Skin | Scenery, cameras: Camera, trajectory: Trajectory, field: MaterialField | None
) -> Brush:
    """Who draws ``view`` (``paint.ALL``) in all frames of a film; see ``paint.painter``."""
    if view == "colour":
        return Natural(skin.gaussians)
    if view == "normals":
        return Normals(skin.gaussians)
    if view == "depth":
        return Depth(skin.gaussians, reach(cameras, trajectory))
    return Painted(skin, painter(view, trajectory, field))


def in_studio(view: str) -> bool:
    """Whether a view has floor, shadow and backdrop; pictures of depth and normals have no use for them."""
    return view not in IMAGES


def reach(cameras: Camera, trajectory: Trajectory) -> Scale:
    """Nearest and farthest place of the object along the optical axis in a whole film [m]."""
    view = cameras.viewmats.to(trajectory.x)
    z = (boxes(trajectory) * view[:, 2, :3]).sum(-1) + view[:, 2, 3]  # (8, T)
    low, high = float(z.amin()), float(z.amax())
    return Scale(low, high if high > low else low + 1.0)


@dataclass(frozen=True)
class Natural:
    """The Gaussians' own colours."""

    own: Gaussians

    def gaussians(self, now: Moment) -> Gaussians:
        return self.own

    def picture(self, image: Image, camera: Camera) -> Tensor:
        return image.rgb[0]

    def legend(self, height: int) -> Tensor | None:
        return None


@dataclass(frozen=True)
class Painted:
    """Gaussians in the colours of the particles that they follow, without light and shade: a colour is a number. What
    stands around keeps its own, those seen from the mean direction."""

    skin: Skin | Scenery
    paint: Painter

    def gaussians(self, now: Moment) -> Gaussians:
        own = self.skin.gaussians
        skin = self.skin.skin if isinstance(self.skin, Scenery) else self.skin
        painted = from_rgb(onto_gaussians(self.paint(now).to(own.sh), skin.index, skin.weight))
        return dataclasses.replace(own, sh=torch.cat([painted, own.sh[len(painted) :, :1]]))

    def picture(self, image: Image, camera: Camera) -> Tensor:
        return image.rgb[0]

    def legend(self, height: int) -> Tensor | None:
        return self.paint.legend(height)


def expected_depth(image: Image) -> Tensor:
    """Mean distance along the optical axis of what covers each pixel, Σ T α z / Σ T α, shape (H, W); 0 where nothing
    does."""
    return image.depth[0] / image.alpha[0].clamp_min(torch.finfo(image.alpha.dtype).tiny)


@dataclass(frozen=True)
class Depth:
    """Distance along the optical axis, as the rasteriser expects it."""

    own: Gaussians
    scale: Scale

    def gaussians(self, now: Moment) -> Gaussians:
        return self.own

    def picture(self, image: Image, camera: Camera) -> Tensor:
        return image.alpha[0][..., None] * self.scale.colors(expected_depth(image)).to(image.rgb)

    def legend(self, height: int) -> Tensor | None:
        return colormap.bar("distance", "m", self.scale, height)


@dataclass(frozen=True)
class Normals:
    """Normals of the surface that the expected depth is, in the axes of the camera: rgb = ½ (1 + (n_x, n_y, n_z)) with
    x right, y up, z towards the eye, so that what faces the camera is light blue.

    They are taken from depth, not from the shortest axes of Gaussians, which round ones do not have.
    """

    own: Gaussians

    def gaussians(self, now: Moment) -> Gaussians:
        return self.own

    def picture(self, image: Image, camera: Camera) -> Tensor:
        n = normals(expected_depth(image), image.alpha[0], camera)
        return image.alpha[0][..., None] * 0.5 * (1 + n * n.new_tensor([1.0, -1.0, -1.0]))

    def legend(self, height: int) -> Tensor | None:
        return None


COVERED = 0.5
"""Coverage from which a pixel shows a surface."""


def normals(depth: Tensor, alpha: Tensor, camera: Camera) -> Tensor:
    """Unit normals (H, W, 3) towards the eye, in camera axes (x right, y down, z forward), of a depth (H, W).

        n ∝ ∂_v P × ∂_u P,   P = z K⁻¹ (u, v, 1)

    Differences to the neighbours that show the surface too, on both sides where they do; a pixel without two such
    neighbours faces the eye.
    """
    K = camera.Ks[0].to(depth)
    H, W = depth.shape
    v, u = torch.meshgrid(torch.arange(H).to(depth) + 0.5, torch.arange(W).to(depth) + 0.5, indexing="ij")
    P = depth[..., None] * torch.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], torch.ones_like(u)], -1)
    seen = (alpha >= COVERED).to(depth)[..., None]
    du, dv = _slope(P, seen, 1), _slope(P, seen, 0)
    n = torch.linalg.cross(dv, du)
    length = torch.linalg.vector_norm(n, dim=-1, keepdim=True)
    towards = n.new_tensor([0.0, 0.0, -1.0])
    return torch.where(length > 0, n / length.clamp_min(torch.finfo(n.dtype).tiny), towards)


def _slope(P: Tensor, seen: Tensor, axis: int) -> Tensor:
    """Sum of the differences of ``P`` to its next and from its last neighbour along ``axis``, of those that are
    seen; twice the derivative where both are, which a direction does not mind."""
    n = P.shape[axis]
    step = P.narrow(axis, 1, n - 1) - P.narrow(axis, 0, n - 1)
    step = step * seen.narrow(axis, 1, n - 1) * seen.narrow(axis, 0, n - 1)
    none = torch.zeros_like(P.narrow(axis, 0, 1))
    return torch.cat([step, none], axis) + torch.cat([none, step], axis)
