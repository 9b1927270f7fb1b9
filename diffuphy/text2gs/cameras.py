"""Where the cameras stand while an object is made."""

import math
from dataclasses import dataclass

import torch

from diffuphy.render import orbit
from diffuphy.types import Camera

GOLDEN_ANGLE = 180 * (3 - math.sqrt(5))
"""Azimuth between neighbours of a Fibonacci lattice [deg]: no two cameras of any size of bank line up."""


@dataclass(frozen=True)
class Orbits:
    """A finite bank of cameras that look at the origin, spread evenly over a zone of a sphere.

    sin(elevation) is stratified (equal areas), azimuth follows the golden angle, both jittered by the seed. The bank is
    finite so that a prior may remember what it has worked out for each camera. With ``ring`` = n the same is done with
    rings of n cameras, 360°/n apart at one elevation, which are always drawn together.
    """

    bank: int = 48
    """Number of cameras. Twice as many cost twice the references and gain 0.05 dB; half as many lose 1.0 dB."""
    size: int = 96
    """Side of the picture [px]."""
    elevation: tuple[float, float] = (-15.0, 75.0)
    """Range of elevation above the horizon [deg]."""
    fov: float = 40.0
    """Field of view, horizontal and vertical [deg]."""
    distance: float = 3.4
    """From camera to origin [object units]; at 40° a ball of radius 1.16 fills the picture."""
    ring: int = 1
    """Cameras of a ring; 4 for a prior that judges four sides together, 1: every camera stands alone."""
    seed: int = 11
    """Of the jitter; another seed gives cameras that this one never saw."""

    def __post_init__(self) -> None:
        lo, hi = self.elevation
        if not -90 < lo <= hi < 90:
            raise ValueError(f"elevation must be an increasing range inside (-90, 90) degrees, got {self.elevation}")
        if self.bank < 1 or self.size < 8:
            raise ValueError(f"bank must be at least 1 and size at least 8 px, got {self.bank} and {self.size}")
        if self.ring < 1 or self.bank % self.ring:
            raise ValueError(f"bank must be a multiple of ring ≥ 1, got {self.bank} and {self.ring}")
        if not 0 < self.fov < 180 or self.distance <= 0:
            raise ValueError(
                f"fov must be in (0, 180) degrees and distance positive, got {self.fov} and {self.distance}"
            )

    @property
    def pixel(self) -> float:
        """Side of a pixel at the origin [object units]."""
        return 2.0 * self.distance * math.tan(math.radians(self.fov) / 2) / self.size

    def __call__(self) -> Camera:
        """The bank, C = ``bank`` cameras, ring after ring."""
        rings = self.bank // self.ring
        g = torch.Generator().manual_seed(self.seed)
        u = torch.rand(rings, 2, generator=g, dtype=torch.float64)
        k = torch.arange(rings, dtype=torch.float64)
        lo, hi = (math.sin(math.radians(e)) for e in self.elevation)
        elevation = torch.asin(lo + (hi - lo) * (k + u[:, 0]) / rings).rad2deg()
        start = 360 * torch.rand((), generator=g, dtype=torch.float64)
        first = start + GOLDEN_ANGLE * k + 360 / rings * (u[:, 1] - 0.5)
        azimuth = first[:, None] + 360 / self.ring * torch.arange(self.ring, dtype=torch.float64)
        elevation = elevation.repeat_interleave(self.ring)
        return orbit(azimuth.flatten() % 360, elevation, self.distance, fov=self.fov, width=self.size, height=self.size)
