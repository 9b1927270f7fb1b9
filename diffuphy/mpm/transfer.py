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
    weights, slopes, curvatures, vec_w = spline.weights, spline.slopes, spline.curvatures, spline.vec_w
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
    def line(rows: wp.array[node_t], o: wp.int32, w: vec_w, d: vec_w, e: vec_w):
        """Sums over neighbours in memory: w r, w k r, w' r, w' k r, w'' r."""
        t, m, h, p, q = node_t(), node_t(), node_t(), node_t(), node_t()
        for k in range(wp.static(K)):
            r = rows[o + k]
            t += w[k] * r
            m += (wp.static(real(k)) * w[k]) * r
            h += d[k] * r
            p += (wp.static(real(k)) * d[k]) * r
            q += e[k] * r
        return t, m, h, p, q

    @wp.func(module="unique")
    def slope(
        t: node_t, m: node_t, h: node_t, p: node_t, q: node_t, row: node_t, a2: node_t, c0: node_t, c1: node_t,
        c2: node_t, x: vec3, y: vec3,
    ):  # fmt: skip
        """∂/∂x of Σ_k r·(w (row + k a2) + C ∇w) along a line; x, y: w, w', w'' along the other axes."""
        d, e0, e1, e2 = wp.dot(t, row) + wp.dot(m, a2), wp.dot(t, c0), wp.dot(t, c1), wp.dot(h, c2)
        f = wp.dot(h, row) + wp.dot(p, a2) + wp.dot(q, c2)
        return vec3(
            x[1] * y[0] * (d + e2) + x[2] * y[0] * e0 + x[1] * y[1] * e1,
            x[0] * y[1] * (d + e2) + x[1] * y[1] * e0 + x[0] * y[2] * e1,
            x[0] * y[0] * f + x[1] * y[0] * wp.dot(h, c0) + x[0] * y[1] * wp.dot(h, c1),
        )

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
                t, m, h, k, c = line(bar, base + ((bx + i) * n[1] + by + j) * n[2] + bz, wz, dwz, ez)
                x, y = vec3(wx[i], dwx[i], ex[i]), vec3(wy[j], dwy[j], ey[j])
                along += slope(t, m, h, k, c, q_ij, a2, c0, c1, c2, x, y)
                w = x[0] * y[0]
                s += w * t
                m0 += (wp.static(real(i)) * w) * t
                m1 += (wp.static(real(j)) * w) * t
                m2 += w * m
                g0 += (x[1] * y[0]) * t
                g1 += (x[0] * y[1]) * t
                g2 += w * h
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
        scatter(bar, lane, n, bx, by, bz, f, q, b0, b1, b2, c0, c1, c2)
        for i in range(wp.static(K)):
            for j in range(wp.static(K)):
                q_ij = q + wp.static(real(i)) * b0 + wp.static(real(j)) * b1
                t, m, h, k, c = line(grid, base + ((bx + i) * n[1] + by + j) * n[2] + bz, wz, dwz, ez)
                x, y = vec3(wx[i], dwx[i], ex[i]), vec3(wy[j], dwy[j], ey[j])
                along += slope(t, m, h, k, c, q_ij, b2, c0, c1, c2, x, y)
                s += (x[0] * y[0]) * t
        return s, along

    return {
        "scatter": scatter, "gather": gather, "scatter_adjoint": scatter_adjoint, "gather_adjoint": gather_adjoint
    }  # fmt: skip
