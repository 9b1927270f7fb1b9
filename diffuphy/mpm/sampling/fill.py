"""A cloud of Gaussians as a solid on a lattice: density, connected pieces, and what is enclosed.

Everything is a fixed number of array operations a sweep, and every sweep that repeats stops when nothing changes,
after at most as many repetitions as there are cells. The same input gives the same answer to the last bit.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.geometry import rotations

REACH = 3.0
"""Standard deviations after which a Gaussian is cut off: e^(−9/2) = 1 % of its peak."""

MAX_RADIUS = 6
"""Most lattice cells that a Gaussian reaches in one direction; larger ones, mostly faults of a fit, are cut there."""

CHUNK = 2**21
"""Gaussian–cell pairs evaluated at once."""


@dataclass(frozen=True)
class Lattice:
    """Cubic cells of side ``h``; cell (i, j, k) spans low + h (i … i+1, j … j+1, k … k+1)."""

    low: Tensor
    """Lowest corner, shape (3,), float64 [m]."""
    h: float
    """Side of a cell [m]."""
    shape: tuple[int, int, int]
    """Cells along each axis."""

    @classmethod
    def around(cls, x: Tensor, h: float, margin: int) -> "Lattice":
        """The lattice that holds the points ``x`` (N, 3) and ``margin`` empty cells on every side; the points' box
        lies in its middle."""
        low, high = x.amin(0).double(), x.amax(0).double()
        cells = ((high - low) / h).floor().long() + 1
        corner = (low + high) / 2 - h * cells / 2 - margin * h
        return cls(corner, h, tuple((cells + 2 * margin).tolist()))

    def cell(self, x: Tensor) -> Tensor:
        """Cell of each point, shape (N, 3), int64."""
        return ((x.double() - self.low) / self.h).floor().long()

    def flat(self, cell: Tensor) -> Tensor:
        """Cells as numbers, row-major."""
        return (cell[..., 0] * self.shape[1] + cell[..., 1]) * self.shape[2] + cell[..., 2]

    def center(self, cell: Tensor) -> Tensor:
        """Centres of cells [m], float64."""
        return self.low + self.h * (cell.double() + 0.5)


def density(lattice: Lattice, x: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor) -> Tensor:
    """d(x) = Σ_g σ_g exp(−½ (x − x_g)ᵀ Σ_g⁻¹ (x − x_g)) at the cell centres, shape of the lattice, float64.

    Principal variances of Σ_g below h²/12, that of a point somewhere in a cell, are raised to it: smaller ones would
    fall between the centres.

    Args:
        x: centres (G, 3) [m]. quats: (G, 4). scales: standard deviations (G, 3) [m]. opacities: (G,) in [0, 1].
    """
    h = lattice.h
    var = (scales.double() ** 2).clamp_min(h * h / 12)
    R = rotations(quats.double())
    inverse = R @ torch.diag_embed(1 / var) @ R.mT
    radius = (REACH * var.amax(1).sqrt() / h).ceil().clamp(1, MAX_RADIUS).long()
    home, shape = lattice.cell(x), torch.tensor(lattice.shape)
    out = torch.zeros(lattice.shape[0] * lattice.shape[1] * lattice.shape[2], dtype=torch.float64)
    for r in range(1, MAX_RADIUS + 1):
        a = torch.arange(-r, r + 1)
        offsets = torch.cartesian_prod(a, a, a)
        for g in (radius == r).nonzero()[:, 0].split(max(1, CHUNK // len(offsets))):
            cells = home[g, None] + offsets
            d = lattice.center(cells) - x[g, None].double()
            value = opacities[g, None].double() * torch.exp(-0.5 * ((d @ inverse[g]) * d).sum(-1))
            here = ((cells >= 0) & (cells < shape)).all(-1)
            out.index_add_(0, lattice.flat(cells)[here], value[here])
    return out.reshape(lattice.shape)


def grow(mask: Tensor, steps: int = 1) -> Tensor:
    """The mask and its neighbours across faces, ``steps`` times."""
    for _ in range(steps):
        out = mask.clone()
        out[1:] |= mask[:-1]
        out[:-1] |= mask[1:]
        out[:, 1:] |= mask[:, :-1]
        out[:, :-1] |= mask[:, 1:]
        out[:, :, 1:] |= mask[:, :, :-1]
        out[:, :, :-1] |= mask[:, :, 1:]
        mask = out
    return mask


def pieces(mask: Tensor) -> Tensor:
    """Connected pieces, across faces, edges and corners: each cell of the mask holds the largest number of a cell in
    its piece, others −1."""
    number = torch.arange(mask.numel(), dtype=torch.float64).reshape(mask.shape)
    label = torch.where(mask, number, -1.0)
    for _ in range(mask.numel()):
        spread = torch.nn.functional.max_pool3d(label[None, None], 3, 1, 1)[0, 0]
        spread = torch.where(mask, spread, -1.0)
        if torch.equal(spread, label):
            break
        label = spread
    return label.long()


def outside(mask: Tensor, seal: int) -> Tensor:
    """Cells outside the mask that belong to the rim of the lattice rather than to a room that the mask encloses but
    for holes up to 2 ``seal`` cells wide.

    A watershed by the distance to the mask, farthest first: the rim and every room that is cut off from all others at
    that distance grow, one cell across faces at a time, and stop where they meet. So a hole is closed in its middle,
    and a crevice, which is nowhere wider than at its mouth, belongs to what it opens into (Beucher & Lantuéjoul 1979).
    """
    rim = torch.ones_like(mask)
    rim[1:-1, 1:-1, 1:-1] = False
    out, inside = torch.zeros_like(mask), torch.zeros_like(mask)
    walls = [mask]
    for _ in range(seal):
        walls.append(grow(walls[-1]))
    for wall in reversed(walls):
        out = (out | rim) & ~wall
        for _ in range(mask.numel()):
            more = out | (grow(out) & ~wall & ~inside)
            within = inside | (grow(inside) & ~wall & ~more)
            if torch.equal(more, out) and torch.equal(within, inside):
                break
            out, inside = more, within
        inside = inside | ~(wall | out)
    return out


def column(mask: Tensor, axis: int, sign: int) -> Tensor:
    """Looking from each cell along an axis, the cell itself not counted: how often the mask begins, int64.

    Args:
        sign: 1 looks up the axis, −1 down.
    """
    m = mask.flip(axis) if sign < 0 else mask
    before = torch.zeros_like(m)
    size = m.shape[axis]
    before.narrow(axis, 1, size - 1).copy_(m.narrow(axis, 0, size - 1))
    begins = (m & ~before).long()
    ahead = begins.flip(axis).cumsum(axis).flip(axis) - begins
    return ahead.flip(axis) if sign < 0 else ahead
