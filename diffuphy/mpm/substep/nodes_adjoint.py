"""Adjoint of the passes over the grid, by hand; ``nodes`` has the formulas they belong to.

With bars for ∂loss/∂ and y = g̅/m, g̅ = contactᵀ v̄, zero at nodes that held matter stops,

    walls      v̄⁰ ← v̄⁰ + g̅,  ā* = g̅
    sharpen    c̄ = S y,   m̄ = −(a* − a)·y + Σ_edges,cells (∂weight/∂m) (∇c : ∇y)            S is its own transpose
    hold       ā = g̅ + Πᵀ c̄,   Π = 0 at nodes that are one piece with held matter
    divide     q̄ = v̄⁰/m,  f̄ = ā/m,  m̄ ← m̄ − (v̄⁰·v⁰ + ā·f/m)/m,   ḡ ← ḡ + k Σ σ ā
    reflect    the same reflection
"""

from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.boundary import DAMPING, make_contact
from diffuphy.mpm.substep.mirror import make_reflection
from diffuphy.mpm.substep.nodes import make_free, make_left
from diffuphy.mpm.substep.obstacle import JOINED, make_obstacle
from diffuphy.mpm.substep.places import make_places
from diffuphy.mpm.substep.sharpen import make_sharpening
from diffuphy.mpm.substep.variant import Variant


def make_nodes_adjoint(variant: Variant) -> SimpleNamespace:
    """The kernels ``move_adjoint``, ``cells_adjoint`` (with sharpening), ``divide_adjoint`` and ``reflect`` (with
    mirrors). Cached."""
    return variant.made(_make_nodes_adjoint)


def _make_nodes_adjoint(v: Variant) -> SimpleNamespace:
    kernels = {"move_adjoint": _make_move_adjoint(v), "divide_adjoint": _make_divide_adjoint(v)}
    if v.scheme.sharpen:
        kernels["cells_adjoint"] = make_sharpening(v).cells_adjoint
    if v.mirror:
        kernels["reflect"] = _make_reflect(v)
    return SimpleNamespace(**kernels)


