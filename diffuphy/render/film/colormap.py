"""Numbers as colours: two maps, three scales, and the legend that says which number has which colour.

Colours between the control points are interpolated in OKLab (Ottosson 2020), where equal steps look equal.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, Self

import torch
from torch import Tensor

SEQUENTIAL = ("440154", "472d7b", "3b528b", "2c728e", "21918c", "28ae80", "5ec962", "addc30", "fde725")
"""Viridis (Smith and van der Walt 2015, CC0) at nine places: lightness rises evenly, readable in all colour
deficiencies and in grey."""

DIVERGING = ("3b4cc0", "dddddd", "b40426")
"""Cool to warm (Moreland 2009): light in the middle, equally dark at both ends."""

MAPS = {"linear": SEQUENTIAL, "log": SEQUENTIAL, "ratio": DIVERGING}
"""Map of each kind of scale, as sRGB hexadecimals."""

CATEGORIES = torch.tensor(
    [
        [0.27, 0.47, 0.67],
        [0.93, 0.40, 0.47],
        [0.80, 0.73, 0.27],
        [0.13, 0.53, 0.20],
        [0.67, 0.20, 0.47],
        [0.40, 0.80, 0.93],
    ]
)
"""Colours of things that have names, distinguishable by colour-blind readers (Tol 2021, bright)."""
CATEGORY_WORDS = ("blue", "red", "yellow", "green", "purple", "cyan")
"""Their names."""
OTHER = (0.73, 0.73, 0.73)
"""Colour of what has no colour of its own (Tol 2021, bright, grey)."""

TABLE = 256
"""Colours of a map that are computed; between them straight lines, which one cannot tell from the curve."""

ROBUST = 0.01
"""Share of the values at each end of a scale that may lie beyond it: a single particle must not dim all others."""

NARROWEST = 1.25
"""Least ratio of the ends of a logarithmic scale, a tenth of a decade: smaller differences are noise to the eye."""

_LMS = torch.tensor(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ],
    dtype=torch.float64,
)
_LAB = torch.tensor(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ],
    dtype=torch.float64,
)


def to_oklab(rgb: Tensor) -> Tensor:
    """OKLab coordinates (..., 3) of sRGB colours (..., 3) in [0, 1], float64."""
    rgb = rgb.double()
    light = torch.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    lms = light @ _LMS.mT
    return lms.sign() * lms.abs() ** (1 / 3) @ _LAB.mT


def from_oklab(lab: Tensor) -> Tensor:
    """sRGB colours (..., 3) of OKLab coordinates (..., 3), cut to [0, 1]."""
    lms = (lab.double() @ torch.linalg.inv(_LAB).mT) ** 3
    light = (lms @ torch.linalg.inv(_LMS).mT).clamp(0, 1)
    return torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055).clamp(0, 1)


@cache
def table(hexadecimals: tuple[str, ...]) -> Tensor:
    """Colours of a map, evenly spaced, shape (TABLE, 3), float32."""
    points = torch.tensor([[int(h[k : k + 2], 16) / 255 for k in (0, 2, 4)] for h in hexadecimals])
    lab = to_oklab(points)
    at = torch.linspace(0, len(lab) - 1, TABLE, dtype=torch.float64)
    low = at.long().clamp_max(len(lab) - 2)
    return from_oklab(torch.lerp(lab[low], lab[low + 1], (at - low)[:, None])).float()


def lookup(u: Tensor, hexadecimals: tuple[str, ...]) -> Tensor:
    """Colours (..., 3) of places ``u`` (...,) on a map, 0 its beginning and 1 its end."""
    colors = table(hexadecimals).to(u.device)
    at = u.float().clamp(0, 1) * (TABLE - 1)
    low = at.long().clamp_max(TABLE - 2)
    return torch.lerp(colors[low], colors[low + 1], (at - low)[..., None])


@dataclass(frozen=True)
class Scale:
    """Which number has which colour: from ``lo`` to ``hi``, linear, logarithmic, or the logarithm of a ratio with 1 in
    the middle."""

    lo: float
    """Number with the first colour of the map."""
    hi: float
    """Number with the last."""
    kind: Literal["linear", "log", "ratio"] = "linear"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lo) and math.isfinite(self.hi) and self.lo < self.hi):
            raise ValueError(f"a scale needs finite lo < hi, got {self.lo} and {self.hi}")
        if self.kind != "linear" and not self.lo > 0:
            raise ValueError(f"a {self.kind} scale needs lo > 0, got {self.lo}")

    @classmethod
    def of(cls, values: Tensor, kind: Literal["linear", "log", "ratio"] = "linear") -> Self:
        """The scale that all but a hundredth of ``values`` at each end fit on.

        linear: from 0 to the upper percentile, of values that are not negative. log: between the percentiles of the
        positive values, and wider where they are nearer than ``NARROWEST``. ratio: from 1/r to r, with r the larger of
        the two percentiles' distances from 1.
        """
        flat = values.detach().reshape(-1).double()
        flat = flat[flat > 0] if kind != "linear" else flat
        if not len(flat):
            return cls(0.0, 1.0) if kind == "linear" else cls(0.5, 2.0, kind)
        count = len(flat)
        ends = [1 + round(share * (count - 1)) for share in (ROBUST, 1 - ROBUST)]
        low, high = (float(flat.kthvalue(k).values) for k in ends)
        if kind == "linear":
            return cls(0.0, high if high > 0 else 1.0)
        if kind == "ratio":
            r = max(high, 1 / low, 1.001)
            return cls(1 / r, r, kind)
        middle, half = math.sqrt(low * high), max(math.sqrt(high / low), math.sqrt(NARROWEST))
        return cls(middle / half, middle * half, kind)

    @property
    def map(self) -> tuple[str, ...]:
        return MAPS[self.kind]

    def place(self, values: Tensor) -> Tensor:
        """Where values (...,) lie on the map, in [0, 1] from ``lo`` to ``hi`` and cut beyond."""
        if self.kind == "linear":
            return ((values - self.lo) / (self.hi - self.lo)).clamp(0, 1)
        lo, hi = math.log(self.lo), math.log(self.hi)
        return ((values.clamp(min=self.lo, max=self.hi).log() - lo) / (hi - lo)).clamp(0, 1)

    def colors(self, values: Tensor) -> Tensor:
        """Colours (..., 3) in [0, 1] of values (...,)."""
        return lookup(self.place(values), self.map)

    def ticks(self, count: int = 3) -> list[tuple[float, float]]:
        """(place on the map, number) of evenly spaced marks, ends included."""
        at = [k / (count - 1) for k in range(count)]
        if self.kind == "linear":
            return [(u, self.lo + u * (self.hi - self.lo)) for u in at]
        return [(u, self.lo ** (1 - u) * self.hi**u) for u in at]


PREFIXES = {9: "G", 6: "M", 3: "k", 0: "", -3: "m", -6: "µ"}


def power(value: float, unit: str) -> int:
    """Power of ten of the prefix that suits a number of this unit; 0 where there is no unit."""
    if not unit or value == 0:
        return 0
    return min(max(3 * math.floor(math.log10(abs(value)) / 3), min(PREFIXES)), max(PREFIXES))


def quantity(value: float, unit: str) -> str:
    """A number of three digits with its unit, ``1.25 MPa``; without prefixes where there is no unit."""
    p = power(value, unit)
    return f"{value / 10.0**p:.3g} {PREFIXES[p]}{unit}".strip()


def bar(label: str, unit: str, scale: Scale, height: int) -> Tensor:
    """The legend of a scale, rgba (h, w, 4) in [0, 1], for a film of ``height`` px: its name and unit above, numbers
    below."""
    size = font_size(height)
    width = 14 * size
    rows, at = 4 * size, torch.linspace(0, 1, width - 2 * size)
    picture, draw, font = _card(width, rows, size)
    picture.paste(_image(lookup(at, scale.map)[None].expand(size, -1, -1)), (size, int(1.5 * size)))
    p = power(scale.hi, unit)
    draw.text((size, int(0.2 * size)), f"{label} [{PREFIXES[p]}{unit or '-'}]", font=font, fill=INK)
    for k, (u, value) in enumerate(scale.ticks()):
        where = (size + u * (width - 2 * size), 2.6 * size)
        draw.text(where, f"{value / 10.0**p:.3g}", font=font, fill=INK, anchor=("la", "ma", "ra")[k])
    return _tensor(picture)


def names(entries: list[tuple[str, Tensor]], height: int) -> Tensor:
    """The legend of things with names, rgba (h, w, 4) in [0, 1]: a square and a name each.

    Args:
        entries: (name, colour (3,)).
    """
    size = font_size(height)
    probe = _card(1, 1, size)
    width = int(3 * size + max(probe[2].getlength(name) for name, _ in entries))
    picture, draw, font = _card(width, int((1.4 * len(entries) + 0.6) * size), size)
    for k, (name, color) in enumerate(entries):
        top = int((0.4 + 1.4 * k) * size)
        fill = tuple(round(255 * c) for c in color.tolist())
        draw.rectangle((size // 2, top, size // 2 + size, top + size), fill=fill)
        draw.text((2 * size, top), name, font=font, fill=INK)
    return _tensor(picture)


INK = (40, 40, 40, 255)
CARD = (255, 255, 255, 200)
"""Colours of a legend's text and of the card below it, rgba of 255."""


