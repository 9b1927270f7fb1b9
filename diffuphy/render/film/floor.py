"""What stands around the object in the film: a studio backdrop, a floor at z = 0, and the shadow on it."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from diffuphy.types import Camera

TOP = (0.62, 0.71, 0.82)
HORIZON = (0.92, 0.93, 0.94)
FLOOR = (0.80, 0.79, 0.77)
LINE = (0.66, 0.65, 0.64)
"""Colours of the backdrop overhead and at the horizon, of the floor and of the lines on it."""

LINE_WIDTH = 0.03
"""Width of the lines on the floor, in squares."""

STATIC_SAMPLES = 3
"""Samples a side of a pixel of the backdrop, which is computed once a film: fine lines must not flicker or break."""

LAYERS = 6
"""Heights at which the shadow is evaluated; in between it is interpolated."""


def rays(camera: Camera, samples: int = 1) -> tuple[Tensor, Tensor]:
    """Eye (3,) [m] and directions (H s, W s, 3), not normalised, of the first view's rays, ``samples`` a side of a
    pixel."""
    view, K = camera.viewmats[0], camera.Ks[0].to(camera.viewmats)
    R, t = view[:3, :3], view[:3, 3]
    y, x = torch.meshgrid(
        (torch.arange(camera.height * samples).to(view) + 0.5) / samples,
        (torch.arange(camera.width * samples).to(view) + 0.5) / samples,
        indexing="ij",
    )
    d = torch.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], torch.ones_like(x)], dim=-1)
    return -(R.mT @ t), d @ R


def square(size: float) -> float:
    """Side of the floor's squares [m]: of 1, 2, 5 · 10ⁿ the one nearest below ``size``."""
    power = 10.0 ** math.floor(math.log10(size))
    return max(m * power for m in (1.0, 2.0, 5.0) if m * power <= size * (1 + 1e-9))


