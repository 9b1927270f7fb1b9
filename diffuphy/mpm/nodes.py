"""MPM on the grid: reflect, divide by mass, sharpen, walls.

    reflect    q_i ← Σ_R σ_R q_R(i),  likewise f; m_i ← Σ_R m_R(i)                      R: mirror planes, and none
    divide     v⁰_i = q_i/m_i,  a_i = f_i/m_i + k σ g
    sharpen    a*_i = a_i + (S a)_i / m_i
    walls      v_i = contact(v⁰_i + a*_i)

A mirror plane at nodes k⁰ sends node k⁰ + d to k⁰ − d; σ turns the normal component around, on a sticky wall every
component. S = edges + cells is symmetric and needs no boundary condition at a free surface,

    edge i–j along axis x (each axis its own component only)   F = s min(m_i, m_j) (a_i − a_j)_x,  on i: +F, on j: −F
    cell with corners r, one-point gradient s_r = ±¼           G = Σ a_r s_rᵀ,  σ = G + Gᵀ − tr G I − diag G,
                                                               on r: s min_r(m_r) σ s_r

together −s Δx² Δa where the mass is even, made of central forces and a symmetric stress: it keeps momentum and angular
momentum to rounding. It takes the kinetic energy m D |C|²/2 of the affine field out of the inertia of a mode.
"""

from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.boundary import make_contact
from diffuphy.mpm.variant import Variant

REACH = 2
"""Nodes on either side of a mirror plane that are reflected."""


def make_nodes(variant: Variant) -> SimpleNamespace:
    """The kernels ``divide``, ``cells`` and ``move`` of a substep, and the Warp functions they share with their
    adjoints. Cached."""
    return variant.made(_make_nodes)


def _make_nodes(v: Variant) -> SimpleNamespace:
    parts = _make_place()
    folds, cells = _make_folds(v, parts), _make_stencil(v, parts)
    kernels = {"divide": _make_divide(v, parts, folds), "move": _make_move(v, parts, folds, cells)}
    if v.scheme.sharpen:
        kernels["cells"] = cells.cells
    return SimpleNamespace(**vars(parts), **vars(folds), **vars(cells) | kernels)


def _make_place() -> SimpleNamespace:
    @wp.func(module="unique")
    def index(o: wp.int32, n: wp.vec3i) -> wp.vec3i:
        """Indices of a node along the axes."""
        yz = n[1] * n[2]
        i = o // yz
        j = (o - i * yz) // n[2]
        return wp.vec3i(i, j, o - i * yz - j * n[2])

    @wp.func(module="unique")
    def flat(i: wp.int32, j: wp.int32, k: wp.int32, n: wp.vec3i) -> wp.int32:
        """Row of a node, −1 outside of the block."""
        if i < 0 or j < 0 or k < 0 or i >= n[0] or j >= n[1] or k >= n[2]:
            return -1
        return (i * n[1] + j) * n[2] + k

    return SimpleNamespace(index=index, flat=flat)