def _make_move_adjoint(v: Variant) -> wp.Kernel:
    real, vec3, node_t = v.real, v.vec3, v.node_t
    contact, index = make_contact(v.walls, real, v.scheme.order), make_places().index
    summed, free = make_reflection(v).summed, make_free(v)
    contact_adjoint, contact_rows, wall_t = contact.adjoint, contact.adjoint_rows, contact.wall_t
    has_walls, elastic, step_t = len(v.walls) > 0, v.elastic, v.step_t
    vec4, damping, half = wp.types.vector(4, real), real(2.0 * DAMPING), real(0.5)
    sparse, obstructs, stops = v.sparse, v.obstructs, make_obstacle(v).stops

    @wp.kernel(module="unique", enable_backward=False)
    def move_adjoint(
        acc: wp.array[node_t],
        load: wp.array[node_t],
        pin: wp.array[node_t],
        sigma: wp.array[node_t],
        bar: wp.array[node_t],  # (scenes · lanes · nodes,) of the velocities after and before the step; cleared
        lanes: wp.int32,
        row: wp.array2d[wall_t],
        sdf: wp.array[real],
        ws: wp.int32,
        n: wp.vec3i,
        dx: real,
        steps: wp.array[step_t],
        s: wp.int32,
        start: wp.int32,
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        y: wp.array[node_t],  # (scenes · nodes,) v̄⁰ + g̅, of the distance to a wall, g̅/m, –   out
        omega_bar: wp.array[real],  # (scenes · nodes,) of ω², with elastic walls   in and out
        row_bar: wp.array2d[wall_t],  # of the wall data   in and out
        need_rows: bool,
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
        nodes = n[0] * n[1] * n[2]
        scene = o // nodes
        base = scene * nodes
        m = acc[o][3]
        if m > real(0.0):
            b = summed(bar, o - base, scene, lanes, nodes)
            g, e_bar = vec3(b[0], b[1], b[2]), vec4()
            stopped = bool(False)
            if wp.static(has_walls or obstructs):
                at = index(o - base, n)
                u = free(acc, load, sigma, o, base, at, n)
            if wp.static(obstructs):
                q = pin[o]
                stopped = stops(u, q, acc, base, at, n)
                if stopped:
                    u = vec3(q[0], q[1], q[2])
            if wp.static(has_walls):
                place = dx * vec3(real(at[0]), real(at[1]), real(at[2]))
                e = vec4()
                if wp.static(elastic):
                    w2 = steps[s][3]
                    e = vec4(acc[o][7], steps[s][1] * w2, damping * steps[s][1] * wp.sqrt(w2), dx)
                if need_rows:
                    g, e_bar = contact_rows(u, place, e, row, sdf, ws, g, row_bar)
                else:
                    g, e_bar = contact_adjoint(u, place, e, row, sdf, ws, g)
                if wp.static(elastic):
                    root = wp.sqrt(steps[s][3])
                    omega_bar[o] = omega_bar[o] + steps[s][1] * (e_bar[1] + half * damping * e_bar[2] / root)
            if stopped:
                g = vec3()
            y[o] = node_t(b[4] + g[0], b[5] + g[1], b[6] + g[2], e_bar[0], g[0] / m, g[1] / m, g[2] / m, real(0.0))
            for lane in range(lanes):
                bar[(scene * lanes + lane) * nodes + o - base] = node_t()
        else:
            y[o] = node_t()

    return move_adjoint


def _make_divide_adjoint(v: Variant) -> wp.Kernel:
    real, vec3, node_t, step_t, mirror, sharpen = v.real, v.vec3, v.node_t, v.step_t, v.mirror, v.scheme.sharpen
    index, seen, sparse = make_places().index, make_reflection(v).seen, v.sparse
    sharpened = make_sharpening(v).sharpened if sharpen else None
    of_mass = make_sharpening(v).of_mass if sharpen else None
    loads, left_adjoint, wall_t = v.loads, make_left(v).left_adjoint, make_contact(v.walls, real).wall_t
    obstructs = v.obstructs

    @wp.kernel(module="unique", enable_backward=False)
    def divide_adjoint(
        acc: wp.array[node_t],
        load: wp.array[node_t],
        pin: wp.array[node_t],
        sigma: wp.array[node_t],  # of c, from ``cells``
        y: wp.array[node_t],
        sigma_y: wp.array[node_t],  # from ``cells_adjoint``
        n: wp.vec3i,
        gravity: vec3,
        steps: wp.array[step_t],
        s: wp.int32,
        low: wp.vec3i,
        high: wp.vec3i,
        sticky: wp.vec3i,
        row: wp.array2d[wall_t],
        sdf: wp.array[real],
        ws: wp.int32,
        dx: real,
        start: wp.int32,
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        out: wp.array[node_t],  # (scenes · nodes,) of momentum, mass and impulse   out
        gravity_bar: wp.array[vec3],  # (scenes · nodes,)   in and out; one row a node, so that no order matters
        need_gravity: bool,
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
        nodes = n[0] * n[1] * n[2]
        base = (o // nodes) * nodes
        a = acc[o]
        b = y[o]
        m = a[3]
        if m > real(0.0):
            at = index(o - base, n)
            kick = steps[s][1]
            g = kick * gravity
            if wp.static(mirror):
                g = seen(g, at, low, high, sticky)
            v0, v0_bar = vec3(a[0], a[1], a[2]), vec3(b[0], b[1], b[2])
            y_o = vec3(b[4], b[5], b[6])
            a_bar, m_bar = m * y_o, real(0.0)
            if wp.static(sharpen):
                c_bar = sharpened(acc, y, sigma_y, base, at, n)
                if wp.static(loads):
                    a = load[o]
                    c_bar = left_adjoint(c_bar, at, low, high, sticky, dx, row, sdf, ws)
                if wp.static(obstructs):
                    if pin[o][7] == real(JOINED):
                        c_bar = vec3()
                a_bar += c_bar
                m_bar = of_mass(acc, y, sigma_y, base, at, n) - wp.dot(sharpened(acc, acc, sigma, base, at, n), y_o) / m
            m_bar -= (wp.dot(v0_bar, v0) + wp.dot(a_bar, vec3(a[4], a[5], a[6]) - g)) / m
            q_bar, f_bar = v0_bar / m, a_bar / m
            phi_bar = b[3] / m
            m_bar -= phi_bar * a[7]
            out[o] = node_t(q_bar[0], q_bar[1], q_bar[2], m_bar, f_bar[0], f_bar[1], f_bar[2], phi_bar)
            if need_gravity:
                if wp.static(mirror):
                    a_bar = seen(a_bar, at, low, high, sticky)
                gravity_bar[o] = gravity_bar[o] + kick * a_bar
        else:
            out[o] = node_t()

    return divide_adjoint


def _make_reflect(v: Variant) -> wp.Kernel:
    node_t, index, folded = v.node_t, make_places().index, make_reflection(v).folded
    sparse = v.sparse

    @wp.kernel(module="unique", enable_backward=False)
    def reflect(
        bar: wp.array[node_t],
        n: wp.vec3i,
        low: wp.vec3i,
        high: wp.vec3i,
        sticky: wp.vec3i,
        start: wp.int32,
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        out: wp.array[node_t],
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
        nodes = n[0] * n[1] * n[2]
        scene = o // nodes
        out[o] = folded(bar, index(o - scene * nodes, n), n, scene, 1, low, high, sticky)

    return reflect
