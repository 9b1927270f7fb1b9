"""Where the scores of one film are gathered."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch.nn.functional as F
from torch import Tensor

from diffuphy.metrics import physics, picture
from diffuphy.metrics.score import Score, estimate
from diffuphy.types import Clip, Trajectory

REFERENCE = {
    "CLIPSIM′": ("", "of the untrained network"),
    "Diff_SSIM": ("higher", "1 − SSIM to the untrained network's film"),
    "Diff_SSIM (object)": ("higher", "the same where either object is seen"),
    "Diff_CLIP": ("higher", "CLIPSIM over CLIPSIM′"),
    "FVD": ("lower", "of clips of this film and the untrained network's"),
    "KVD": ("lower", "unbiased, of the same clips"),
}
"""Scores that compare with a reference: which way is better, and what they say."""


@dataclass
class Book:
    """Scores so far, why others are missing, and curves over the film."""

    absent: dict[str, str] = field(default_factory=dict)
    scores: list[Score] = field(default_factory=list)
    curves: dict[str, Tensor] = field(default_factory=dict)

    def add(self, name: str, value: float, **told: Any) -> None:
        self.scores.append(Score(name, value, **told))

    def physics(self, trajectory: Trajectory, mass: Tensor, vol: Tensor, world: physics.World, size: float) -> None:
        """What holds for all matter: ``metrics.physics``."""
        free = physics.momentum(trajectory, mass, world) if world.closed else mass.new_empty(0)
        if len(free):
            note = f"largest in {len(free)} frames of free flight, over what gravity gives in one"
            self.add("momentum error", float(free.max()), better="lower", note=note)
        else:
            self.absent["momentum error"] = "no frame of free flight" if world.closed else OPEN
        if world.closed:
            energy = physics.energy(trajectory, mass, world, size)
            scale = "over the first kinetic energy and that of lifting the object by its size"
            self.add("energy created", max(0.0, float(energy.max())), better="lower", note=f"at most, {scale}")
            self.add("energy spent", -float(energy[-1]), note="lost, or stored as strain, at the end; the same scale")
            self.curves["energy"] = energy
        else:
            self.absent |= dict.fromkeys(("energy created", "energy spent"), OPEN)
        if world.walls:
            depth = 100 * float(physics.penetration(trajectory, world).max()) / size
            self.add("penetration", depth, better="lower", unit="%", note="of the size, into resting planes")
        else:
            self.absent["penetration"] = "no resting plane"
        ratio, inverted = physics.volume(trajectory, vol)
        self.add("volume change", 100 * float((ratio - 1).abs().max()), unit="%", note="largest, of the whole object")
        self.add("inverted", 100 * inverted, better="lower", unit="%", note="of the particles, ever: det F ≤ 0")
        self.curves["volume"] = ratio
        pace = physics.pace(trajectory, mass)
        self.add("speed at the end", float(pace[-1] / pace.max()), note="root mean square, over the largest")
        self.add("strain", float(physics.strain(trajectory, vol).max()), note="largest root mean square |FᵀF − 1|/2")
        self.curves["speed [m/s]"] = pace

    def film(self, clip: Clip, cover: Tensor) -> None:
        """Silhouettes, their motion, and colours, of frames reduced to the size of ``cover`` (T, H, W)."""
        area, middle = picture.area(cover), picture.middle(cover)
        self.add("silhouette", 100 * float(area.mean()), unit="%", note="of the picture, mean")
        travel = float((middle[1:] - middle[:-1]).norm(dim=1).nansum())
        self.add("travel", travel, note="path of the silhouette's middle, in heights of the picture")
        if len(overlap := picture.overlap(cover)):
            self.add("overlap", float(overlap[~overlap.isnan()].amin()) if overlap.isfinite().any() else math.nan,
                     note="least share that a silhouette has in common with the next")  # fmt: skip
        rgb = clip.rgb.to(cover).permute(0, 3, 1, 2)
        rgb = F.interpolate(rgb, cover.shape[1:], mode="area").permute(0, 2, 3, 1)
        seen = picture.saturation(rgb, cover)
        self.add("saturation of the film", float(seen.nanmean()), note="of the object's pixels, mean")
        self.curves |= {"silhouette": area, "saturation": seen}

    def references(self, seeds: Sequence[dict[str, float]], clips: Sequence[int] = ()) -> None:
        """Means over the reference seeds; ``clips`` is (N, D), clips and features of each set for FVD."""
        done = [s for s in seeds if s]
        for name, (better, note) in REFERENCE.items():
            values = [s[name] for s in done if name in s]
            if not values:
                self.absent.setdefault(name, "every reference film diverged")
                continue
            if name in ("FVD", "KVD"):
                n, features = clips
                rank = f", fewer than its {features} features: biased" if name == "FVD" and n <= features else ""
                note = f"{note}; N = {n}{rank}"
            told = f"{note}, {len(values)} seed{'s' * (len(values) > 1)}"
            self.scores.append(estimate(name, values, better=better, note=told))


OPEN = "something else acts: a drive, a moving wall, or a wall that is no plane"
