"""Which nodes of a block are worked on when particles fill little of it: two bodies far apart, a splash.

Around the free path of every particle through the frame, widened by a slack, cells are allowed; nodes that particles in
them can reach, their mirror images, and one node around are active. The passes over the grid go through the list of
active nodes, so that time follows occupied cells and not the box. Rows keep their place in the block: those of other
nodes are never touched, and on a CPU take no memory before they are (on a GPU they do: 128 bytes a node in float32).
A particle that leaves the allowed cells is one that leaves the block: the frame is run again with more of them.
Results are those of the whole block to the last bit.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from diffuphy.mpm.grid import Grid

MAX_SAMPLES = 64
"""Most points of a path; further apart than the slack they leave gaps, which a second run with more slack closes."""


@dataclass(frozen=True)
class Active:
    """Part of a block."""

    cells: Tensor
    """Where the lowest node of a particle may be, shape (nodes,), bytes 0 or 1."""
    nodes: Tensor
    """Rows of the active nodes, ascending, int32."""


def active(
    x: Tensor,
    v: Tensor,
    grid: Grid,
    T: float,
    gravity: tuple[float, ...],
    order: int,
    planes: tuple[tuple[int, ...], tuple[int, ...]],
    reach: int,
) -> Active:
    """The part of ``grid`` that a frame of length ``T`` [s] takes.

    Args:
        x, v: particles at its start, shape (N, 3) [m], [m/s].
        order: degree of the B-spline.
        planes: nodes of the mirror planes, low and high, anywhere outside where there are none.
        reach: nodes on either side of a plane that have an image.
    """
    assert grid.slack is not None
    start = (x.detach() - x.new_tensor(grid.low)) / grid.dx - 0.5 * (order - 1)
    way, bend = v.detach() * (T / grid.dx), x.new_tensor(gravity) * (0.5 * T * T / grid.dx)
    longest = float(way.abs().max()) + float(bend.abs().max())
    samples = min(MAX_SAMPLES, 2 + int(longest / max(1, grid.slack)))
    top = torch.tensor(grid.shape, device=x.device) - 1
    path = [
        torch.minimum((start + t * way + t * t * bend).floor().long().clamp_min(0), top)
        for t in torch.linspace(0.0, 1.0, samples).tolist()
    ]
    kept = [_kept(path, axis, grid, planes, reach, order) for axis in range(3)]
    place = [_inverse(k, n) for k, n in zip(kept, grid.shape, strict=True)]
    cells = torch.zeros([len(k) for k in kept], dtype=torch.bool, device=x.device)
    for at in path:
        cells[tuple(place[axis][at[:, axis]] for axis in range(3))] = True
    cells = widened(cells, grid.slack, grid.slack)
    nodes = _folded(widened(cells, 0, order), planes, reach, place)  # where there can be mass
    nodes = _folded(widened(nodes, 1, 1), planes, reach, place)
    return Active(_table(_rows(cells, kept, grid), grid.nodes), _rows(nodes, kept, grid).to(torch.int32))


def _kept(
    path: list[Tensor], axis: int, grid: Grid, planes: tuple[tuple[int, ...], tuple[int, ...]], reach: int, order: int
) -> Tensor:
    """Indices along an axis between which sets are looked for: those of particles, as much around as sets are widened,
    and those of mirror images; what lies between bodies is left out. Ascending."""
    assert grid.slack is not None
    n = grid.shape[axis]
    used = torch.zeros(n, dtype=torch.bool, device=path[0].device)
    for at in path:
        used[at[:, axis]] = True
    used = widened(used, grid.slack + 2, grid.slack + order + 2)
    for side in planes:
        a, b = max(0, side[axis] - reach), min(n, side[axis] + reach + 1)
        if a < b:
            used[max(0, a - 2) : b + 2] = True
    return used.nonzero()[:, 0]


def _inverse(kept: Tensor, n: int) -> Tensor:
    """Place of each of ``n`` indices among those that are kept, −1 for the others."""
    out = torch.full((n,), -1, dtype=torch.long, device=kept.device)
    out[kept] = torch.arange(len(kept), device=kept.device)
    return out


def _rows(mask: Tensor, kept: list[Tensor], grid: Grid) -> Tensor:
    """Rows of a set in the block, ascending."""
    i, j, k = (kept[axis][at] for axis, at in enumerate(mask.nonzero().unbind(1)))
    return (i * grid.shape[1] + j) * grid.shape[2] + k


def _table(rows: Tensor, nodes: int) -> Tensor:
    """Bytes that are 1 in some rows; on a CPU the others take no memory."""
    if rows.device.type == "cpu":
        table = torch.from_numpy(np.zeros(nodes, np.uint8))
    else:
        table = torch.zeros(nodes, dtype=torch.uint8, device=rows.device)
    table[rows] = 1
    return table


def widened(mask: Tensor, down: int, up: int) -> Tensor:
    """True up to ``down`` places below and ``up`` places above what is true, along every axis."""
    for axis in range(mask.dim()):
        for count, sign in ((up, 1), (down, -1)):
            done = 0
            while done < count:
                step = min(count - done, done + 1, mask.shape[axis])
                keep = mask.shape[axis] - step
                low, high = mask.narrow(axis, 0, keep), mask.narrow(axis, step, keep)
                mask = mask.clone()
                if sign > 0:
                    mask.narrow(axis, step, keep).logical_or_(low)
                else:
                    mask.narrow(axis, 0, keep).logical_or_(high)
                done += step
    return mask


def _folded(mask: Tensor, planes: tuple[tuple[int, ...], tuple[int, ...]], reach: int, place: list[Tensor]) -> Tensor:
    """What is true, and its images in the mirror planes."""
    mask = mask.clone()
    for axis in range(3):
        for side in planes:
            for d in range(1, reach + 1):
                low, high = side[axis] - d, side[axis] + d
                if low >= 0 and high < len(place[axis]):
                    a, b = int(place[axis][low]), int(place[axis][high])
                    both = mask.select(axis, a) | mask.select(axis, b)
                    mask.select(axis, a).copy_(both)
                    mask.select(axis, b).copy_(both)
    return mask
