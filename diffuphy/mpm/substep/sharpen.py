"""Sharpening of the acceleration on the grid: a* = a + S a / m, S = edges + cells.

    edge i–j along axis x (each axis its own component only)   F = s min(m_i, m_j) (a_i − a_j)_x,  on i: +F, on j: −F
    cell with corners r, one-point gradient s_r = ±¼           G = Σ a_r s_rᵀ,  σ = G + Gᵀ − tr G I − diag G,
                                                               on r: s min_r(m_r) σ s_r

together −s Δx² Δa where the mass is even, made of central forces and a symmetric stress: S keeps momentum and angular
momentum to rounding, is its own transpose, and needs no condition at a free surface. It takes the kinetic energy
m D |C|²/2 of the affine field out of the inertia of a mode, which is the whole second-order error of its frequency.
"""

from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.substep.places import make_places
from diffuphy.mpm.substep.variant import Variant


def make_sharpening(v: Variant) -> SimpleNamespace:
    """The two halves of S: kernel ``cells``, σ of every cell, and function ``sharpened``, what edges and cells do to a
    node; kernel ``cells_adjoint`` and function ``of_mass``, the same for the gradient in the masses. Cached."""
    return v.made(_make_sharpening)


def _make_sharpening(v: Variant) -> SimpleNamespace:
    real, vec3, node_t, mat33 = v.real, v.vec3, v.node_t, v.mat33
    flat, index = make_places().flat, make_places().index
    strength, sparse = real(v.scheme.sharpening), v.sparse

    @wp.func(module="unique")
    def corner(c: wp.int32) -> vec3:
        """s_r of a corner: +¼ on the upper side of an axis, −¼ on the lower."""
        q = real(0.25)
        return vec3(
            q * real(2 * (c & 1) - 1), q * real(2 * ((c >> 1) & 1) - 1), q * real(2 * ((c >> 2) & 1) - 1)
        )  # fmt: skip

    @wp.func(module="unique")
    def neighbour(at: wp.vec3i, axis: wp.int32, step: wp.int32, n: wp.vec3i) -> wp.int32:
        """Number of the node at the other end of an edge, ``step`` ±1 along an axis; negative outside the block."""
        i, j, k = at[0], at[1], at[2]
        if axis == 0:
            i = i + step
        if axis == 1:
            j = j + step
        if axis == 2:
            k = k + step
        return flat(i, j, k, n)

    @wp.func(module="unique")
    def gradient(a: wp.array[node_t], base: wp.int32, at: wp.vec3i, n: wp.vec3i, offset: wp.int32) -> mat33:
        """G = Σ_r a_r s_rᵀ of three numbers of each corner, from place ``offset`` of its row on."""
        G = mat33()
        for c in range(8):
            o = base + flat(at[0] + (c & 1), at[1] + ((c >> 1) & 1), at[2] + ((c >> 2) & 1), n)
            r = a[o]
            G += wp.outer(vec3(r[offset], r[offset + 1], r[offset + 2]), corner(c))
        return G

    @wp.func(module="unique")
    def lightest(acc: wp.array[node_t], base: wp.int32, at: wp.vec3i, n: wp.vec3i):
        """Least mass among the corners of a cell, and the corner that has it; 0 on the upper faces of the block."""
        least, who = real(0.0), wp.int32(0)
        if at[0] + 1 < n[0] and at[1] + 1 < n[1] and at[2] + 1 < n[2]:
            least = acc[base + flat(at[0], at[1], at[2], n)][3]
            for c in range(1, 8):
                m = acc[base + flat(at[0] + (c & 1), at[1] + ((c >> 1) & 1), at[2] + ((c >> 2) & 1), n)][3]
                if m < least:
                    least = m
                    who = c
        return least, who

    @wp.func(module="unique")
    def packed(G: mat33, w: real) -> node_t:
        """w σ as xx, yy, zz, yz, zx, xy."""
        t = wp.trace(G)
        return node_t(
            w * (G[0, 0] - t), w * (G[1, 1] - t), w * (G[2, 2] - t),
            w * (G[1, 2] + G[2, 1]), w * (G[2, 0] + G[0, 2]), w * (G[0, 1] + G[1, 0]),
            real(0.0), real(0.0),
        )  # fmt: skip

    @wp.kernel(module="unique", enable_backward=False)
    def cells(
        acc: wp.array[node_t],  # velocity, mass, acceleration
        n: wp.vec3i,
        start: wp.int32,
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        sigma: wp.array[node_t],  # s min_r(m_r) σ of the cell above each node   out
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
        nodes = n[0] * n[1] * n[2]
        base = (o // nodes) * nodes
        at = index(o - base, n)
        least, _who = lightest(acc, base, at, n)
        if least > real(0.0):
            sigma[o] = packed(gradient(acc, base, at, n, 4), least * strength)
        else:
            sigma[o] = node_t()

    @wp.func(module="unique")
    def sharpened(
        acc: wp.array[node_t], a: wp.array[node_t], sigma: wp.array[node_t], base: wp.int32, at: wp.vec3i, n: wp.vec3i
    ) -> vec3:  # fmt: skip
        """(S a)_i of a node, with the masses of ``acc``."""
        o = flat(at[0], at[1], at[2], n)
        m = acc[base + o][3]
        own = a[base + o]
        total = vec3()
        for c in range(8):
            j = flat(at[0] - (c & 1), at[1] - ((c >> 1) & 1), at[2] - ((c >> 2) & 1), n)
            if j >= 0:
                q = sigma[base + j]
                s = corner(c)
                total += vec3(
                    q[0] * s[0] + q[5] * s[1] + q[4] * s[2],
                    q[5] * s[0] + q[1] * s[1] + q[3] * s[2],
                    q[4] * s[0] + q[3] * s[1] + q[2] * s[2],
                )
        edge = strength
        for axis in range(3):
            for side in range(2):
                nb = neighbour(at, axis, 2 * side - 1, n)
                if nb >= 0:
                    total[axis] = total[axis] + edge * wp.min(m, acc[base + nb][3]) * (
                        own[4 + axis] - a[base + nb][4 + axis]
                    )
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def cells_adjoint(
        acc: wp.array[node_t],
        y: wp.array[node_t],
        n: wp.vec3i,
        start: wp.int32,
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        sigma: wp.array[node_t],  # that of y; then s σ(a) : G(y), and 1 + the corner of least mass, whose m̄ it is   out
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
        nodes = n[0] * n[1] * n[2]
        base = (o // nodes) * nodes
        at = index(o - base, n)
        least, who = lightest(acc, base, at, n)
        if least > real(0.0):
            G = gradient(y, base, at, n, 4)
            a = packed(gradient(acc, base, at, n, 4), strength)
            q = packed(G, least * strength)
            q[6] = (
                a[0] * G[0, 0] + a[1] * G[1, 1] + a[2] * G[2, 2]
                + a[3] * (G[1, 2] + G[2, 1]) + a[4] * (G[2, 0] + G[0, 2]) + a[5] * (G[0, 1] + G[1, 0])
            )  # fmt: skip
            q[7] = real(1 + who)
            sigma[o] = q
        else:
            sigma[o] = node_t()

    @wp.func(module="unique")
    def of_mass(
        acc: wp.array[node_t], y: wp.array[node_t], sigma: wp.array[node_t], base: wp.int32, at: wp.vec3i, n: wp.vec3i
    ) -> real:  # fmt: skip
        """Σ over the edges and cells whose least mass is that of this node of ∂(y · S a)/∂m."""
        own = base + flat(at[0], at[1], at[2], n)
        m = acc[own][3]
        total = real(0.0)
        for c in range(8):
            j = flat(at[0] - (c & 1), at[1] - ((c >> 1) & 1), at[2] - ((c >> 2) & 1), n)
            if j >= 0:
                q = sigma[base + j]
                if wp.int32(q[7]) == c + 1:
                    total += q[6]
        for axis in range(3):
            for side in range(2):
                nb = neighbour(at, axis, 2 * side - 1, n)
                if nb >= 0:
                    other = acc[base + nb][3]
                    if m < other or (m == other and side == 1):
                        total += (
                            strength
                            * (acc[own][4 + axis] - acc[base + nb][4 + axis])
                            * (y[own][4 + axis] - y[base + nb][4 + axis])
                        )
        return total

    return SimpleNamespace(cells=cells, sharpened=sharpened, cells_adjoint=cells_adjoint, of_mass=of_mass)
