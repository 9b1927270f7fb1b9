"""The same body with fewer particles: one for all that lie in a cell of a coarse lattice, at their centre of mass.

Restriction, as in multigrid: what the fine particles do is compared with what the coarse ones do cell by cell, without
interpolation. Mass, volume and centre of mass are those of the fine body, exactly; at rest the two agree in every cell.
"""

import dataclasses
from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.types import MaterialField

SIDES = 1e-6
"""Share of a cell by which particles on its side count as inside: lattices of particles fit into those of cells."""


@dataclass(frozen=True)
class Restriction:
    """N particles as M coarse ones."""

    x: Tensor
    """Centres of mass of the cells, shape (M, 3) [m], float64."""
    vol: Tensor
    """Volumes, shape (M,) [m³], float64."""
    mass: Tensor
    """Masses, shape (M,) [kg], float64."""
    cell: Tensor
    """Cell of each fine particle, shape (N,), int64."""
    share: Tensor
    """Its share in the mass of the cell, shape (N,), float64."""
    near: Tensor
    """The fine particle next to each centre: its laws and parameters are those of the coarse one, shape (M,), int64."""

    def __len__(self) -> int:
        return len(self.x)

    def __call__(self, values: Tensor) -> Tensor:
        """Means over the cells by mass, (N, …) → (M, …), float64."""
        weighted = values.double() * self.share.reshape(-1, *[1] * (values.dim() - 1))
        return weighted.new_zeros(len(self), *values.shape[1:]).index_add_(0, self.cell, weighted)

    def field(self, field: MaterialField) -> MaterialField:
        """The material of the coarse particles; densities carry the mass."""
        near = self.near
        return dataclasses.replace(
            field,
            w_e=field.w_e[near],
            w_p=field.w_p[near],
            theta={name: values[near] for name, values in field.theta.items()},
            rho=(self.mass / self.vol).to(field.rho),
        )


def restrict(x: Tensor, vol: Tensor, rho: Tensor, *, spacing: float, side: float) -> Restriction:
    """Gather particles into cells of the lattice that begins half a particle outside the lowest ones.

        m_k = Σ m_p,   V_k = Σ V_p,   x_k = Σ m_p x_p / m_k   over the particles p of cell k

    Args:
        x: positions, shape (N, 3) [m].
        vol: volumes, shape (N,) [m³].
        rho: densities, shape (N,) [kg/m³].
        spacing: of the fine particles [m].
        side: of the cells [m].

    Raises:
        ValueError: a side that is not larger than the spacing.
    """
    if not side > spacing > 0.0:
        raise ValueError(f"side must be larger than spacing, and both positive, got {side} and {spacing} m")
    x, vol = x.detach().double(), vol.detach().double()
    mass = rho.detach().double() * vol
    lowest = x.amin(0) - 0.5 * spacing
    places = ((x - lowest) / side + SIDES).floor().long()
    names, cell = torch.unique(places, dim=0, return_inverse=True)
    M = len(names)
    m_k, V_k = (torch.zeros(M, dtype=x.dtype, device=x.device).index_add_(0, cell, t) for t in (mass, vol))
    share = mass / m_k[cell]
    center = x.new_zeros(M, 3).index_add_(0, cell, share[:, None] * x)
    order = torch.argsort((x - center[cell]).square().sum(1), descending=True, stable=True)
    last = torch.full((M,), -1, device=x.device)
    last = last.scatter_reduce(0, cell[order], torch.arange(len(x), device=x.device), "amax")
    return Restriction(center, V_k, m_k, cell, share, order[last])
