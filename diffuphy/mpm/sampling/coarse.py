"""Fewer, larger particles of the same body, for drafts."""

import dataclasses

import torch
from torch import Tensor

from diffuphy.types import Particles


def coarsen(
    particles: Particles,
    *,
    spacing: float | None = None,
    n: int | None = None,
    seed: int = 0,
    kind: Tensor | None = None,
) -> tuple[Particles, Tensor]:
    """Fewer, larger particles of the same body: one for each cell of a coarse lattice, with the volume of all in it.

        V_c = Σ_{p ∈ c} V_p,   hence  Σ_{c of kind k} V_c = Σ_{p of kind k} V_p

    The one nearest to the centre of volume of its cell is kept, so that every coarse particle is one of the fine ones.
    Kinds do not mix: a cell that holds several is as many groups, and a group of less than half a cell joins a larger
    one of its kind beside it. So kinds keep their volumes whatever the lattice; a layer two cells thick would otherwise
    gain or lose a third of it by the phase.

    Args:
        spacing: side of the coarse lattice [m].
        n: or at most so many particles; the finest lattice that gives them is sought.
        seed: of the lattice's phase.
        kind: what does not mix, such as the region of each fine particle, shape (N,), int64; None: all are alike.

    Returns:
        The coarse particles, and the index of each among the fine ones, shape (n,), int64, ascending.

    Raises:
        ValueError: unless exactly one of ``spacing`` and ``n`` is given, and positive.
    """
    if (spacing is None) == (n is None) or not (spacing or n or 0) > 0:
        raise ValueError(f"give either a positive spacing or a positive n, got spacing = {spacing}, n = {n}")
    x, vol = particles.x.detach().cpu().double(), particles.vol.detach().cpu().double()
    phase = torch.rand(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    kinds = None if kind is None or not bool((kind != kind[0]).any()) else kind.detach().cpu().long()[:, None]

    def bins(h: float) -> tuple[Tensor, int]:
        cell = ((x - x.amin(0)) / h + phase).floor().long()
        cell = cell if kinds is None else torch.cat([cell, kinds], 1)
        names, which = torch.unique(cell, dim=0, return_inverse=True)
        if kinds is not None:
            which = _without_slivers(x, vol, which, names[:, 3], h)
        return which, int(which.max()) + 1

    h = spacing or (float(vol.sum()) / n) ** (1 / 3)  # type: ignore[operator]
    which, count = bins(h)
    while n is not None and count > n:
        h *= max(1.01, (count / n) ** (1 / 3))
        which, count = bins(h)
    total, center = _volumes(x, vol, which)
    far = ((x - center[which]) ** 2).sum(1)
    order = torch.argsort(far, descending=True, stable=True)
    kept = torch.full((count,), -1).scatter_reduce(0, which[order], torch.arange(len(x)), "amax")
    kept = order[kept]
    kept, by = kept.sort()
    device = particles.x.device
    coarse = dataclasses.replace(
        particles,
        x=particles.x[kept.to(device)],
        vol=total[by].to(particles.vol),
        gaussian=particles.gaussian[kept.to(device)],
        spacing=(float(total.sum()) / count) ** (1 / 3),
    )
    return coarse, kept.to(device)


def _volumes(x: Tensor, vol: Tensor, group: Tensor) -> tuple[Tensor, Tensor]:
    """Volume and centre of volume of each group of particles."""
    count = int(group.max()) + 1
    total = torch.zeros(count, dtype=vol.dtype).index_add_(0, group, vol)
    return total, torch.zeros(count, 3, dtype=vol.dtype).index_add_(0, group, vol[:, None] * x) / total[:, None]


def _without_slivers(x: Tensor, vol: Tensor, group: Tensor, kind: Tensor, h: float) -> Tensor:
    """The group of each particle after those of less than half a cell have joined the nearest of their kind that has
    more, if it is next to them: a layer thinner than half a cell keeps its groups.

    Args:
        group: of each particle, shape (N,). kind: of each group, shape (G,). h: side of a cell [m].
    """
    total, center = _volumes(x, vol, group)
    joined = torch.arange(len(total))
    for k in kind.unique():
        small, large = (((kind == k) & big).nonzero()[:, 0] for big in (total < h**3 / 2, total >= h**3 / 2))
        if len(small) and len(large):
            far, to = torch.cdist(center[small], center[large]).min(1)
            joined[small] = torch.where(far < 1.5 * h, large[to], small)
    return joined.unique(return_inverse=True)[1][group]
