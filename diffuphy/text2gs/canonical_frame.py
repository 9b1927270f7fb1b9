"""Do a point prior's clouds stand in the frame of the object, or in that of the camera whose picture it looked at?

The shape prior looks at another side of the object each step, and supposes the first. Nobody published an answer;
``tools/canonical_frame.py`` asks the real weights.
"""

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import torch
from torch import Tensor

from diffuphy.text2gs.shape_prior import four_sides
from diffuphy.types import Camera, Look

Frame = Literal["object", "camera", "mirrored camera", "unclear"]
SIDES = (0.0, 90.0, 180.0, 270.0)
"""Azimuths of the four views [deg]."""
HYPOTHESES: dict[Frame, tuple[float, ...]] = {
    "object": (0.0, 0.0, 0.0, 0.0),
    "camera": SIDES,
    "mirrored camera": tuple(-a for a in SIDES),
}
"""Turn about z that each view's cloud needs to lie on that of the front [deg]."""


class Sampler(Protocol):
    """A point prior that can be shown one view alone: ``losses.guidance.point_e.PointE``."""

    def sample(
        self,
        words: Look,
        camera: Camera,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
        view: int | None = None,
    ) -> tuple[Tensor, Tensor]: ...


@dataclass(frozen=True)
class Verdict:
    """What the clouds say."""

    frame: Frame
    """The hypothesis that brings them together; "unclear" if the next one does nearly as well, as for an object that
    looks the same from its sides."""
    distance: dict[str, float]
    """Mean distance between the clouds after each hypothesis' turns, over their size."""
    turns: tuple[float, ...]
    """Turn that lays each cloud best on that of the front [deg], in steps of 5°."""

    def __str__(self) -> str:
        told = ", ".join(f"{name} {value:.3f}" for name, value in self.distance.items())
        turns = ", ".join(f"{turn:.0f}°" for turn in self.turns)
        return f"clouds stand in the frame: {self.frame}\nmean distance, if it were: {told}\nbest turns: {turns}"


def turned(points: Tensor, degrees: float) -> Tensor:
    """Points (n, 3) turned about z."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ points.new_tensor([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def chamfer(a: Tensor, b: Tensor) -> float:
    """Mean distance from each point of either cloud to the nearest of the other, ½ (a → b + b → a)."""
    d = torch.cdist(a, b)
    return (d.amin(1).mean().item() + d.amin(0).mean().item()) / 2


def judge(clouds: list[Tensor], margin: float = 1.15) -> Verdict:
    """Which hypothesis lays the clouds of the four views (n, 3) on one another.

    Args:
        margin: the next best must be this many times farther, or nothing is clear. Two draws of one object differ by
            their noise, which all hypotheses share.
    """
    centred = [x - (x.amin(0) + x.amax(0)) / 2 for x in clouds]
    size = (centred[0].amax(0) - centred[0].amin(0)).max().item()

    def mean(turns: tuple[float, ...]) -> float:
        placed = [turned(x, turn) for x, turn in zip(centred, turns, strict=True)]
        pairs = [chamfer(a, b) for i, a in enumerate(placed) for b in placed[:i]]
        return sum(pairs) / len(pairs) / size

    distance = {name: mean(turns) for name, turns in HYPOTHESES.items()}
    (best, nearest), (_, second) = sorted(distance.items(), key=lambda item: item[1])[:2]
    angles = [5.0 * k for k in range(-35, 37)]
    turns = tuple(min(angles, key=lambda a, x=x: (chamfer(turned(x, a), centred[0]), abs(a))) for x in centred)
    clear = second > margin * nearest
    return Verdict(best if clear else "unclear", {str(k): v for k, v in distance.items()}, turns)


def canonical_frame(
    prior: Sampler, words: Look, generator: torch.Generator, device: torch.device | str = "cpu"
) -> Verdict:
    """Draw a cloud from each of four views alone, and register them.

    Args:
        words: an object that looks different from its four sides: an animal, a chair.
    """
    clouds = [prior.sample(words, four_sides(), generator, device, view=v)[0].cpu() for v in range(len(SIDES))]
    return judge(clouds)