def _make_folds(v: Variant, parts: SimpleNamespace) -> SimpleNamespace:
    """Sums over lanes and mirror images."""
    real, vec3, node_t, wide = v.real, v.vec3, v.node_t, v.wide
    flat, reach = parts.flat, REACH

    @wp.func(module="unique")
    def summed(grid: wp.array[node_t], o: wp.int32, scene: wp.int32, lanes: wp.int32, nodes: wp.int32) -> node_t:
        """Row of a node of a scene, over the lanes that particles were scattered into."""
        r = grid[scene * lanes * nodes + o]
        for lane in range(1, lanes):
            r += grid[(scene * lanes + lane) * nodes + o]
        return r

    @wp.func(module="unique")
    def image(i: wp.int32, low: wp.int32, high: wp.int32) -> wp.int32:
        """Where a mirror plane sends a node, −1 if none is near."""
        if wp.abs(i - low) <= reach:
            return 2 * low - i
        if wp.abs(i - high) <= reach:
            return 2 * high - i
        return -1

    @wp.func(module="unique")
    def signed(r: node_t, sign: vec3) -> node_t:
        """Momentum and force turned around."""
        if wp.static(wide):
            return node_t(
                sign[0] * r[0], sign[1] * r[1], sign[2] * r[2], r[3],
                sign[0] * r[4], sign[1] * r[5], sign[2] * r[6], r[7],
            )  # fmt: skip
        else:
            return node_t(sign[0] * r[0], sign[1] * r[1], sign[2] * r[2], r[3])

    @wp.func(module="unique")
    def odd(axis: wp.int32, sticky: wp.int32) -> vec3:
        """−1 for the components that a mirror plane turns around."""
        one = real(1.0)
        if sticky != 0:
            return vec3(-one, -one, -one)
        sign = vec3(one, one, one)
        sign[axis] = -one
        return sign

    @wp.func(module="unique")
    def folded(
        grid: wp.array[node_t], at: wp.vec3i, n: wp.vec3i, scene: wp.int32, lanes: wp.int32,
        low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i,
    ) -> node_t:  # fmt: skip
        """Σ over the images of a node, itself included; a corner has up to seven."""
        nodes = n[0] * n[1] * n[2]
        total = summed(grid, (at[0] * n[1] + at[1]) * n[2] + at[2], scene, lanes, nodes)
        to = wp.vec3i(image(at[0], low[0], high[0]), image(at[1], low[1], high[1]), image(at[2], low[2], high[2]))
        if to[0] < 0 and to[1] < 0 and to[2] < 0:
            return total
        for c in range(1, 8):
            x, y, z = c & 1, (c >> 1) & 1, (c >> 2) & 1
            if (x == 0 or to[0] >= 0) and (y == 0 or to[1] >= 0) and (z == 0 or to[2] >= 0):
                i, j, k = at[0], at[1], at[2]
                sign = vec3(real(1.0), real(1.0), real(1.0))
                if x == 1:
                    i = to[0]
                    sign = wp.cw_mul(sign, odd(0, sticky[0]))
                if y == 1:
                    j = to[1]
                    sign = wp.cw_mul(sign, odd(1, sticky[1]))
                if z == 1:
                    k = to[2]
                    sign = wp.cw_mul(sign, odd(2, sticky[2]))
                o = flat(i, j, k, n)
                if o >= 0:
                    total += signed(summed(grid, o, scene, lanes, nodes), sign)
        return total

    @wp.func(module="unique")
    def side(i: wp.int32, low: wp.int32, high: wp.int32) -> real:
        """1 in front of the mirror planes of an axis, 0 on them, −1 behind."""
        if i == low or i == high:
            return real(0.0)
        if i < low or i > high:
            return real(-1.0)
        return real(1.0)

    @wp.func(module="unique")
    def seen(g: vec3, at: wp.vec3i, low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i) -> vec3:
        """A uniform acceleration as its mirror images make it at a node."""
        for axis in range(3):
            q = side(at[axis], low[axis], high[axis])
            if sticky[axis] != 0:
                g = q * g
            else:
                g[axis] = q * g[axis]
        return g

    return SimpleNamespace(summed=summed, folded=folded, seen=seen)


