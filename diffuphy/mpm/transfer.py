"""Between one particle and the nodes around it: scatter, gather, and the adjoints of both.

A particle brings to node i an affine row of numbers, and in the classic form its stress by the gradient of the weight,

    scatter   row_i += w_i (q + A d_i) + B ∇w_i
    gather    Σ_i w_i row_i,   Σ_i w_i row_i ⊗ d_i,   and in the classic form Σ_i row_i ⊗ ∇w_i

with d_i counted in cells from the lowest node (the particle is at f there) and ∇ per cell. A row is eight numbers:
momentum, mass, what the step adds to the momentum, –; or velocity after the step, –, velocity before it, –. Eight are
a vector register, and faster than four. Functions are made for each degree and form of force; columns of A and B are
rows.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.spline import make_spline


@lru_cache
def make_transfer(scheme: Scheme, real: type) -> SimpleNamespace:
    """``scatter``, ``gather``, ``scatter_adjoint``, ``gather_adjoint`` and ``node_t`` of one scheme."""
    spline = make_spline(real, scheme.order)
    node_t = wp.types.vector(8, real)
    parts = (_make_classic if scheme.force == "classic" else _make_affine)(spline, node_t, real, scheme.order)
    return SimpleNamespace(node_t=node_t, spline=spline, **parts)


def _make_affine(spline: SimpleNamespace, node_t: type, real: type, order: int) -> dict[str, wp.Function]:
    """Moments only; the loop along z is innermost, over neighbours in memory."""
    vec3 = wp.types.vector(3, real)
    weights, slopes = spline.weights, spline.slopes
    K = order + 1

    @wp.func(module="unique")
    def kept(n: wp.vec3i, s: node_t, m0: node_t, m1: node_t, m2: node_t):
        """The same. A place in memory that is not known beforehand keeps compilers from taking the sums apart into
        single numbers, which on a CPU makes a gather half as fast."""
        rows = wp.zeros(shape=(4,), dtype=node_t)
        first = wp.min(n[0], 0)
        rows[first] = s
        rows[first + 1] = m0
        rows[first + 2] = m1
        rows[first + 3] = m2
        return rows[0], rows[1], rows[2], rows[3]

    @wp.func(module="unique")
    def scatter(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, a0: node_t, a1: node_t, a2: node_t,
    ):  # fmt: skip
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                w_ij = wx[i] * wy[j]
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                for k in range(wp.static(K)):
                    wp.atomic_add(grid, o + k, (w_ij * wz[k]) * (q_ij + wp.static(real(k)) * a2))

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
                t = wz[0] * grid[o]
                z = node_t()
                for k in range(1, wp.static(K)):
                    r = wz[k] * grid[o + k]
                    t += r
                    z += wp.static(real(k)) * r
                a += wy[j] * t
                b += (wp.static(real(j)) * wy[j]) * t
                c += wy[j] * z
            s += wx[i] * a
            m0 += (wp.static(real(i)) * wx[i]) * a
            m1 += wx[i] * b
            m2 += wx[i] * c
        return kept(n, s, m0, m1, m2)

    @wp.func(module="unique")
    def scatter_adjoint(
        bar: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, a0: node_t, a1: node_t, a2: node_t,
    ):  # fmt: skip
        """What the nodes return: Σ w r̄, its moments, and Σ (r̄·row) ∂w."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        s, m0, m1, m2, along = node_t(), node_t(), node_t(), node_t(), vec3()
        for i in range(wp.static(K)):
            a, b, c = node_t(), node_t(), node_t()
            for j in range(wp.static(K)):
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                s_w, s_d, t, z = real(0.0), real(0.0), node_t(), node_t()
                for k in range(wp.static(K)):
                    g = bar[o + k]
                    d = wp.dot(g, q_ij + wp.static(real(k)) * a2)
                    s_w += wz[k] * d
                    s_d += dwz[k] * d
                    r = wz[k] * g
                    t += r
                    z += wp.static(real(k)) * r
                along += vec3(dwx[i] * wy[j] * s_w, wx[i] * dwy[j] * s_w, wx[i] * wy[j] * s_d)
                a += wy[j] * t
                b += (wp.static(real(j)) * wy[j]) * t
                c += wy[j] * z
            s += wx[i] * a
            m0 += (wp.static(real(i)) * wx[i]) * a
            m1 += wx[i] * b
            m2 += wx[i] * c
        s, m0, m1, m2 = kept(n, s, m0, m1, m2)
        return s, m0, m1, m2, along

    @wp.func(module="unique")
    def gather_adjoint(
        grid: wp.array[node_t], base: wp.int32,
        bar: wp.array[node_t], lane: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, b0: node_t, b1: node_t, b2: node_t,
    ):  # fmt: skip
        """Adds w (q + B d) to the bars of the nodes; Σ w row and Σ (row · (q + B d)) ∂w."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        s, along = node_t(), vec3()
        for i in range(wp.static(K)):
            a = node_t()
            for j in range(wp.static(K)):
                w_ij = wx[i] * wy[j]
                q_ij = q + wp.static(real(i)) * b0 + wp.static(real(j)) * b1
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                s_w, s_d, t = real(0.0), real(0.0), node_t()
                for k in range(wp.static(K)):
                    h = q_ij + wp.static(real(k)) * b2
                    r = grid[base + o + k]
                    wp.atomic_add(bar, lane + o + k, (w_ij * wz[k]) * h)
                    d = wp.dot(r, h)
                    s_w += wz[k] * d
                    s_d += dwz[k] * d
                    t += wz[k] * r
                along += vec3(dwx[i] * wy[j] * s_w, wx[i] * dwy[j] * s_w, w_ij * s_d)
                a += wy[j] * t
            s += wx[i] * a
        return s, along

    return {
        "scatter": scatter, "gather": gather, "scatter_adjoint": scatter_adjoint, "gather_adjoint": gather_adjoint
    }  # fmt: skip


def _make_classic(spline: SimpleNamespace, node_t: type, real: type, order: int) -> dict[str, wp.Function]:
    """As the affine functions, with columns g0, g1, g2 (here c0, c1, c2) that act on ∇w."""
    vec3 = wp.types.vector(3, real)
    weights, slopes, curvatures = spline.weights, spline.slopes, spline.curvatures
    K = order + 1

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
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                c_ij = (dwx[i] * wy[j]) * c0 + (wx[i] * dwy[j]) * c1
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                for k in range(wp.static(K)):
                    r = (w_ij * wz[k]) * (q_ij + wp.static(real(k)) * a2) + wz[k] * c_ij + (w_ij * dwz[k]) * c2
                    wp.atomic_add(grid, o + k, r)

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
                    r = grid[o + k]
                    u += wz[k] * r
                    m += wp.static(real(k)) * wz[k] * r
                    d += dwz[k] * r
                s += t * u
                m0 += (wp.static(real(i)) * t) * u
                m1 += (wp.static(real(j)) * t) * u
                m2 += t * m
                g0 += (dwx[i] * wy[j]) * u
                g1 += (wx[i] * dwy[j]) * u
                g2 += t * d
        return s, m0, m1, m2, g0, g1, g2

    @wp.func(module="unique")
    def scatter_adjoint(
        bar: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, a0: node_t, a1: node_t, a2: node_t, c0: node_t, c1: node_t, c2: node_t,
    ):  # fmt: skip
        """Σ w r̄, its moments, Σ r̄ ∂w for each axis, and the derivative of Σ r̄·row along each axis."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        ex, ey, ez = curvatures(f[0]), curvatures(f[1]), curvatures(f[2])
        s, m0, m1, m2, along = node_t(), node_t(), node_t(), node_t(), vec3()
        g0, g1, g2 = node_t(), node_t(), node_t()
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
                w, p0, p1 = wx[i] * wy[j], dwx[i] * wy[j], wx[i] * dwy[j]
                p00, p11, p01 = ex[i] * wy[j], wx[i] * ey[j], dwx[i] * dwy[j]
                for k in range(wp.static(K)):
                    g = bar[o + k]
                    d, e0, e1, e2 = (
                        wp.dot(g, q_ij + wp.static(real(k)) * a2),
                        wp.dot(g, c0),
                        wp.dot(g, c1),
                        wp.dot(g, c2),
                    )
                    z, dz = wz[k], dwz[k]
                    along += vec3(
                        p0 * z * d + p00 * z * e0 + p01 * z * e1 + p0 * dz * e2,
                        p1 * z * d + p01 * z * e0 + p11 * z * e1 + p1 * dz * e2,
                        w * dz * d + p0 * dz * e0 + p1 * dz * e1 + w * ez[k] * e2,
                    )
                    r = (w * z) * g
                    s += r
                    m0 += wp.static(real(i)) * r
                    m1 += wp.static(real(j)) * r
                    m2 += wp.static(real(k)) * r
                    g0 += (p0 * z) * g
                    g1 += (p1 * z) * g
                    g2 += (w * dz) * g
        return s, m0, m1, m2, g0, g1, g2, along

    @wp.func(module="unique")
    def gather_adjoint(
        grid: wp.array[node_t], base: wp.int32,
        bar: wp.array[node_t], lane: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        q: node_t, b0: node_t, b1: node_t, b2: node_t, c0: node_t, c1: node_t, c2: node_t,
    ):  # fmt: skip
        """Adds w (q + B d) + G ∇w to the bars of the nodes; Σ w row and the derivative of the sum along each axis."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        ex, ey, ez = curvatures(f[0]), curvatures(f[1]), curvatures(f[2])
        s, along = node_t(), vec3()
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                q_ij = q + wp.static(real(i)) * b0 + wp.static(real(j)) * b1
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                w, p0, p1 = wx[i] * wy[j], dwx[i] * wy[j], wx[i] * dwy[j]
                p00, p11, p01 = ex[i] * wy[j], wx[i] * ey[j], dwx[i] * dwy[j]
                for k in range(wp.static(K)):
                    h = q_ij + wp.static(real(k)) * b2
                    r = grid[base + o + k]
                    z, dz = wz[k], dwz[k]
                    wp.atomic_add(bar, lane + o + k, (w * z) * h + (p0 * z) * c0 + (p1 * z) * c1 + (w * dz) * c2)
                    d, e0, e1, e2 = wp.dot(r, h), wp.dot(r, c0), wp.dot(r, c1), wp.dot(r, c2)
                    along += vec3(
                        p0 * z * d + p00 * z * e0 + p01 * z * e1 + p0 * dz * e2,
                        p1 * z * d + p01 * z * e0 + p11 * z * e1 + p1 * dz * e2,
                        w * dz * d + p0 * dz * e0 + p1 * dz * e1 + w * ez[k] * e2,
                    )
                    s += (w * z) * r
        return s, along

    return {
        "scatter": scatter, "gather": gather, "scatter_adjoint": scatter_adjoint, "gather_adjoint": gather_adjoint
    }  # fmt: skip
