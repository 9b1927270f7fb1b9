"""Patches of a point cloud, against brute force."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from diffuphy.material.patches import color_clusters, farthest_points, interpolation, kin, nearest


def cloud(n, seed=0, d=3):
    return torch.rand(n, d, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_farthest_points_are_each_the_farthest_from_those_before():
    """i_{m+1} = argmax_i min_{j ≤ m} |x_i − x_j|, found by the full distance matrix."""
    x = cloud(60)
    chosen = farthest_points(x, 12)
    d = (x[:, None] - x[None]).norm(dim=-1)
    assert chosen[0] == (x - x.mean(0)).norm(dim=1).argmax()
    for m in range(1, 12):
        assert chosen[m] == d[:, chosen[:m]].min(1).values.argmax()


def test_farthest_points_cover_within_twice_the_best_radius():
    """Gonzalez (1985): the covering radius is at most 2 × optimal, so of m separated clumps each has one centre."""
    clumps = torch.arange(5, dtype=torch.float64)[:, None] * torch.tensor([[10.0, 0, 0]])
    x = (clumps[:, None] + 0.5 * (cloud(8)[None] - 0.5)).reshape(-1, 3)
    chosen = farthest_points(x, 5)
    assert sorted((chosen // 8).tolist()) == [0, 1, 2, 3, 4]


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), n=st.integers(8, 80))
def test_farthest_points_do_not_depend_on_the_order_of_the_points(seed, n):
    """The chosen *points* are the same, in the same order, for every permutation of the rows."""
    x = cloud(n, seed)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed + 1))
    assert torch.equal(x[farthest_points(x, 8)], x[order][farthest_points(x[order], 8)])


def test_farthest_points_refuse_fewer_points_than_centres():
    with pytest.raises(ValueError, match="fewer centres"):
        farthest_points(cloud(3), 4)


def test_farthest_points_count_only_distinct_points():
    with pytest.raises(ValueError, match="at most 2"):
        farthest_points(torch.tensor([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]]), 3)
    with pytest.raises(ValueError, match="distinct finite"):
        farthest_points(torch.full((4, 3), torch.nan), 2)


@pytest.mark.parametrize("pairs", [1, 100, 2**23])
def test_nearest_is_the_sorted_distance_matrix(pairs, monkeypatch):
    """The k smallest of |q − x|, nearest first, however the queries are split."""
    monkeypatch.setattr("diffuphy.material.patches.PAIRS", pairs)
    q, x = cloud(17), cloud(40, 1)
    d, index = nearest(q, x, 5)
    full = (q[:, None] - x[None]).norm(dim=-1)
    torch.testing.assert_close(d, full.sort(1).values[:, :5], rtol=1e-14, atol=0)
    assert torch.equal(index, full.argsort(1)[:, :5])


def test_nearest_keeps_the_digits_of_near_points():
    """Two points 1e-4 apart, 10 from the origin: |a|²+|b|²−2ab in float32 would be off by 1e-5·100/1e-4."""
    # 60 rows: enough for cdist to prefer the matrix product, if it were allowed to
    x = torch.tensor([[10.0, 0, 0], [10.0001, 0, 0]]).repeat(30, 1)
    d, _ = nearest(x, x, 60)
    torch.testing.assert_close(d[0, -1], x[1, 0] - x[0, 0], rtol=1e-6, atol=0)


def test_nearest_refuses_more_neighbours_than_points():
    with pytest.raises(ValueError, match="lower k"):
        nearest(cloud(4), cloud(2), 3)


def test_interpolation_weights_are_inverse_distances():
    """w_a = (1/d_a) / Σ (1/d_b)."""
    q, c = cloud(50), cloud(9, 1)
    w, index = interpolation(q, c)
    inverse = 1 / (q[:, None] - c[index]).norm(dim=-1)
    torch.testing.assert_close(w, inverse / inverse.sum(1, keepdim=True), rtol=1e-13, atol=0)


def test_interpolation_returns_a_centre_exactly():
    c = cloud(9)
    w, index = interpolation(c, c)
    assert torch.equal(index[:, 0], torch.arange(9))
    assert torch.equal(w, torch.tensor([[1.0, 0, 0]], dtype=w.dtype).expand_as(w))


def test_interpolation_uses_all_centres_when_there_are_fewer_than_k():
    w, _ = interpolation(cloud(5), cloud(2, 1), k=3)
    assert w.shape == (5, 2)
    torch.testing.assert_close(w.sum(1), torch.ones(5, dtype=w.dtype))


def test_interpolation_refuses_coinciding_centres():
    with pytest.raises(ValueError, match="coincide"):
        interpolation(torch.zeros(1, 3), torch.zeros(4, 3))


def test_color_clusters_find_bun_and_patty_whatever_the_shading():
    """Two base colours shaded by 0.8 to 1: every point gets its own region, the larger one being 0."""
    g = torch.Generator().manual_seed(0)
    patty = torch.rand(500, generator=g) < 0.3
    base = torch.where(patty[:, None], torch.tensor([0.4, 0.18, 0.1]), torch.tensor([0.9, 0.65, 0.3]))
    labels, centers = color_clusters(base * (0.8 + 0.2 * torch.rand(500, 1, generator=g)))
    assert torch.equal(labels, patty.long())
    torch.testing.assert_close(centers[1], 0.9 * torch.tensor([0.4, 0.18, 0.1]), rtol=0.05, atol=0)  # mean shade 0.9


def test_color_clusters_are_a_fixed_point_of_lloyd():
    """Each colour is in the region of its nearest centre, each centre is the mean of its region."""
    colors = cloud(200)
    labels, centers = color_clusters(colors, 4)
    assert torch.equal(labels, (colors[:, None] - centers).norm(dim=-1).argmin(1))
    for r in range(4):
        torch.testing.assert_close(centers[r], colors[labels == r].mean(0), rtol=1e-13, atol=0)
    assert labels.bincount().tolist() == sorted(labels.bincount().tolist(), reverse=True)


def test_color_clusters_of_a_plain_object_are_one_region():
    """Colours that differ by less than min_distance, or not at all, are not two materials."""
    noise = 0.03 * cloud(100)
    for colors in (noise, torch.full((100, 3), 0.5)):
        labels, centers = color_clusters(colors)
        assert len(centers) == 1 and not labels.any()
    assert len(color_clusters(noise, min_distance=0.0)[1]) == 2


@pytest.mark.gpu
def test_patches_on_cuda_are_those_of_the_cpu():
    x = cloud(300)
    centres = farthest_points(x, 16)
    assert torch.equal(farthest_points(x.cuda(), 16).cpu(), centres)
    for a, b in zip(interpolation(x.cuda(), x[centres].cuda()), interpolation(x, x[centres]), strict=True):
        torch.testing.assert_close(a.cpu(), b, rtol=1e-12, atol=1e-14)


def test_kin_is_the_nearest_of_one_colour_and_never_far():
    """On a border red belongs to red though blue is nearer; a colour that nobody near has changes nothing."""
    draft = torch.tensor([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    red, blue = [1.0, 0, 0], [0.0, 0, 1.0]
    colors = torch.tensor([red, red, blue, blue])
    x = torch.tensor([[1.6, 0, 0], [1.6, 0, 0], [0.4, 0, 0], [9.0, 0, 0]])
    mine = torch.tensor([red, blue, red, [0.0, 1.0, 0]])
    assert kin(x, mine, draft, colors, k=2).tolist() == [1, 2, 0, 3]
