"""Lists of Gaussians by tile, nearest first.

``ids[offsets[c, t] : offsets[c, t + 1]]`` are the Gaussians whose box meets tile t of view c, in the order of their
depth. On the CPU a counting sort walks the Gaussians in depth order; on CUDA torch sorts the pairs by tile.
"""

import numpy as np
import torch
import warp as wp
from torch import Tensor

from diffuphy.render.kernels import array, spread


@wp.kernel(module="unique", enable_backward=False)
def count_pairs(
    start: int,
    boxes: wp.array2d(dtype=wp.vec4i),  # (C, G) [px]
    tile: int,  # [px]
    columns: int,
    offsets: wp.array2d(dtype=int),  # (C, tiles + 1), zeros before
):
    """One thread a view: offsets of the lists of all tiles."""
    c = start + wp.tid()
    for i in range(boxes.shape[1]):
        b = boxes[c, i]
        if b[2] > b[0]:
            for y in range(b[1] // tile, (b[3] - 1) // tile + 1):
                for x in range(b[0] // tile, (b[2] - 1) // tile + 1):
                    offsets[c, y * columns + x + 1] = offsets[c, y * columns + x + 1] + 1
    for t in range(1, offsets.shape[1]):
        offsets[c, t] = offsets[c, t] + offsets[c, t - 1]


@wp.kernel(module="unique", enable_backward=False)
def fill_lists(
    start: int,
    boxes: wp.array2d(dtype=wp.vec4i),
    order: wp.array2d(dtype=wp.int64),  # (C, G) Gaussians by depth
    tile: int,
    columns: int,
    cursor: wp.array2d(dtype=int),  # (C, tiles + 1) starts of the lists before, their ends after
    ids: wp.array(dtype=int),  # (pairs)
):
    """One thread a view: hand the Gaussians out to the tiles, nearest first."""
    c = start + wp.tid()
    for k in range(order.shape[1]):
        i = int(order[c, k])
        b = boxes[c, i]
        if b[2] > b[0]:
            for y in range(b[1] // tile, (b[3] - 1) // tile + 1):
                for x in range(b[0] // tile, (b[2] - 1) // tile + 1):
                    t = y * columns + x
                    ids[cursor[c, t]] = i
                    cursor[c, t] = cursor[c, t] + 1


def tiling(width: int, height: int, tile: int) -> tuple[int, int]:
    """Columns and rows of tiles that cover the image."""
    return -(-width // tile), -(-height // tile)


def depth_order(depths: Tensor) -> Tensor:
    """Gaussians of each view by depth (C, G), nearest first, equal depths by index; those behind the camera
    anywhere, on the CPU."""
    if depths.dtype != torch.float32:
        return torch.sort(depths, dim=1, stable=True).indices
    # the bits of positive floats ascend as the floats do; NumPy sorts whole 64-bit keys ten times faster than torch
    # an index
    bits = depths.detach().numpy().view(np.uint32).astype(np.uint64)
    keys = np.sort(bits << np.uint64(32) | np.arange(bits.shape[1], dtype=np.uint64), axis=1)
    return torch.from_numpy((keys & np.uint64(0xFFFFFFFF)).astype(np.int64))


def bin_by_counting(
    boxes: Tensor, depths: Tensor, tile: int, columns: int, rows: int, threads: int
) -> tuple[Tensor, Tensor]:
    """``offsets`` (C, tiles + 1) and ``ids`` (pairs), int32, by a serial counting sort of each view."""
    views = boxes.shape[0]
    order = depth_order(depths)
    offsets = boxes.new_zeros(views, columns * rows + 1)
    w_boxes, w_order, w_offsets = array(boxes, wp.vec4i), array(order, wp.int64), array(offsets, wp.int32)
    device = str(wp.device_from_torch(boxes.device))

    def count(start: int, length: int) -> None:
        wp.launch(count_pairs, dim=length, inputs=[start, w_boxes, tile, columns, w_offsets], device=device)

    spread(count, views, threads)
    ends = torch.cumsum(offsets[:, -1], 0)
    offsets[1:] += ends[:-1, None].int()
    cursor = offsets.clone()
    ids = boxes.new_empty(max(int(ends[-1]), 1))
    w_cursor, w_ids = array(cursor, wp.int32), array(ids, wp.int32)

    def fill(start: int, length: int) -> None:
        inputs = [start, w_boxes, w_order, tile, columns, w_cursor, w_ids]
        wp.launch(fill_lists, dim=length, inputs=inputs, device=device)

    spread(fill, views, threads)
    return offsets, ids


def bin_by_sorting(boxes: Tensor, depths: Tensor, tile: int, columns: int, rows: int) -> tuple[Tensor, Tensor]:
    """The same lists by two stable sorts, of the Gaussians by depth and of the pairs by tile; all views at once."""
    views, tiles = boxes.shape[0], columns * rows
    order = torch.sort(depths, dim=1, stable=True).indices  # (C, G)
    b = torch.take_along_dim(boxes, order[..., None], dim=1).reshape(-1, 4).long()
    seen = b[:, 2] > b[:, 0]
    first = torch.div(b[:, :2], tile, rounding_mode="floor")
    extent = torch.where(seen[:, None], torch.div(b[:, 2:] - 1, tile, rounding_mode="floor") - first + 1, 0)
    pairs = extent[:, 0] * extent[:, 1]
    rank = torch.repeat_interleave(pairs)  # (pairs,) position in the depth order of all views
    k = torch.arange(rank.numel(), device=b.device) - (torch.cumsum(pairs, 0) - pairs)[rank]
    row, column = torch.div(k, extent[rank, 0], rounding_mode="floor"), k % extent[rank, 0]
    view = torch.div(rank, order.shape[1], rounding_mode="floor") if rank.numel() else rank
    key = view * tiles + (first[rank, 1] + row) * columns + first[rank, 0] + column
    key, permutation = torch.sort(key, stable=True)
    ids = order.reshape(-1)[rank[permutation]].int()
    ends = torch.searchsorted(key, torch.arange(views * tiles + 1, device=b.device)).int()
    return ends.unfold(0, tiles + 1, tiles).contiguous(), ids if ids.numel() else ids.new_zeros(1)
