"""How much an object looks like the one that was meant."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from benchmarks._draw import SCALE, Sheet
from diffuphy.metrics.structure import psnr, ssim_object
from diffuphy.render import orbit
from diffuphy.shots import DISTANCE, ELEVATION, Turntable
from diffuphy.types import Gaussians, Look

VIEWS, SIDE = 8, 128
"""Views of the turntable, none of which a fit sees, and their side [px]; the same at every size of a table."""


@dataclass(frozen=True)
class Seen:
    """An object on white."""

    rgb: Tensor
    """Pictures (VIEWS, SIDE, SIDE, 3) in [0, 1]."""
    cover: Tensor
    """Coverage of the object, (VIEWS, SIDE, SIDE)."""


def pictures(gaussians: Gaussians, prior: Any, look: Look) -> tuple[Seen, Seen]:
    """An object, and the embedded prior's own, from the same places.

    Args:
        prior: ``prior(look, camera, background) -> (pictures (C, K, H, W, 3), log-prior (K,))``.
        look: what was meant, whatever the Gaussians were asked to be.
    """
    table = Turntable.of(gaussians, VIEWS, SIDE)
    return Seen(table.rgb, table.cover), _meant(prior, look, str(table.rgb.device))


@lru_cache(maxsize=2)
def _meant(prior: Any, look: Look, device: str) -> Seen:
    """The prior's own object; drawn once for all variants, which takes seconds."""
    camera = orbit(torch.arange(VIEWS) * (360 / VIEWS), ELEVATION, DISTANCE, width=SIDE, height=SIDE).to(device)
    over = []
    for shade in (0.0, 1.0):
        found, logits = prior(look, camera, torch.full((3,), shade, device=device))
        over.append(found[:, int(logits.argmax())])
    return Seen(over[1], 1 - (over[1] - over[0]).mean(-1))


def likeness(gaussians: Gaussians, prior: Any, look: Look) -> dict[str, float]:
    """Mean PSNR of whole pictures [dB], and SSIM where either object is seen; arguments as of ``pictures``."""
    ours, meant = pictures(gaussians, prior, look)
    alike = ssim_object(ours.rgb, meant.rgb, ours.cover, meant.cover)
    return {"psnr": float(psnr(ours.rgb, meant.rgb).mean()), "ssim": float(alike.nanmean())}


def sheet(rows: Sequence[Sequence[Tensor]], names: Sequence[str], view: int = 1) -> Image.Image:
    """One view of each object; a row for each prompt, a column for each name."""
    drawn = Sheet(SIDE * len(names), SIDE * len(rows) + 24)
    for j, name in enumerate(names):
        drawn.text(SIDE * (j + 0.5), 12, name, anchor="mm", size=10)
    for i, row in enumerate(rows):
        for j, seen in enumerate(row):
            part = Image.fromarray((seen[view].cpu() * 255).round().byte().numpy())
            side = SCALE * SIDE
            drawn.image.paste(part.resize((side, side)), (side * j, side * i + SCALE * 24))
    return drawn.image
