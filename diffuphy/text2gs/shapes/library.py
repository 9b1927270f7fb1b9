"""References for the analytic prior: pictures of a library object under the cameras that ask."""

import hashlib
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from diffuphy.text2gs.shapes.catalogue import RECIPES, find, plural
from diffuphy.text2gs.shapes.primitives import Recipe
from diffuphy.text2gs.shapes.shape import Shape, shape
from diffuphy.types import Camera, Look

CACHE_BYTES = 256 * 2**20
"""Pictures a library keeps for cameras that come back; the oldest go first. Not a setting: it changes no result."""


def _removed(recipe: Recipe, negative: str) -> frozenset[str]:
    """Parts of the object that the comma-separated words of `Look.negative` name."""
    items = {" ".join(item.lower().split()) for item in negative.split(",")}
    return frozenset(p.name for p in recipe.parts if items & {f(w) for w in (p.name, *p.words) for f in (str, plural)})


@dataclass(frozen=True)
class Library:
    """The references component of the analytic guidance: K jittered siblings of the object that the words name.

    The pictures depend on the words and the cameras alone; the seed only says, through the log-prior, which sibling is
    meant.
    """

    variants: int = 4
    """Siblings of each object (K): the first as designed, the others jittered in size and colour."""
    seed: int = 0
    """Chooses the favoured sibling, number seed mod variants."""
    aa: int = 2
    """Rays along a side of a pixel."""
    favour: float = 1e4
    """Log-prior of the favoured sibling over each other [nats]. Picture likelihoods of siblings differ by hundreds of
    nats at large noise levels, so a prior that shall decide must exceed them."""

    def __post_init__(self):
        if self.variants < 1:
            raise ValueError(f"variants must be at least 1, got {self.variants}")
        if self.aa < 1:
            raise ValueError(f"aa must be at least 1, got {self.aa}")
        if self.favour < 0:
            raise ValueError(f"favour must be at least 0 nats, got {self.favour}")

    @cached_property
    def _pictures(self) -> OrderedDict[tuple[str, bytes], Tensor]:
        """Pictures by words and camera, the longest unused first."""
        return OrderedDict()

    @property
    def names(self) -> tuple[str, ...]:
        """Canonical names of the objects."""
        return tuple(RECIPES)

    def object(self, look: Look, variant: int | None = None) -> Shape:
        """The shape that the words describe; the favoured sibling unless `variant` is given.

        Raises:
            ValueError: when the subject is unknown, the surface changes no colours or no part is left.
        """
        recipe = find(look.subject)
        variant = self.seed % self.variants if variant is None else variant
        return shape(recipe, _removed(recipe, look.negative), look.surface, variant)

    def __call__(self, look: Look, camera: Camera, background: Tensor) -> tuple[Tensor, Tensor]:
        """References (C, K, H, W, 3) over the background, and their log-prior (K,).

        Args:
            background: colour (3,), one a view (C, 3), or pictures (C, H, W, 3).
        """
        rgba = self._rgba(look, camera)
        bg = background.to(rgba)
        bg = bg[:, None, None, None] if bg.ndim == 2 else bg[:, None] if bg.ndim == 4 else bg
        logits = torch.zeros(self.variants, device=rgba.device)
        logits[self.seed % self.variants] = self.favour
        return rgba[..., :3] + (1 - rgba[..., 3:]) * bg, logits

    def _rgba(self, look: Look, camera: Camera) -> Tensor:
        """Premultiplied pictures (C, K, H, W, 4); those of cameras seen before come from the cache.

        Kept and handed out at half precision (2⁻¹¹ relative, an eighth of an 8-bit step), so that a picture is the
        same the second time.
        """
        views, Ks = camera.viewmats.detach().cpu().numpy(), camera.Ks.detach().cpu().numpy()
        words = f"{look.subject}|{look.negative}|{look.surface}|{camera.width}x{camera.height}|{camera.viewmats.device}"
        keys = [(words, hashlib.sha256(v.tobytes() + K.tobytes()).digest()) for v, K in zip(views, Ks, strict=True)]
        new = {key: i for i, key in enumerate(keys) if key not in self._pictures}
        found = {key: self._pictures[key] for key in keys if key not in new}
        if new:
            some = camera[list(new.values())]
            drawn = [
                torch.cat([rgb, a[..., None]], -1).half()
                for rgb, a in (self.object(look, v).render(some, self.aa) for v in range(self.variants))
            ]
            found |= dict(zip(new, torch.stack(drawn, 1), strict=True))
        for key in keys:
            self._pictures[key] = found[key].clone() if key in new else found[key]
            self._pictures.move_to_end(key)
        while sum(p.nbytes for p in self._pictures.values()) > CACHE_BYTES:
            self._pictures.popitem(last=False)
        return torch.stack([found[key] for key in keys]).float()