def _make_stencil(v: Variant, parts: SimpleNamespace) -> SimpleNamespace:
    """The two halves of S: σ of every cell, and what edges and cells do to a node."""
    if not v.scheme.sharpen:
        return SimpleNamespace()
    real, vec3, node_t, cell_t = v.real, v.vec3, v.node_t, v.cell_t
    mat33, flat, index = v.mat33, parts.flat, parts.index
    strength = real(v.scheme.sharpening)

    @wp.func(module="unique")
    def corner(c: wp.int32) -> vec3:
        """s_r of a corner: +¼ on the upper side of an axis, −¼ on the lower."""
        q = real(0.25)
        return vec3(
            q * real(2 * (c & 1) - 1), q * real(2 * ((c >> 1) & 1) - 1), q * real(2 * ((c >> 2) & 1) - 1)
        )  # fmt: skip

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
    def packed(G: mat33, w: real) -> cell_t:
        """w σ as xx, yy, zz, yz, zx, xy."""
        t = wp.trace(G)
        return cell_t(
            w * (G[0, 0] - t), w * (G[1, 1] - t), w * (G[2, 2] - t),
            w * (G[1, 2] + G[2, 1]), w * (G[2, 0] + G[0, 2]), w * (G[0, 1] + G[1, 0]),
            real(0.0), real(0.0),
        )  # fmt: skip

    @wp.kernel(module="unique", enable_backward=False)
    def cells(
        acc: wp.array[node_t],  # velocity, mass, acceleration
        n: wp.vec3i,
        start: wp.int32,
        sigma: wp.array[cell_t],  # s min_r(m_r) σ of the cell above each node   out
    ):
        o = start + wp.tid()
        nodes = n[0] * n[1] * n[2]
        base = (o // nodes) * nodes
        at = index(o - base, n)
        least, _who = lightest(acc, base, at, n)
        if least > real(0.0):
            sigma[o] = packed(gradient(acc, base, at, n, 4), least * strength)
        else:
            sigma[o] = cell_t()

    @wp.func(module="unique")
    def sharpened(
        acc: wp.array[node_t], a: wp.array[node_t], sigma: wp.array[cell_t], base: wp.int32, at: wp.vec3i, n: wp.vec3i
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
                step = 2 * side - 1
                i, j, k = at[0], at[1], at[2]
                if axis == 0:
                    i = i + step
                if axis == 1:
                    j = j + step
                if axis == 2:
                    k = k + step
                nb = flat(i, j, k, n)
                if nb >= 0:
                    total[axis] = total[axis] + edge * wp.min(m, acc[base + nb][3]) * (
                        own[4 + axis] - a[base + nb][4 + axis]
                    )
        return total

    return SimpleNamespace(
        cells=cells, sharpened=sharpened, corner=corner, gradient=gradient, lightest=lightest, packed=packed
    )


def _make_divide(v: Variant, parts: SimpleNamespace, folds: SimpleNamespace) -> wp.Kernel:
    real, vec3, node_t, step_t, wide, mirror = v.real, v.vec3, v.node_t, v.step_t, v.wide, v.mirror
    index, summed, folded, seen = parts.index, folds.summed, folds.folded, folds.seen

    @wp.kernel(module="unique", enable_backward=False)
    def divide(
        grid: wp.array[node_t],  # (scenes · lanes · nodes,) momentum, mass, impulse
        lanes: wp.int32,
        n: wp.vec3i,
        gravity: vec3,  # [m/s²]
        steps: wp.array[step_t],
        s: wp.int32,
        low: wp.vec3i,  # mirror planes, far away where there are none
        high: wp.vec3i,
        sticky: wp.vec3i,
        start: wp.int32,
        acc: wp.array[node_t],  # (scenes · nodes,) velocity [m/s], mass [kg], velocity change [m/s]   out
    ):
        o = start + wp.tid()
        nodes = n[0] * n[1] * n[2]
        scene = o // nodes
        at = index(o - scene * nodes, n)
        g = steps[s][1] * gravity
        if wp.static(mirror):
            r = folded(grid, at, n, scene, lanes, low, high, sticky)
            g = seen(g, at, low, high, sticky)
        else:
            r = summed(grid, o - scene * nodes, scene, lanes, nodes)
        m = r[3]
        if m > real(0.0):
            if wp.static(wide):
                acc[o] = node_t(
                    r[0] / m, r[1] / m, r[2] / m, m, r[4] / m + g[0], r[5] / m + g[1], r[6] / m + g[2], real(0.0)
                )
            else:
                acc[o] = node_t(r[0] / m + g[0], r[1] / m + g[1], r[2] / m + g[2], m)
        else:
            acc[o] = node_t()

    return divide


def _make_move(v: Variant, parts: SimpleNamespace, folds: SimpleNamespace, cells: SimpleNamespace) -> wp.Kernel:
    """Both passes in one where no node reads another."""
    real, vec3, node_t, cell_t, step_t, wide = v.real, v.vec3, v.node_t, v.cell_t, v.step_t, v.wide
    contact, index, summed = make_contact(v.walls, real), parts.index, folds.summed
    apply, wall_t, has_walls = contact.apply, contact.wall_t, len(v.walls) > 0
    one_pass, sharpen, measures = not v.two_passes, v.scheme.sharpen, v.measures
    sharpened = cells.sharpened if sharpen else None

    @wp.func(module="unique")
    def free(
        acc: wp.array[node_t], sigma: wp.array[cell_t], o: wp.int32, base: wp.int32, at: wp.vec3i, n: wp.vec3i
    ) -> vec3:  # fmt: skip
        """Velocity of a node before the walls."""
        a = acc[o]
        u = vec3(a[0], a[1], a[2])
        if wp.static(wide):
            u += vec3(a[4], a[5], a[6])
        if wp.static(sharpen):
            u += sharpened(acc, acc, sigma, base, at, n) / a[3]
        return u

    cells.free = free

    @wp.kernel(module="unique", enable_backward=False)
    def move(
        grid: wp.array[node_t],  # momentum, mass, impulse   in, and cleared for the next step
        lanes: wp.int32,
        acc: wp.array[node_t],  # of ``divide``; in one pass unused
        sigma: wp.array[cell_t],  # of ``cells``, with sharpening
        row: wp.array2d[wall_t],  # (steps, walls)
        sdf: wp.array[real],
        ws: wp.int32,  # row of this step
        n: wp.vec3i,
        dx: real,
        gravity: vec3,
        steps: wp.array[step_t],
        s: wp.int32,
        start: wp.int32,
        grid_v: wp.array[node_t],  # (scenes · nodes,) velocity after the step and, wide, before it   out
        impulse: wp.array[vec3],  # (scenes · nodes,) [N s] of the walls   in and out, only if measured
    ):
        o = start + wp.tid()
        nodes = n[0] * n[1] * n[2]
        scene = o // nodes
        base = scene * nodes
        r = node_t()
        m = real(0.0)
        if wp.static(one_pass or measures):
            r = summed(grid, o - base, scene, lanes, nodes)
            m = r[3]
        if wp.static(not one_pass):
            m = acc[o][3]
        if m > real(0.0):
            at = index(o - base, n)
            if wp.static(one_pass):
                u = vec3(r[0] / m, r[1] / m, r[2] / m) + steps[s][1] * gravity
            else:
                u = free(acc, sigma, o, base, at, n)
            v0 = u
            if wp.static(has_walls):
                u = apply(u, dx * vec3(real(at[0]), real(at[1]), real(at[2])), row, sdf, ws)
            if wp.static(wide):
                a = acc[o]
                grid_v[o] = node_t(u[0], u[1], u[2], real(0.0), a[0], a[1], a[2], real(0.0))
            else:
                grid_v[o] = node_t(u[0], u[1], u[2], real(0.0))
            if wp.static(measures):
                if wp.static(one_pass):
                    impulse[o] = impulse[o] + m * (u - v0)
                else:
                    q = vec3(r[0], r[1], r[2])
                    if wp.static(wide):
                        q += vec3(r[4], r[5], r[6])
                    impulse[o] = impulse[o] + (r[3] * (u - steps[s][1] * gravity) - q)
            for lane in range(lanes):
                grid[(scene * lanes + lane) * nodes + o - base] = node_t()

    return move
