"""What is seen of a drop: particles or pixels, from one or four sides, with noise."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import torch
from torch import Tensor

from benchmarks.identify.bodies import PROBE, SIZE, Split, bench, halves
from benchmarks.identify.specimens import Specimen
from diffuphy.learning.probe import Bench, Probe
from diffuphy.losses.takes import Take
from diffuphy.render import Skin
from diffuphy.types import Gaussians, Trajectory

What = Literal["particles", "1 camera", "4 cameras", "1 camera, noise"]
WHAT: tuple[What, ...] = ("particles", "1 camera", "4 cameras", "1 camera, noise")
CAMERA: What = "1 camera"
NOISE = 0.05
"""Standard deviation of a noisy pixel [-]: 13 grey levels of 255."""


def markers(count: int = 500) -> Gaussians:
    """Points inside a ball of radius 1, whose places are what dense observation means."""
    generator = torch.Generator().manual_seed(7)
    x = torch.randn(count, 3, generator=generator)
    x = 0.95 * x / x.norm(dim=1, keepdim=True) * torch.rand(count, 1, generator=generator) ** (1 / 3)
    none = torch.zeros(count, 0, 3)
    return Gaussians(x, torch.zeros(count, 4), torch.zeros(count, 3), torch.zeros(count), none)


@dataclass(frozen=True)
class Watch:
    """The ball on the bench, simulated with any material and looked at."""

    bench: Bench
    split: Split = "z"

    @classmethod
    def make(cls, seed: int, finer: float = 1.0, probe: Probe = PROBE, split: Split = "z") -> "Watch":
        return cls(bench(probe, seed=seed, finer=finer, split=split), split)

    @cached_property
    def labels(self) -> Tensor:
        return halves(self.bench.draft, self.split)

    @cached_property
    def marked(self) -> Skin:
        return Skin.bind(markers(), self.bench.draft, k=4)

    def drop(self, specimen: Specimen, q: Tensor, frames: int | None = None) -> Trajectory:
        """The motion of the ball with the material at some coordinates."""
        with torch.no_grad():
            return self.bench.simulate(specimen.field(self.labels, q), frames)

    def see(self, drop: Trajectory, what: What, seed: int | None = None) -> Tensor:
        """What is observed, shape (T, ...): places over the size of the ball, or pixels.

        Args:
            seed: of the noise, if what is seen has any; None leaves it out.
        """
        with torch.no_grad():
            if what == "particles":
                away = torch.tensor(self.bench.draft.offset)
                seen = torch.stack([self.marked(x, F)[0] - away for x, F in zip(drop.x[1:], drop.F[1:], strict=True)])
                return seen / SIZE
            takes = [Take.whole(len(drop.x) - 1)]
            if what == "4 cameras":
                takes = [dataclasses.replace(takes[0], azimuth=a) for a in (0.0, 90.0, 180.0, 270.0)]
            clip = torch.stack([self.bench.film(drop, take) for take in takes], 1)
            if what == "1 camera, noise" and seed is not None:
                clip = clip + NOISE * torch.randn(clip.shape, generator=torch.Generator().manual_seed(seed))
            return clip
