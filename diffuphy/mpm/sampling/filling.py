"""Which empty cells inside a shell are matter: two ways to decide, and none."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import torch
from torch import Tensor

from diffuphy.mpm.sampling.fill import Lattice, column, outside

Direction = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
DIRECTIONS: tuple[Direction, ...] = ("+x", "-x", "+y", "-y", "+z", "-z")

MOST_CELLS = 2**26
"""Cells of a lattice of ``Rays``: 64 million are 0.5 GB a field of float64, a minute of work."""

Field = Callable[[Lattice], Tensor]
"""The density of the Gaussians at the centres of a lattice's cells, shape of the lattice."""


class Filling(Protocol):
    """Decides what is enclosed."""

    def margin(self, size: float, h: float) -> int:
        """Empty cells of side ``h`` that it needs around an object of longest side ``size`` [m]."""
        ...

    def __call__(self, lattice: Lattice, dense: Tensor, field: Field, size: float) -> Tensor:
        """Cells of ``lattice`` that are matter although they are not ``dense``: a mask of its shape.

        Args:
            size: longest side of the object [m].
        """
        ...


@dataclass(frozen=True)
class Flood:
    """All that the outside cannot reach; needs no tuning.

    The outside comes in from the faces of the lattice. Holes are closed in their middle, crevices stay open
    (``fill.outside``). Time and memory are bounded by the lattice, whose cells the number of particles bounds.
    """

    seal: float = 0.1
    """Holes in a shell up to this share of the longest side are closed [-]: cameras never see every part of a body,
    and a mug is open much wider."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.seal < 1.0:
            raise ValueError(f"seal must be in [0, 1), a share of the longest side, got {self.seal}")

    def margin(self, size: float, h: float) -> int:
        return self._seal(size, h) + 4

    def _seal(self, size: float, h: float) -> int:
        return math.ceil(0.5 * self.seal * size / h)

    def __call__(self, lattice: Lattice, dense: Tensor, field: Field, size: float) -> Tensor:
        return ~(dense | outside(dense, self._seal(size, lattice.h)))


@dataclass(frozen=True)
class Rays:
    """Cells from which rays say "inside", as in PhysGaussian (Xie et al. 2024, section 3.5).

    An empty cell is filled when (1) rays along the axes all meet density above ``threshold``, and (2) one more ray
    enters such density an odd number of times. Both need thresholds and directions that fit the scene: a shell whose
    underside was never seen wants "-z" in ``exclude``. ``Flood`` needs neither.
    """

    threshold: float = 0.5
    """Density that stops a ray [-]; theirs is called search_threshold."""
    exclude: tuple[Direction, ...] = ()
    """Directions whose rays need not meet anything (condition 1)."""
    parity: Direction | None = "+z"
    """The ray of condition 2; None leaves it out."""
    n_grid: int | None = None
    """Cells along the longest side of ``box``, in which rays are followed; None: those of the particles."""
    box: tuple[float, float, float, float, float, float] | None = None
    """[xmin, xmax, ymin, ymax, zmin, zmax] about the middle of the object [m]: only what lies in it is filled. None is
    everything."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "exclude", tuple(self.exclude))
        if any(d not in DIRECTIONS for d in (*self.exclude, self.parity or "+x")):
            raise ValueError(f"directions are {', '.join(DIRECTIONS)}, got {self.exclude} and {self.parity}")
        if not self.threshold >= 0.0 or (self.n_grid is not None and self.n_grid < 1):
            raise ValueError(
                f"threshold must not be negative and n_grid at least 1, got {self.threshold} and {self.n_grid}"
            )
        if self.box is not None:
            object.__setattr__(self, "box", tuple(map(float, self.box)))
            if len(self.box) != 6 or not all(a < b for a, b in zip(self.box[::2], self.box[1::2], strict=True)):
                raise ValueError(f"box must be [xmin, xmax, ymin, ymax, zmin, zmax] with min < max, got {self.box}")

    def margin(self, size: float, h: float) -> int:
        return 4

    def __call__(self, lattice: Lattice, dense: Tensor, field: Field, size: float) -> Tensor:
        own = self._lattice(lattice)
        within = self.inside(field(own) > self.threshold)
        cells = torch.cartesian_prod(*map(torch.arange, lattice.shape))
        found = own.cell(lattice.center(cells))
        there = ((found >= 0) & (found < torch.tensor(own.shape))).all(1)
        filled = torch.zeros(len(cells), dtype=torch.bool)
        filled[there] = within.view(-1)[own.flat(found[there])]
        return filled.view(lattice.shape) & ~dense

    def inside(self, wall: Tensor) -> Tensor:
        """Cells outside the mask ``wall`` for which both conditions hold."""
        ok = ~wall
        for d in DIRECTIONS:
            axis, sign = "xyz".index(d[1]), 1 if d[0] == "+" else -1
            if d not in self.exclude:
                ok = ok & (column(wall, axis, sign) > 0)
            if d == self.parity:
                ok = ok & (column(wall, axis, sign) % 2 == 1)
        return ok

    def _lattice(self, given: Lattice) -> Lattice:
        if self.n_grid is None and self.box is None:
            return given
        low, high = given.low, given.low + given.h * torch.tensor(given.shape, dtype=torch.float64)
        if self.box is not None:
            low, high = torch.tensor(self.box[::2]).double(), torch.tensor(self.box[1::2]).double()
        h = float((high - low).amax()) / self.n_grid if self.n_grid else given.h
        shape = ((high - low) / h - 1e-9).ceil().long().clamp_min(1).tolist()
        if math.prod(shape) > MOST_CELLS:
            raise ValueError(
                f"filling.n_grid = {self.n_grid} makes {math.prod(shape)} cells, more than {MOST_CELLS}; lower it"
            )
        return Lattice(low, h, tuple(shape))
