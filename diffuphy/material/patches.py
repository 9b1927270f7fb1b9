"""Patches of a point cloud: farthest-point centres, nearest neighbours, interpolation weights, colour regions.

Plain torch: devices and dtypes follow the inputs, nothing is drawn at random, and nothing depends on the order of the
points except ties, which the machine's ``argmax`` and ``topk`` resolve.
"""

import torch
from torch import Tensor

PAIRS = 2**23
"""Distances held at once: 32 MB in float32, whatever the number of points."""


def body_frame(x: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Origin and axes that move with a body: what is said in them does not depend on where it lies or how it is turned.

        x̄ = Σ w x / Σ w,   Σ w (x − x̄)(x − x̄)ᵀ = A Λ Aᵀ,   Σ w (a_k · (x − x̄))³ ≥ 0 for k = 1, 2,   det A = 1

    Principal axes; the first two point where the body reaches farther, the third makes them right-handed. Axes are as
    well determined as the moments differ: a ball of N points drawn at random has gaps of order N^−½, enough for
    rounding. A body that looks the same after some turn of its own, to rounding, has several such frames and gets one.

    Args:
        x: points, shape (N, 3).
        weight: w, positive, shape (N,); what depends on looks tells bodies of symmetric shape apart.

    Returns:
        x̄, shape (3,), and A, axes as columns, shape (3, 3), in the precision of x; computed in float64.
    """
    w = (weight / weight.sum()).double()[:, None]
    d = x.detach().double()
    origin = (w * d).sum(0)
    d = d - origin
    axes = torch.linalg.eigh((w * d).T @ d)[1].flip(1)
    first, second = ((w * (d @ axes) ** 3).sum(0) < 0).tolist()[:2]
    signs = axes.new_tensor([-1.0 if first else 1.0, -1.0 if second else 1.0, 1.0])
    axes = axes * signs
    axes = torch.cat([axes[:, :2], axes[:, 2:] * torch.linalg.det(axes)], 1)
    return origin.to(x.dtype), axes.to(x.dtype)


def farthest_points(x: Tensor, n: int) -> Tensor:
    """Indices of n points spread over the cloud, each the farthest from those chosen before.

        i_0 = argmax |x_i − x̄|,   i_{m+1} = argmax_i min_{j ≤ m} |x_i − x_{i_j}|

    Farthest-point sampling (Gonzalez 1985; Eldar et al. 1997): within a factor 2 of the best covering radius.
    Starting at the point farthest from the centroid makes the answer a function of the set, not of the order of its
    points.

    Args:
        x: points, shape (N, D).
        n: number of centres.

    Returns:
        Indices, shape (n,), int64, in the order of choice.

    Raises:
        ValueError: if the cloud has fewer than n distinct points.
    """
    if x.ndim != 2 or not 1 <= n <= x.shape[0]:
        raise ValueError(
            f"need points (N, D) with N ≥ n ≥ 1, got shape {tuple(x.shape)} and n = {n}; ask for fewer centres"
        )
    x = x.detach()
    chosen = [((x - x.mean(0)) ** 2).sum(1).argmax()]
    reach = ((x - x[chosen[0]]) ** 2).sum(1)
    radii = []
    for _ in range(n - 1):
        chosen.append(reach.argmax())
        radii.append(reach[chosen[-1]])
        reach = torch.minimum(reach, ((x - x[chosen[-1]]) ** 2).sum(1))
    if radii and not torch.stack(radii).min() > 0:
        distinct = 1 + int((torch.stack(radii) > 0).sum())
        raise ValueError(f"got {n} centres to find among {distinct} distinct finite points; ask for at most {distinct}")
    return torch.stack(chosen)


def nearest(query: Tensor, x: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """The k points of ``x`` nearest to each query, nearest first.

    Distances are formed from differences, not from |a|² + |b|² − 2ab, which loses half the digits of near points.

    Args:
        query: shape (Q, D).
        x: shape (N, D), N ≥ k.

    Returns:
        Distances (Q, k), in the unit of the points, and indices into ``x`` (Q, k).

    Raises:
        ValueError: if there are fewer than k points.
    """
    if not 1 <= k <= x.shape[0]:
        raise ValueError(f"nearest needs 1 ≤ k ≤ number of points, got k = {k} for {x.shape[0]} points; lower k")
    with torch.no_grad():
        rows = max(1, PAIRS // x.shape[0])
        parts = [
            torch.cdist(q, x, compute_mode="donot_use_mm_for_euclid_dist").topk(k, dim=1, largest=False, sorted=True)
            for q in query.split(rows)
        ]
        return torch.cat([p.values for p in parts]), torch.cat([p.indices for p in parts])


def interpolation(query: Tensor, centres: Tensor, k: int = 3) -> tuple[Tensor, Tensor]:
    """Inverse-distance weights of the k centres nearest to each query.

        y(q) = Σ_a w_a y_a,   w_a = (1/d_a) / Σ_b (1/d_b)

    PointNet++ (Qi et al. 2017) eq. 2 with exponent 1. Computed as d_1/d_a, so a query on a centre gets that centre's
    value exactly, without a small number in the denominator.

    Args:
        query: shape (Q, D).
        centres: distinct points, shape (G, D); with fewer than k centres all of them are used.

    Returns:
        Weights (Q, k), rows summing to 1, and indices into ``centres`` (Q, k).

    Raises:
        ValueError: if two of the centres used coincide with a query.
    """
    d, index = nearest(query, centres, min(k, centres.shape[0]))
    if d.shape[1] > 1 and bool((d[:, 1] == 0).any()):
        raise ValueError("two centres coincide, so their interpolation weights are undefined; give distinct centres")
    w = torch.cat([torch.ones_like(d[:, :1]), d[:, :1] / d[:, 1:]], 1)
    return w / w.sum(1, keepdim=True), index


def kin(x: Tensor, colors: Tensor, draft: Tensor, draft_colors: Tensor, k: int = 4) -> Tensor:
    """The draft particle that each point belongs to: of the k nearest the one most alike in colour.

    Of equals it is the nearer. The nearest alone would blur every border between two materials by half a draft spacing.

    Args:
        x: shape (Q, 3) [m]. colors: shape (Q, 3). draft: shape (N, 3) [m]. draft_colors: shape (N, 3).

    Returns:
        Indices into ``draft``, shape (Q,), int64.
    """
    near = nearest(x, draft, min(k, len(draft)))[1]
    unlike = (colors[:, None] - draft_colors[near]).square().sum(2)
    return near.gather(1, unlike.argmin(1, keepdim=True))[:, 0]


def color_clusters(
    colors: Tensor, k: int = 2, *, min_distance: float = 0.1, iterations: int = 100
) -> tuple[Tensor, Tensor]:
    """Regions of one colour, for hypotheses that give each region its own material.

        min Σ_p |c_p − centre_{label(p)}|²

    Lloyd's k-means from farthest-point seeds, until no label changes. Two centres nearer than ``min_distance`` are
    one colour to the eye, not two materials: then k is lowered by one and the search repeated, so a plain object
    comes out as one region.

    Args:
        colors: rgb in [0, 1], shape (N, 3).
        k: most regions wanted.
        min_distance: least distance of two centres in rgb [-]; 0.1 is a tenth of one channel's range.
        iterations: most sweeps; small problems settle in fewer than ten.

    Returns:
        Labels (N,), int64, region 0 being the largest, and the mean colour of each region (K, 3), K ≤ k.
    """
    if colors.ndim != 2 or k < 1:
        raise ValueError(f"color_clusters needs colours (N, 3) and k ≥ 1, got shape {tuple(colors.shape)} and k = {k}")
    colors = colors.detach()
    k = min(k, torch.unique(colors, dim=0).shape[0])
    while True:
        labels, centers = _lloyd(colors, k, iterations)
        if k == 1 or float(torch.pdist(centers).min()) >= min_distance:
            break
        k -= 1
    counts = torch.bincount(labels, minlength=k)
    order = torch.argsort(counts, descending=True, stable=True)
    rank = torch.empty_like(order)
    rank[order] = torch.arange(k, device=order.device)
    return rank[labels], centers[order]


def _lloyd(colors: Tensor, k: int, iterations: int) -> tuple[Tensor, Tensor]:
    """Labels and centres of k-means; sums as a matrix product, which is repeatable on every device."""
    centers = colors[farthest_points(colors, k)]
    labels = nearest(colors, centers, 1)[1][:, 0]
    for _ in range(iterations):
        member = torch.nn.functional.one_hot(labels, k).to(colors.dtype)
        counts = member.sum(0)[:, None]
        centers = torch.where(counts > 0, member.T @ colors / counts.clamp(min=1), centers)
        labels, old = nearest(colors, centers, 1)[1][:, 0], labels
        if torch.equal(labels, old):
            break
    return labels, centers
