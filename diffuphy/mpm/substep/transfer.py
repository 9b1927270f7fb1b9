"""Between one particle and the nodes around it: scatter and gather; ``survey`` has what their adjoints take.

A particle brings to node i an affine row of numbers, and in the classic form its stress by the gradient of the weight,

    scatter   row_i += w_i (q + A d_i) + B ∇w_i
    gather    Σ_i w_i row_i,   Σ_i w_i row_i ⊗ d_i,   and in the classic form Σ_i row_i ⊗ ∇w_i

with d_i counted in cells from the lowest node (the particle is at f there) and ∇ per cell. A row is eight numbers:
momentum, mass, what the step adds to the momentum, –; or velocity after the step, –, velocity before it, –. Eight are
a vector register (``simd``), and faster than four. Functions are made for each degree and form of force; columns of A
and B are rows.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.substep.simd import make_simd
from diffuphy.mpm.substep.spline import make_spline


@lru_cache
def make_transfer(scheme: Scheme, real: type) -> SimpleNamespace:
    """``scatter``, ``gather``, ``spline`` and ``node_t`` of one scheme."""
    spline = make_spline(real, scheme.order)
    node_t = wp.types.vector(8, real)
    parts = (_make_classic if scheme.force == "classic" else _make_affine)(spline, node_t, real, scheme.order)
    return SimpleNamespace(node_t=node_t, spline=spline, **parts)


def _make_affine(spline: SimpleNamespace, node_t: type, real: type, order: int) -> dict[str, wp.Function]:
    """Moments only; the loop along z is innermost, over neighbours in memory."""
    vec3, weights = wp.types.vector(3, real), spline.weights
    simd, K = make_simd(real), order + 1
    plus, add, take, one = simd.plus, simd.add, simd.take, real(1.0)

    @wp.func(module="unique")
    def scatter(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, a0: node_t, a1: node_t, a2: node_t,
    ):  # fmt: skip
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                w_ij = wx[i] * wy[j]
                q_ij = plus(plus(q, wp.static(real(i)), a0), wp.static(real(j)), a1)
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                for k in range(wp.static(K)):
                    add(grid, o, k, w_ij * wz[k], q_ij)
                    q_ij = plus(q_ij, one, a2)

    @wp.func(module="unique")
    def gather(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3
    ):  # fmt: skip
        """Σ w row, and Σ w row i for each axis; sums are nested, so that a node takes two operations."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        s, m0, m1, m2 = node_t(), node_t(), node_t(), node_t()
        for i in range(wp.static(K)):
            a, b, c = node_t(), node_t(), node_t()
            for j in range(wp.static(K)):
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                t, z = node_t(), node_t()
                for k in range(wp.static(K)):
                    r = take(grid, o, k)
                    t = plus(t, wz[k], r)
                    z = plus(z, wp.static(real(k)) * wz[k], r)
                a = plus(a, wy[j], t)
                b = plus(b, wp.static(real(j)) * wy[j], t)
                c = plus(c, wy[j], z)
            s = plus(s, wx[i], a)
            m0 = plus(m0, wp.static(real(i)) * wx[i], a)
            m1 = plus(m1, wx[i], b)
            m2 = plus(m2, wx[i], c)
        return s, m0, m1, m2

    return {"scatter": scatter, "gather": gather}


def _make_classic(spline: SimpleNamespace, node_t: type, real: type, order: int) -> dict[str, wp.Function]:
    """As the affine functions, with columns g0, g1, g2 (here c0, c1, c2) that act on ∇w."""
    vec3 = wp.types.vector(3, real)
    weights, slopes = spline.weights, spline.slopes
    simd, K = make_simd(real), order + 1
    plus, add, take, one = simd.plus, simd.add, simd.take, real(1.0)

    @wp.func(module="unique")
    def scatter(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, a0: node_t, a1: node_t, a2: node_t, c0: node_t, c1: node_t, c2: node_t,
    ):  # fmt: skip
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                w_ij = wx[i] * wy[j]
                q_ij = plus(plus(q, wp.static(real(i)), a0), wp.static(real(j)), a1)
                c_ij = plus(plus(node_t(), dwx[i] * wy[j], c0), wx[i] * dwy[j], c1)
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                for k in range(wp.static(K)):
                    r = plus(plus(plus(node_t(), w_ij * wz[k], q_ij), wz[k], c_ij), w_ij * dwz[k], c2)
                    add(grid, o, k, one, r)
                    q_ij = plus(q_ij, one, a2)

    @wp.func(module="unique")
    def gather(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3
    ):  # fmt: skip
        """Σ w row, Σ w row i and Σ row ∂w for each axis."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        s, m0, m1, m2 = node_t(), node_t(), node_t(), node_t()
        g0, g1, g2 = node_t(), node_t(), node_t()
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                t, u, m, d = wx[i] * wy[j], node_t(), node_t(), node_t()
                for k in range(wp.static(K)):
                    r = take(grid, o, k)
                    u = plus(u, wz[k], r)
                    m = plus(m, wp.static(real(k)) * wz[k], r)
                    d = plus(d, dwz[k], r)
                s, m2, g2 = plus(s, t, u), plus(m2, t, m), plus(g2, t, d)
                m0, m1 = plus(m0, wp.static(real(i)) * t, u), plus(m1, wp.static(real(j)) * t, u)
                g0, g1 = plus(g0, dwx[i] * wy[j], u), plus(g1, wx[i] * dwy[j], u)
        return s, m0, m1, m2, g0, g1, g2

    return {"scatter": scatter, "gather": gather}
