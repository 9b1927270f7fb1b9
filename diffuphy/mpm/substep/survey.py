"""What an adjoint takes from the nodes around a particle, in one pass over them.

Both directions of the transfer are a sum over nodes, S = Σ_i row_i · (w_i (q + A d_i) + B ∇w_i), of rows that the nodes
hold and of an affine field that the particle holds. Its derivative along an axis is linear in the field, with
coefficients that depend on the rows and the place alone:

    ∂S/∂x_a = (Σ ∂_a w row)·q + Σ_b (Σ ∂_a w row i_b)·a_b + Σ_b (Σ ∂_a ∂_b w row)·b_b

So the nodes are read once, before anyone knows the field, and sums of vectors are all that is done with them: a dot
product at each node would be several times dearer. Sums are nested along the axes, as in ``transfer.gather``.
"""

from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.substep.simd import make_simd
from diffuphy.mpm.substep.transfer import make_transfer

CURVED = 16
"""Where the second derivatives begin, of the classic form alone: xx, xy, xz, yy, yz, zz."""


@lru_cache
def make_survey(scheme: Scheme, real: type) -> SimpleNamespace:
    """``survey`` and ``along`` of one scheme.

    Rows of a survey: Σ w row, Σ w row i, Σ w row j, Σ w row k; the same four with ∂_x w, then with ∂_y w and ∂_z w;
    then those of ``CURVED``.
    """
    spline, node_t = make_transfer(scheme, real).spline, make_transfer(scheme, real).node_t
    along = (_make_curved_along if scheme.force == "classic" else _make_along)(real, node_t)
    return SimpleNamespace(survey=_make_survey(scheme, spline, node_t, real), along=along)


def _make_survey(scheme: Scheme, spline: SimpleNamespace, node_t: type, real: type) -> Any:
    vec3, vec_w = wp.types.vector(3, real), spline.vec_w
    weights, slopes, curvatures = spline.weights, spline.slopes, spline.curvatures
    simd, K, classic = make_simd(real), scheme.order + 1, scheme.force == "classic"
    plus, take = simd.plus, simd.take
    size = CURVED + 6 * classic

    @wp.func(module="unique")
    def survey(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3
    ):  # fmt: skip
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dx, dy, dz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        ex, ey, ez = vec_w(), vec_w(), vec_w()
        if wp.static(classic):
            ex, ey, ez = curvatures(f[0]), curvatures(f[1]), curvatures(f[2])
        rows = wp.zeros(shape=(wp.static(size),), dtype=node_t)
        for i in range(wp.static(K)):
            t, tj, tk = node_t(), node_t(), node_t()  # Σ w row, and times j and k, over the nodes of a plane
            y, yj, yk = node_t(), node_t(), node_t()  # with the slope along y
            z, zj, zk = node_t(), node_t(), node_t()  # with the slope along z
            yy, yz, zz = node_t(), node_t(), node_t()
            for j in range(wp.static(K)):
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                a, ak, b, bk, c = node_t(), node_t(), node_t(), node_t(), node_t()  # over the nodes of a line
                for k in range(wp.static(K)):
                    r = take(grid, o, k)
                    a = plus(a, wz[k], r)
                    b = plus(b, dz[k], r)
                    if wp.static(k > 0):
                        ak = plus(ak, wp.static(real(k)) * wz[k], r)
                        bk = plus(bk, wp.static(real(k)) * dz[k], r)
                    if wp.static(classic):
                        c = plus(c, ez[k], r)
                w, d = wy[j], dy[j]
                t, tk = plus(t, w, a), plus(tk, w, ak)
                y, yk = plus(y, d, a), plus(yk, d, ak)
                z, zk = plus(z, w, b), plus(zk, w, bk)
                if wp.static(j > 0):
                    wj, dj = wp.static(real(j)) * w, wp.static(real(j)) * d
                    tj, yj, zj = plus(tj, wj, a), plus(yj, dj, a), plus(zj, wj, b)
                if wp.static(classic):
                    yy, yz, zz = plus(yy, ey[j], a), plus(yz, d, b), plus(zz, w, c)
            w, d = wx[i], dx[i]
            rows[0] = plus(rows[0], w, t)
            rows[2] = plus(rows[2], w, tj)
            rows[3] = plus(rows[3], w, tk)
            rows[4] = plus(rows[4], d, t)
            rows[6] = plus(rows[6], d, tj)
            rows[7] = plus(rows[7], d, tk)
            rows[8] = plus(rows[8], w, y)
            rows[10] = plus(rows[10], w, yj)
            rows[11] = plus(rows[11], w, yk)
            rows[12] = plus(rows[12], w, z)
            rows[14] = plus(rows[14], w, zj)
            rows[15] = plus(rows[15], w, zk)
            if wp.static(i > 0):
                wi, di = wp.static(real(i)) * w, wp.static(real(i)) * d
                rows[1] = plus(rows[1], wi, t)
                rows[5] = plus(rows[5], di, t)
                rows[9] = plus(rows[9], wi, y)
                rows[13] = plus(rows[13], wi, z)
            if wp.static(classic):
                rows[16] = plus(rows[16], ex[i], t)
                rows[17] = plus(rows[17], d, y)
                rows[18] = plus(rows[18], d, z)
                rows[19] = plus(rows[19], w, yy)
                rows[20] = plus(rows[20], w, yz)
                rows[21] = plus(rows[21], w, zz)
        return rows

    return survey


def _make_along(real: type, node_t: type) -> Any:
    vec3 = wp.types.vector(3, real)

    @wp.func(module="unique")
    def axis(rows: Any, at: wp.int32, q: node_t, a0: node_t, a1: node_t, a2: node_t):
        """Numbers whose sum is that of an axis, of its four rows from ``at`` on."""
        x = wp.cw_mul(rows[at], q) + wp.cw_mul(rows[at + 1], a0)
        return x + (wp.cw_mul(rows[at + 2], a1) + wp.cw_mul(rows[at + 3], a2))

    @wp.func(module="unique")
    def total(r: node_t):
        return ((r[0] + r[4]) + (r[1] + r[5])) + ((r[2] + r[6]) + (r[3] + r[7]))

    @wp.func(module="unique")
    def along(rows: Any, q: node_t, a0: node_t, a1: node_t, a2: node_t):
        """∂S/∂x of the field q + A i."""
        return vec3(
            total(axis(rows, 4, q, a0, a1, a2)),
            total(axis(rows, 8, q, a0, a1, a2)),
            total(axis(rows, 12, q, a0, a1, a2)),
        )

    return along


def _make_curved_along(real: type, node_t: type) -> Any:
    vec3 = wp.types.vector(3, real)
    flat = _make_along(real, node_t)

    @wp.func(module="unique")
    def three(rows: Any, a: wp.int32, b: wp.int32, c: wp.int32, c0: node_t, c1: node_t, c2: node_t):
        return wp.dot(rows[a], c0) + wp.dot(rows[b], c1) + wp.dot(rows[c], c2)

    @wp.func(module="unique")
    def along(rows: Any, q: node_t, a0: node_t, a1: node_t, a2: node_t, c0: node_t, c1: node_t, c2: node_t):
        """∂S/∂x of the field q + A i with C acting on ∇w."""
        return flat(rows, q, a0, a1, a2) + vec3(
            three(rows, 16, 17, 18, c0, c1, c2),
            three(rows, 17, 19, 20, c0, c1, c2),
            three(rows, 18, 20, 21, c0, c1, c2),
        )

    return along