def pool(pixels: Tensor, samples: int) -> Tensor:
    """Mean over ``samples`` x ``samples`` blocks of (H s, W s, D)."""
    h, w, d = pixels.shape
    return pixels.reshape(h // samples, samples, w // samples, samples, d).mean(dim=(1, 3))


@dataclass(frozen=True)
class Backdrop:
    """The empty studio, seen by one camera."""

    rgb: Tensor
    """Backdrop and floor without shadow, shape (H, W, 3)."""
    ground: Tensor
    """Where the ray of each pixel meets the floor, shape (H, W, 2) [m]."""
    solid: Tensor
    """How much of the floor's own look is seen there: 1 near the object, 0 in the distance and above the horizon,
    shape (H, W)."""


def backdrop(camera: Camera, centre: Tensor, size: float, *, floor: bool = True) -> Backdrop:
    """The studio: a gradient that darkens upwards and, if ``floor``, a floor with squares that fades into the horizon.

    Args:
        centre: (2,) where the fading starts from [m].
        size: size of the scene [m]; sets the squares (1, 2 or 5 · 10ⁿ m) and the reach of the floor.
    """
    eye, d = rays(camera, STATIC_SAMPLES)
    unit = torch.nn.functional.normalize(d, dim=-1)
    # the gradient is that of the picture when there is no horizon to begin at
    up = unit[..., 2:].clamp_min(0) if floor else 0.5 * (unit[..., 2:] + 1)
    top, horizon, tile, line = (camera.viewmats.new_tensor(c) for c in (TOP, HORIZON, FLOOR, LINE))
    sky = horizon + (top - horizon) * (1 - torch.exp(-2.2 * up))
    ground, solid = (
        _ground(eye, d, centre, size) if floor else (torch.zeros_like(d[..., :2]), torch.zeros_like(d[..., :1]))
    )
    if floor:
        cell = square(size / 3)
        to_line = cell * (0.5 - (torch.remainder(ground / cell, 1) - 0.5).abs())
        on_line = (to_line.amin(-1, keepdim=True) < 0.5 * LINE_WIDTH * cell).to(sky)
        sky = sky + solid * (tile + on_line * (line - tile) - sky)
    _, centres = rays(camera)
    if floor:
        ground, _ = _ground(eye, centres, centre, size)
    else:
        ground = torch.zeros_like(centres[..., :2])
    return Backdrop(pool(sky, STATIC_SAMPLES), ground, pool(solid, STATIC_SAMPLES)[..., 0])


def _ground(eye: Tensor, d: Tensor, centre: Tensor, size: float) -> tuple[Tensor, Tensor]:
    """Meeting points (H, W, 2) of rays and floor, and the weight (H, W, 1) of the floor's look there."""
    below = d[..., 2:] < 0
    distance = torch.where(below, -eye[2] / torch.where(below, d[..., 2:], -1), 0)
    ground = eye[:2] + distance * d[..., :2]
    radius = torch.linalg.vector_norm(ground - centre, dim=-1, keepdim=True)
    return ground, below * torch.exp(-((radius / (2.5 * size)) ** 2)) * (eye[2] > 0)


@dataclass(frozen=True)
class Studio:
    """What stands behind the object of a film, for any camera in it."""

    centre: Tensor
    """Where the floor begins to fade, shape (2,) [m]."""
    size: float
    """Size of the scene [m]."""
    floor: bool = True
    background: tuple[float, float, float] | Literal["transparent"] | None = None
    """One colour, nothing at all, or, None, the backdrop and the look of the floor."""

    @classmethod
    def around(cls, points: Tensor, **settings: Any) -> "Studio":
        """The studio of a motion that goes through ``points`` (M, 3) [m]."""
        low, high = points.amin(0), points.amax(0)
        return cls(((low + high) / 2)[:2], float((high - low).amax().clamp_min(1e-6)), **settings)

    def empty(self, camera: Camera) -> Backdrop:
        """The studio without object and shadow; white where it is transparent."""
        studio = backdrop(camera, self.centre, self.size, floor=self.floor)
        if self.background is None:
            return studio
        color = (1.0, 1.0, 1.0) if self.background == "transparent" else self.background
        return Backdrop(studio.rgb.new_tensor(color).expand_as(studio.rgb), studio.ground, studio.solid)

    def behind(self, empty: Backdrop, shadow: "Shadow | None", x: Tensor) -> tuple[Tensor, Tensor | None]:
        """Picture (H, W, 3) behind the object, particles at ``x`` (N, 3) [m], and the coverage (H, W) of its shadow
        where there is nothing else: black of that coverage on white is the picture."""
        clear = self.background == "transparent"
        if shadow is None:
            return empty.rgb, torch.zeros_like(empty.solid) if clear else None
        dark = empty.solid * (1 - shadow.cast(x, empty.ground))
        return empty.rgb * (1 - dark)[..., None], dark if clear else None


@dataclass(frozen=True)
class Shadow:
    """Shadow of N particles under a wide overhead lamp: dark and sharp at the contact, pale and soft from a height.

        light(x, y) = (1 - s (1 - Π_l (1 - c_l))) (1 - ½ s c_0),   c_l = G(σ₀ + ½ h_l tan θ) * (1 - exp(-2 a_l))

    a_l is the area of the particles near height h_l over each cell of the floor, G a Gaussian blur: the penumbra of
    a lamp that is seen from the floor under the half angle θ. The second factor is the light of the room that a
    touching body keeps away.
    """

    origin: Tensor
    """Corner of the map, shape (2,) [m]."""
    cell: float
    """Side of a cell [m]."""
    cells: int
    """Cells a side."""
    heights: Tensor
    """Heights of the layers, ascending from 0, shape (LAYERS,) [m]."""
    area: Tensor
    """Cross-section of each particle, vol^⅔, shape (N,) [m²]."""
    smooth: Tensor
    """Transfer function of the blur before the exponential, by one particle spacing, shape (n, n/2 + 1)."""
    penumbra: Tensor
    """Transfer functions of the layers' blurs, shape (LAYERS, n, n/2 + 1)."""
    strength: float
    """s [-]."""

    @classmethod
    def over(cls, x: Tensor, vol: Tensor, *, strength: float = 0.5, lamp: float = 0.45, cells: int = 160) -> "Shadow":
        """A map that covers particles which go to ``x`` (T, N, 3) [m] in a film.

        Args:
            vol: rest volumes (N,) [m³].
            strength: darkness under a thick body [-].
            lamp: tan θ, half size of the lamp over its height [-].
        """
        low, high = x[..., :2].amin((0, 1)), x[..., :2].amax((0, 1))
        top = float(x[..., 2].max().clamp_min(1e-6))
        spacing = float(vol.mean()) ** (1 / 3)
        width = float((high - low).max())
        side = max(width * 1.5 + 2 * lamp * top, 8 * spacing)
        cell = max(side / cells, 0.7 * spacing)
        cells = 2 * math.ceil(0.5 * side / cell)
        origin = (low + high) / 2 - 0.5 * cell * cells
        heights = top * (torch.arange(LAYERS).to(x) / (LAYERS - 1)) ** 2  # denser where the blur changes most
        ky = torch.fft.fftfreq(cells).to(x)[:, None]
        kx = torch.fft.rfftfreq(cells).to(x)[None]
        k2 = (2 * math.pi) ** 2 * (kx**2 + ky**2)

        def blur(sigma: Tensor) -> Tensor:
            return torch.exp(-0.5 * k2 * (sigma[..., None, None] / cell) ** 2)

        smooth = blur(torch.tensor(0.6 * spacing).to(x))
        penumbra = blur(0.5 * lamp * heights + 0.5 * spacing)
        return cls(origin, cell, cells, heights, vol.to(x) ** (2 / 3), smooth, penumbra, strength)

    def light(self, x: Tensor) -> Tensor:
        """Light that reaches each cell of the floor, in (0, 1], shape (n, n), particles at ``x`` (N, 3) [m]."""
        n = self.cells
        z = x[:, 2].clamp(0, float(self.heights[-1]))
        upper = torch.searchsorted(self.heights, z.contiguous()).clamp(1, LAYERS - 1)
        share = (z - self.heights[upper - 1]) / (self.heights[upper] - self.heights[upper - 1])
        at = ((x[:, :2] - self.origin) / self.cell - 0.5).clamp(0, n - 1.001)
        corner = at.floor()
        f = at - corner
        i, j = corner.long().unbind(1)
        amount = self.area / self.cell**2
        total = x.new_zeros(LAYERS * n * n)
        for layer, w_l in ((upper - 1, 1 - share), (upper, share)):
            for a, w_x in ((0, 1 - f[:, 0]), (1, f[:, 0])):
                for b, w_y in ((0, 1 - f[:, 1]), (1, f[:, 1])):
                    total.index_add_(0, (layer * n + j + b) * n + i + a, amount * w_l * w_x * w_y)
        total = total.reshape(LAYERS, n, n)
        cover = 1 - torch.exp(-2 * torch.fft.irfft2(torch.fft.rfft2(total) * self.smooth, s=(n, n)).clamp_min(0))
        soft = torch.fft.irfft2(torch.fft.rfft2(cover) * self.penumbra, s=(n, n)).clamp(0, 1)
        shade = 1 - self.strength * (1 - torch.prod(1 - soft, dim=0))
        return shade * (1 - 0.5 * self.strength * soft[0])

    def cast(self, x: Tensor, ground: Tensor) -> Tensor:
        """Light at points ``ground`` (H, W, 2) [m] of the floor, 1 outside the map, shape (H, W)."""
        at = 2 * (ground - self.origin) / (self.cell * self.cells) - 1
        dark = 1 - self.light(x)
        sampled = torch.nn.functional.grid_sample(dark[None, None], at[None], align_corners=False, padding_mode="zeros")
        return 1 - sampled[0, 0]
