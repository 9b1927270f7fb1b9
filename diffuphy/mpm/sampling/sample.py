"""From Gaussians to particles: what is opaque and hangs together becomes matter of known volume, one particle a
lattice cell."""

import logging
import math
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from diffuphy.mpm.sampling.fill import Lattice, density, grow, pieces
from diffuphy.mpm.sampling.filling import Filling, Flood
from diffuphy.types import Gaussians, Motion, Particles
from diffuphy.workspace import Workspace

logger = logging.getLogger(__name__)

BAND_LIMIT = 0.3
"""Variance that pictures of Gaussians have beside that of the Gaussians [px²]: the dilation of all rasterisers since
Kerbl et al. (2023)."""


@dataclass(frozen=True)
class _Solid:
    """The lattice cells that are matter."""

    lattice: Lattice
    cells: Tensor
    """Cells, shape (N, 3), int64."""
    interior: Tensor
    """True where the cell was enclosed and not dense itself, shape (N,)."""


@dataclass(frozen=True)
class Sample:
    """Particles of an object.

    The opaque Gaussians are scaled to metres; a lattice of ``per_cell`` cells a grid cell is laid over them; cells in
    which their density exceeds ``threshold`` are matter, and so are the cells that they enclose (``filling``).
    Each such cell becomes one particle: at the most opaque Gaussian in it, or at a jittered point, with the volume of
    the cell. Cells are judged by their centres, so the volumes add up to that of the body within the surface d =
    threshold, which lies one to two standard deviations outside the outermost centres.

    Pictures add ``BAND_LIMIT`` pixels squared to the variance of every Gaussian, and Gaussians that were fitted to
    pictures are too thin by as much; it is given back to them before they are judged.
    """

    VERSION = 2

    cells: int = 28
    """Grid cells along the longest side; the grid spacing that goes with the particles is their spacing ·
    per_cell^⅓."""
    per_cell: int = 8
    """Particles a grid cell: 8 is two along each axis, the usual compromise between noise and cost."""
    opacity: float = 0.3
    """Gaussians below this opacity are not matter [-]."""
    threshold: float = 0.5
    """Density from which a cell is matter [-]: about where half of the light is stopped. One value for all objects:
    the volumes of the library are right to 4 % with it (``docs/benchmarks/filling.md``)."""
    pixel: float | None = None
    """Side of a pixel, at the object, of the pictures that the Gaussians were fitted to [object units]; 0 takes them as
    they are. None: that of the fit in the same run, 0 for given ones."""
    stray: float = 0.01
    """Connected pieces with less than this share of the opaque Gaussians are dropped [-]."""
    filling: Filling | None = field(default_factory=Flood)
    """Decides which enclosed cells become solid: ``Flood``, ``Rays`` as in PhysGaussian; None leaves shells hollow."""
    jitter: float = 0.5
    """Range of the random shift of filler particles [lattice cells]; breaks the pattern of a lattice on a grid."""
    max_particles: int = 12_000
    """Most particles; 12 000 film two seconds in a minute or two on one core."""
    when_full: Literal["coarsen", "error"] = "coarsen"
    """Whether more of them make the lattice coarser or are an error."""
    seed: int = 0
    """Seed of the jitter."""

    def __post_init__(self) -> None:
        positive = {
            "cells": self.cells,
            "per_cell": self.per_cell,
            "max_particles": self.max_particles,
            "threshold": self.threshold,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}")
        for name, share in {"opacity": self.opacity, "stray": self.stray, "jitter": self.jitter}.items():
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name} must be in [0, 1], got {share}")
        if self.when_full not in ("coarsen", "error"):
            raise ValueError(f"when_full must be 'coarsen' or 'error', got {self.when_full!r}")
        if not 0.0 <= (self.pixel or 0.0) < math.inf:
            raise ValueError(f"pixel must be a length of at least 0, got {self.pixel}; None is that of the fit")

    def __call__(self, gaussians: Gaussians, motion: Motion, *, work: Workspace) -> Particles:
        """Particles of an object whose longest opaque side is ``motion.size`` metres.

        Raises:
            ValueError: no opaque Gaussian, an object without extent, or too many particles.
        """
        if not 0.0 < motion.size < math.inf:
            raise ValueError(f"motion.size must be positive and finite, got {motion.size} m")
        g = gaussians.to("cpu")
        opaque = torch.sigmoid(g.logit_opacities.double())
        keep = self._without_strays(g, opaque, self._opaque(g, opaque))
        scale, offset = self._placement(g, keep, motion.size)
        x = scale * g.means.double() + offset
        solid = self._solid(g, x, opaque, keep, scale, motion.size)
        points, carried = self._points(solid, x, opaque, keep)
        filled, n, h = int(solid.interior.sum()), len(points), solid.lattice.h
        dropped = len(g) - int(keep.sum())
        work.log(0, particles=n, filled=filled, carried=int((carried >= 0).sum()), dropped=dropped, volume=n * h**3)
        logger.info(
            "%d particles %.2g m apart, %d of them enclosed; %.3g m³; %d of %d Gaussians left out",
            n,
            h,
            filled,
            n * h**3,
            dropped,
            len(g),
        )
        if self.filling is not None and not filled:
            logger.info("interior fill left out: nothing hollow")
        device = gaussians.means.device
        vol = torch.full((n,), h**3, dtype=torch.float32, device=device)
        return Particles(points.to(device, torch.float32), vol, carried.to(device), scale, tuple(offset.tolist()), h)

    def _opaque(self, g: Gaussians, opaque: Tensor) -> Tensor:
        finite = torch.isfinite(g.means).all(1) & torch.isfinite(g.log_scales).all(1) & torch.isfinite(g.quats).all(1)
        keep = finite & (opaque >= self.opacity)
        if not bool(keep.any()):
            most = float(opaque.max()) if len(g) else 0.0
            raise ValueError(
                f"none of {len(g)} Gaussians has an opacity of at least {self.opacity} (the largest is {most:.3g}); "
                "lower Sample.opacity or fit longer"
            )
        return keep

    def _placement(self, g: Gaussians, keep: Tensor, size: float) -> tuple[float, Tensor]:
        """Metres per object unit, and the shift that puts the middle of the opaque box at the origin [m]."""
        low, high = g.means[keep].double().amin(0), g.means[keep].double().amax(0)
        longest = float((high - low).max())
        if not longest > 0.0:
            raise ValueError(
                f"the {int(keep.sum())} opaque Gaussians lie in one point {low.tolist()}: an object needs an extent; "
                "fit it again"
            )
        scale = size / longest
        return scale, -scale * (low + high) / 2

    def _without_strays(self, g: Gaussians, opaque: Tensor, keep: Tensor) -> Tensor:
        """Drop small pieces that touch nothing, until none is left; a far one makes the first lattice coarse, hence
        the repetition."""
        for _ in range(8):
            scale, offset = self._placement(g, keep, 1.0)
            x = scale * g.means[keep].double() + offset
            lattice = Lattice.around(x, 1.0 / self.cells, margin=2)
            home = lattice.flat(lattice.cell(x))
            occupied = torch.zeros(lattice.shape, dtype=torch.bool)
            occupied.view(-1)[home] = True
            piece = pieces(grow(occupied)).view(-1)[home]
            names, which, count = piece.unique(return_inverse=True, return_counts=True)
            small = count < self.stray * len(piece)
            if not bool(small.any()) or len(names) == 1:
                return keep
            keep = keep.clone()
            keep[keep.nonzero()[:, 0][small[which]]] = False
        return keep

    def _solid(self, g: Gaussians, x: Tensor, opaque: Tensor, keep: Tensor, scale: float, size: float) -> _Solid:
        """Matter on a lattice that is coarse enough."""
        h = size / self.cells / self.per_cell ** (1 / 3)
        for _ in range(12):
            margin = self.filling.margin(size, h) if self.filling is not None else 4
            solid = self._matter(Lattice.around(x[keep], h, margin), g, x, opaque, keep, scale, size)
            if len(solid.cells) <= self.max_particles:
                return solid
            if self.when_full == "error":
                raise ValueError(
                    f"the object takes {len(solid.cells)} particles {h:.3g} m apart, more than {self.max_particles}; "
                    "raise max_particles, "
                    "lower cells or per_cell, or set when_full='coarsen'"
                )
            h *= 1.02 * (len(solid.cells) / self.max_particles) ** (1 / 3)
        raise ValueError(f"no lattice makes {self.max_particles} particles of this object; raise max_particles")

    def _matter(
        self, lattice: Lattice, g: Gaussians, x: Tensor, opaque: Tensor, keep: Tensor, scale: float, size: float
    ) -> _Solid:
        """Dense cells, those in which a Gaussian has its centre, and those that they enclose."""
        blur = BAND_LIMIT * (self.pixel or 0.0) ** 2
        scales = scale * (g.log_scales[keep].double().mul(2).exp() + blur).sqrt()

        def field(lattice: Lattice) -> Tensor:
            return density(lattice, x[keep], g.quats[keep], scales, opaque[keep])

        dense = field(lattice) >= self.threshold
        home = lattice.cell(x[keep])
        dense[home[:, 0], home[:, 1], home[:, 2]] = True
        matter = dense
        if self.filling is not None:
            matter = dense | self.filling(lattice, dense, field, size)
        cells = matter.nonzero()
        i, j, k = cells.unbind(1)
        return _Solid(lattice, cells, ~dense[i, j, k])

    def _points(self, solid: _Solid, x: Tensor, opaque: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        """Position of each particle, and the Gaussian it carries or −1."""
        generator = torch.Generator().manual_seed(self.seed)
        shift = (torch.rand(solid.cells.shape, generator=generator, dtype=torch.float64) - 0.5) * self.jitter
        points = solid.lattice.center(solid.cells) + solid.lattice.h * shift
        at = torch.full((math.prod(solid.lattice.shape),), -1)
        at[solid.lattice.flat(solid.cells)] = torch.arange(len(solid.cells))
        index = keep.nonzero()[:, 0]
        index = index[torch.argsort(opaque[index], stable=True)]  # the last one written to a cell is the most opaque
        carried = torch.full((len(solid.cells),), -1)
        for_cell = at[solid.lattice.flat(solid.lattice.cell(x[index]))]
        order = torch.arange(len(index))
        last = torch.full((len(solid.cells),), -1).scatter_reduce(0, for_cell, order, "amax")
        has = last >= 0
        carried[has] = index[last[has]]
        points[has] = x[carried[has]]
        return points, carried