def font_size(height: int) -> int:
    """Letters of a film of ``height`` px: readable, and no more than a twentieth of it [px]."""
    return max(8, round(height / 28))


def lay(picture: Tensor, card: Tensor) -> Tensor:
    """Pictures (..., H, W, 3 or 4) with ``card`` (h, w, 4) in their lower left corner, cut where it does not fit.

    With a fourth channel, the coverage, the card covers too.
    """
    H, W, channels = picture.shape[-3:]
    card = card[:H, :W].to(picture)
    gap = min(6, H - card.shape[0], W - card.shape[1])
    rows = slice(H - card.shape[0] - gap, H - gap)
    columns = slice(gap, gap + card.shape[1])
    a = card[..., 3:]
    ink = torch.cat([card[..., :3], torch.ones_like(a)], dim=-1)[..., :channels]
    out = picture.clone()
    out[..., rows, columns, :] = (1 - a) * out[..., rows, columns, :] + a * ink
    return out


def _card(width: int, height: int, size: int) -> tuple[Any, Any, Any]:
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("RGBA", (width, height), CARD)
    return picture, ImageDraw.Draw(picture), ImageFont.load_default(size)


def _image(rgb: Tensor) -> Any:
    from PIL import Image

    return Image.fromarray((rgb * 255).round().to(torch.uint8).contiguous().numpy())


def _tensor(picture: Any) -> Tensor:
    import numpy as np

    return torch.from_numpy(np.array(picture)).float() / 255
