"""The visual hull: all that the silhouettes of an object leave for it."""

import math
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from diffuphy.text2gs.init import Device, cloud
from diffuphy.types import Camera, Gaussians, Look

SOLID = 0.5
"""Coverage from which a pixel is the object."""

COARSE, CELLS = 40, 64
"""Cells along a side of the box that all cameras look into, and along the longest side of the hull in it."""

VIEWS = 100
"""Most silhouettes that carve, evenly chosen."""


@dataclass(frozen=True)
class Hull:
    """Cells that every silhouette covers (Laurentini 1994: it contains the object)."""

    cells: Tensor
    """Centres, shape (n, 3)."""
    side: float
    """Of a cell."""

    @property
    def box(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest corner, shape (3,)."""
        return self.cells.amin(0) - self.side / 2, self.cells.amax(0) + self.side / 2

    def surface(self) -> Tensor:
        """Centres of the cells with a side to the outside, shape (m, 3)."""
        index = ((self.cells - self.cells.amin(0)) / self.side).round().long() + 1
        full = torch.zeros(*(index.amax(0) + 2).tolist(), dtype=torch.bool)
        full[tuple(index.T)] = True
        inner = full.clone()
        for axis in range(3):
            inner &= full.roll(1, axis) & full.roll(-1, axis)
        return self.cells[~inner[tuple(index.T)]]


def hull(coverage: Tensor, cameras: Camera) -> Hull:
    """Carve what cameras look at from all sides with the silhouettes that they see.

    Args:
        coverage: of the object in each picture, shape (C, H, W), in [0, 1].
        cameras: theirs, any frame.

    Raises:
        ValueError: nothing is covered in all pictures.
    """
    some = torch.linspace(0, len(cameras) - 1, min(VIEWS, len(cameras))).round().long()
    views, Ks = cameras.viewmats[some].double().cpu(), cameras.Ks[some].double().cpu()
    solid = (coverage[some] >= SOLID).float().cpu()
    centre, reach = focus(views, Ks, cameras.width, cameras.height)
    low, high = centre - reach, centre + reach
    found = _carved(low, high, COARSE, solid, views, Ks, whole=True)
    if len(found.cells):
        low, high = found.box
        found = _carved(low, high, CELLS, solid, views, Ks, whole=False)
    if not len(found.cells):
        raise ValueError(
            f"no point is covered in all of {len(some)} pictures: the cameras do not fit the pictures, the object is "
            "cut off in one of them, or gaussians.background is not the colour behind it"
        )
    return found


def focus(views: Tensor, Ks: Tensor, width: int, height: int) -> tuple[Tensor, float]:
    """The point nearest to all optical axes, Σ (1 − d dᵀ)(x − c) = 0, and half the side of a cube about it that holds
    all that every camera can see whole."""
    d, c = views[:, 2, :3], -(views[:, :3, :3].mT @ views[:, :3, 3:])[..., 0]
    P = torch.eye(3, dtype=d.dtype) - d[:, :, None] * d[:, None]
    x = torch.linalg.lstsq(P.sum(0), (P @ c[..., None]).sum(0)).solution[:, 0]
    tangent = torch.maximum(width / (2 * Ks[:, 0, 0]), height / (2 * Ks[:, 1, 1]))
    return x, float((tangent * (c - x).norm(dim=1)).amax())


def _carved(low: Tensor, high: Tensor, cells: int, solid: Tensor, views: Tensor, Ks: Tensor, *, whole: bool) -> Hull:
    """Cells of a grid over a box whose centres all silhouettes cover; or, ``whole``, of which they may cover a part."""
    side = float((high - low).amax()) / cells
    axes = [torch.arange(float(a) + side / 2, float(b) + side / 2, side, dtype=low.dtype)
            for a, b in zip(low, high, strict=True)]  # fmt: skip
    x = torch.cartesian_prod(*axes)
    height, width = solid.shape[1:]
    for mask, view, K in zip(solid, views, Ks, strict=True):
        seen = x @ view[:3, :3].mT + view[:3, 3]
        if whole and len(x):  # a cell reaches so far about its centre, in pixels
            nearest = float(seen[:, 2].amin().clamp_min(side))
            reach = math.ceil(0.87 * side * float(K[0, 0]) / nearest)
            mask = torch.nn.functional.max_pool2d(mask[None], 2 * reach + 1, 1, reach)[0]
        pixel = (seen @ K.mT)[:, :2] / seen[:, 2:]
        u, v = pixel.floor().clamp(-1, 2**15).long().unbind(1)
        inside = (seen[:, 2] > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        keep = inside & (mask[v.clamp(0, height - 1), u.clamp(0, width - 1)] > 0)
        x = x[keep]
    return Hull(x, side)


class HasHull(Protocol):
    """Pictures of an object."""

    @property
    def hull(self) -> Hull:
        """In the frame of the object."""
        ...


@dataclass(frozen=True)
class HullCloud:
    """Grey points on the visual hull of pictures: the start of a fit to them."""

    pictures: HasHull
    """Whose hull."""
    count: int = 3000
    """Number of Gaussians to start with."""
    opacity: float = 0.7
    """That of ``SurfaceCloud``."""

    def __post_init__(self) -> None:
        if self.count < 1 or not 0 < self.opacity < 1:
            raise ValueError(f"count must be at least 1 and opacity in (0, 1), got {self.count} and {self.opacity}")

    def __call__(
        self, look: Look, guidance: Any, generator: torch.Generator, sh_degree: int = 0, *, device: Device = "cpu"
    ) -> Gaussians:
        found = self.pictures.hull
        cells = found.surface().float()
        chosen = cells[torch.randint(len(cells), (self.count,), generator=generator)]
        points = chosen + found.side * (torch.rand(self.count, 3, generator=generator) - 0.5)
        return cloud(points, None, self.opacity, sh_degree)
