"""Fewer needles: Gaussians of one's own made rounder while their pictures stay."""

import dataclasses
import logging
import math
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor

from diffuphy.losses.regularize import anisotropy
from diffuphy.losses.schedules import Exponential, Schedule
from diffuphy.render import Rasteriser, Warp, render_gaussians
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.params import LearningRates, Parameters
from diffuphy.types import Camera, Gaussians
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)

SETTLED = 0.5
"""Share of the steps after which no Gaussian is longer than ``ratio``: the rest are for the pictures."""


@dataclass(frozen=True)
class Rounding:
    """Fine-tunes Gaussians to the pictures that they make themselves, with a price on long ones.

        L = mean_pixels |C − C₀|² + weight · L_aniso,   C₀ the picture before, over a random background

    Xie et al., PhysGaussian (2024), section 3.6, without the photographs. Pictures hold on to single needles however
    small their share in L_aniso; so a bound comes down beside it, from the longest there is to ``ratio``, which
    shortest axes must keep (``Parameters.project``). Every Gaussian stays.
    """

    VERSION: ClassVar[int] = 1

    ratio: float = 4.0
    """r: longest over shortest axis up to which Gaussians are let alone [-]."""
    weight: float = 1e-3
    """Of the mean excess over it, beside the mean squared difference of the pictures [-]."""
    steps: int = 300
    """Optimiser steps, one picture each."""
    cameras: Orbits = field(default_factory=lambda: Orbits(bank=48, size=128, elevation=(-30.0, 75.0)))
    """Where it is looked at from."""
    rates: LearningRates = LearningRates(
        means=5e-4, quats=1e-2, log_scales=2e-2, logit_opacities=2e-2, sh=5e-3, sh_rest=2.5e-4
    )
    """Step sizes at the start: scales may change by e^±2 in all, what makes up for it much less."""
    decay: Schedule = field(default_factory=lambda: Exponential(1.0, 0.05))
    """Factor on them."""
    seed: int = 0
    """Of the order of the pictures and of their backgrounds."""
    backend: Rasteriser = field(default_factory=Warp)
    """Rasteriser."""

    def __post_init__(self) -> None:
        if self.ratio < 1.0 or self.weight < 0.0 or self.steps < 1:
            raise ValueError(
                "ratio and steps must be at least 1 and weight not negative, "
                f"got {self.ratio}, {self.steps} and {self.weight}"
            )

    def __call__(self, gaussians: Gaussians, *, work: Workspace | None = None) -> Gaussians:
        """The same object, centred, longest side 2, of rounder Gaussians."""
        work = work or Workspace()
        params, g = Parameters(gaussians), torch.Generator().manual_seed(self.seed)
        bank = self.cameras().to(gaussians.means.device)
        order, longest = torch.empty(0, dtype=torch.int64), float(ratios(gaussians).max())
        with work.bar(self.steps, "rounding") as bar:
            for step in range(self.steps):
                order = order if len(order) else torch.randperm(len(bank), generator=g)
                camera, order = bank[order[:1]], order[1:]
                background = torch.rand(3, generator=g).to(gaussians.means)
                with torch.no_grad():
                    target = self._picture(gaussians, camera, background)
                loss = (self._picture(params.gaussians(), camera, background) - target).square().mean()
                (loss + self.weight * anisotropy(params.values["log_scales"], self.ratio)).backward()
                params.step(self.rates, self.decay(step, self.steps))
                left = max(0.0, 1.0 - (step + 1) / (SETTLED * self.steps))
                params.project(max_scale=math.inf, max_ratio=self.ratio * max(1.0, longest / self.ratio) ** left)
                bar.update()
        rounder = Gaussians(**{name: value.detach() for name, value in params.values.items()})
        self._report(gaussians, rounder, work)
        return rounder

    def _picture(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Tensor:
        return render_gaussians(gaussians, camera, background=background, backend=self.backend).rgb

    @torch.no_grad()
    def _report(self, before: Gaussians, after: Gaussians, work: Workspace) -> None:
        """Ratios of axes before and after, and how far the pictures of unseen cameras changed."""
        unseen = dataclasses.replace(self.cameras, bank=12, ring=1, seed=self.cameras.seed + 1)()
        camera, white = unseen.to(before.means.device), torch.ones(3).to(before.means)
        difference = self._picture(before, camera, white) - self._picture(after, camera, white)
        psnr = float(-10 * difference.square().mean().log10())
        long = [ratios(g) for g in (before, after)]
        most = [float(r.max()) for r in long]
        above = [
            float((r > 1.001 * self.ratio).float().mean()) for r in long
        ]  # at the bound, to rounding, is not above
        work.log(0, ratio_before=most[0], ratio_after=most[1], above_before=above[0], above_after=above[1], psnr=psnr)
        log.info(
            "rounded: longest over shortest axis at most %.3g instead of %.3g, above %.3g in %.1f %% of the Gaussians "
            "instead of %.1f %%; pictures from unseen cameras keep %.1f dB",
            most[1], most[0], self.ratio, 100 * above[1], 100 * above[0], psnr,
        )  # fmt: skip


def ratios(gaussians: Gaussians) -> Tensor:
    """Longest over shortest axis of each, shape (G,)."""
    s = gaussians.log_scales
    return (s.amax(1) - s.amin(1)).exp()
