"""What one step of video score distillation looks at: which frames of the motion, from where, on what."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor


@dataclass(frozen=True)
class Take:
    """One clip to film."""

    frames: tuple[int, ...]
    """Numbers of its frames, increasing; 0 is the initial state, which no clip shows."""
    azimuth: float = 0.0
    """Turn of the experiment's camera about the vertical axis through the object [deg]."""
    background: tuple[float, float, float] | None = None
    """Colour behind the object; None is the experiment's."""
    blur: float = 0.0
    """Standard deviation of the low-pass it is seen through, as a share of the picture's height [-]; 0 is sharp."""

    @classmethod
    def whole(cls, frames: int) -> "Take":
        """Frames 1 … ``frames``, as the experiment films them."""
        return cls(tuple(range(1, frames + 1)))


@dataclass(frozen=True)
class Takes:
    """Chooses the take of each step. Only the frames it chooses are drawn, and what comes after them is not simulated.

    Settings of others, by their published code: DreamPhysics and Physics3D take 16 frames of every 9th, from a start
    that moves on with the iteration (``strided``, 16, 9); OmniPhysGS takes 20 in a row, one such stage after the other
    (``consecutive``, 20); PhysDreamer compares all of 14 and lets their number grow (``all``, with
    ``material.curriculum``). All film with one fixed camera, those with a video prior on white. Here the gradient runs
    through the whole motion up to a frame, whichever frames are shown; theirs is cut at the last substep, at the stage,
    and nowhere.
    """

    frames: Literal["all", "consecutive", "strided", "window"] = "all"
    """Frames of a step: all of the clip; a block of them in a row, another block each step; every ``stride``-th, the
    start moving on by one each step; a block from a random start. All: short clips are cheap, and the frames of the
    impact, which say most, are in every step."""
    count: int = 16
    """Most frames of a block or of a strided take: what ModelScope was trained on."""
    stride: int = 2
    """Frames from one to the next of a strided take."""
    views: int = 1
    """Cameras round the object, evenly spaced, of which each step draws one; 1 is always the experiment's own."""
    background: Literal["own", "white", "random"] = "own"
    """Behind the object: the experiment's colour, white, or another colour each step."""

    def __post_init__(self) -> None:
        if self.frames not in ("all", "consecutive", "strided", "window"):
            raise ValueError(f"frames must be all, consecutive, strided or window, got {self.frames!r}")
        if self.background not in ("own", "white", "random"):
            raise ValueError(f"background must be own, white or random, got {self.background!r}")
        if self.count < 1 or self.stride < 1 or self.views < 1:
            raise ValueError(
                f"count, stride and views must be at least 1, got {self.count}, {self.stride} and {self.views}"
            )

    def __call__(self, step: int, total: int, generator: torch.Generator) -> Take:
        """The take of a step, out of a motion of ``total`` frames after the initial state.

        Args:
            generator: of what is drawn; the defaults draw nothing.
        """
        return Take(self._frames(step, total, generator), self._azimuth(generator), self._background(generator))

    def shown(self, total: int) -> int:
        """Most frames of a take out of a motion of ``total`` frames."""
        if self.frames == "all":
            return total
        return min(self.count, -(-total // self.stride) if self.frames == "strided" else total)

    def _frames(self, step: int, total: int, generator: torch.Generator) -> tuple[int, ...]:
        if self.frames == "all":
            return tuple(range(1, total + 1))
        if self.frames == "strided":
            first = 1 + step % min(self.stride, total)
            return tuple(range(first, total + 1, self.stride))[: self.count]
        n = min(self.count, total)
        if self.frames == "consecutive":
            first = 1 + min(step % -(-total // n) * n, total - n)  # the last block is as long as the others
        else:
            first = 1 + int(torch.randint(0, total - n + 1, (), generator=generator, device=generator.device))
        return tuple(range(first, first + n))

    def _azimuth(self, generator: torch.Generator) -> float:
        if self.views == 1:
            return 0.0
        drawn = torch.randint(0, self.views, (), generator=generator, device=generator.device)
        return 360.0 / self.views * int(drawn)

    def _background(self, generator: torch.Generator) -> tuple[float, float, float] | None:
        if self.background == "own":
            return None
        if self.background == "white":
            return (1.0, 1.0, 1.0)
        r, g, b = torch.rand(3, generator=generator, device=generator.device).tolist()
        return (r, g, b)


def low_pass(picture: Tensor, background: Tensor, sigma: float) -> Tensor:
    """The picture through a Gaussian of standard deviation σ, in front of an endless background.

        b + g_σ ∗ (picture − b),   g_σ(r) ∝ exp(−r²/2σ²),  |r| ≤ 3 σ along each axis

    Sharp pictures of bodies that do not overlap differ by their areas, wherever they are; blurred by about the distance
    they differ by it (coarse to fine: Lucas & Kanade 1981; Bergen et al. 1992).

    Args:
        picture: shape (H, W, 3). background: b, shape (3,).
        sigma: σ > 0 [px].
    """
    reach = math.ceil(3 * sigma)
    r = torch.arange(-reach, reach + 1, dtype=picture.dtype, device=picture.device)
    g = torch.exp(-0.5 * (r / sigma) ** 2)
    g = (g / g.sum()).expand(3, 1, 1, -1)
    seen = (picture - background).permute(2, 0, 1)[None]
    seen = torch.nn.functional.conv2d(seen, g, padding=(0, reach), groups=3)
    seen = torch.nn.functional.conv2d(seen, g.mT, padding=(reach, 0), groups=3)
    return background + seen[0].permute(1, 2, 0)
