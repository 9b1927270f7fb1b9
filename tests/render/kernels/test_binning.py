"""Two ways to the lists of Gaussians by tile."""

import pytest
import torch

from diffuphy.render.kernels.binning import bin_by_counting, bin_by_sorting, depth_order, tiling


def random_boxes(views: int, count: int, width: int, height: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    a = torch.rand(views, count, 4, generator=g)
    x0, y0 = (a[..., 0] * width).int(), (a[..., 1] * height).int()
    x1 = torch.minimum(x0 + (a[..., 2] * 20).int(), torch.tensor(width))
    y1 = torch.minimum(y0 + (a[..., 3] * 20).int(), torch.tensor(height))
    boxes = torch.stack([x0, y0, x1, y1], dim=-1).int()
    boxes[(x1 <= x0) | (y1 <= y0)] = 0
    return boxes, torch.rand(views, count, generator=g) + 1


@pytest.mark.parametrize("tile", [4, 8, 32])
@pytest.mark.parametrize("count", [0, 1, 200])
def test_counting_and_sorting_make_the_same_lists(tile: int, count: int) -> None:
    boxes, depths = random_boxes(3, count, 50, 30)
    columns, rows = tiling(50, 30, tile)
    offsets, ids = bin_by_counting(boxes, depths, tile, columns, rows, threads=2)
    offsets_sorted, ids_sorted = bin_by_sorting(boxes, depths, tile, columns, rows)
    assert torch.equal(offsets, offsets_sorted)
    assert torch.equal(ids[: int(offsets[-1, -1])], ids_sorted[: int(offsets[-1, -1])])


def test_lists_hold_exactly_what_meets_the_tile_nearest_first() -> None:
    boxes, depths = random_boxes(2, 200, 50, 30)
    columns, rows = tiling(50, 30, 8)
    offsets, ids = bin_by_counting(boxes, depths, 8, columns, rows, threads=1)
    for c in range(2):
        for t in range(columns * rows):
            x, y = t % columns * 8, t // columns * 8
            b = boxes[c]
            meets = (b[:, 2] > b[:, 0]) & (b[:, 0] < x + 8) & (b[:, 2] > x) & (b[:, 1] < y + 8) & (b[:, 3] > y)
            expected = sorted(meets.nonzero()[:, 0].tolist(), key=lambda i: depths[c, i].item())
            assert ids[offsets[c, t] : offsets[c, t + 1]].tolist() == expected


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_equal_depths_keep_their_order(dtype: torch.dtype) -> None:
    depths = torch.tensor([[2.0, 1.0, 2.0, 0.5, 1.0, 1e30, 1e-30]], dtype=dtype)
    assert depth_order(depths).tolist() == [[6, 3, 1, 4, 0, 2, 5]]
