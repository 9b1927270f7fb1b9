"""MPM on the grid: reflect, divide by mass, sharpen, obstacles, walls.

    reflect    q_i ← Σ_R σ_R q_R(i),  likewise f; m_i ← Σ_R m_R(i)                      R: mirror planes, and none
    divide     v⁰_i = q_i/m_i,  a_i = f_i/m_i + k σ g
    hold       c_i = Π_i a_i, what walls that always hold leave of it                   see ``boundary.kernels_hold``
    sharpen    a*_i = a_i + (S c)_i / m_i                                               see ``sharpen``
    stop       u_i = v⁰_i + a*_i, or the velocity of held matter that stops the node    see ``obstacle``
    walls      v_i = contact(u_i)

A mirror plane at nodes k⁰ sends node k⁰ + d to k⁰ − d; σ turns the normal component around, on a sticky wall every
component. Where no node reads another all of it is one pass.

A body that rests against a wall has a ≠ 0 at its nodes, its pressure, which the wall takes up; sharpened as it is, a
part of it would reach the next nodes, where nothing takes it up. Hence S acts on c, and momentum is kept as before. Of
a node behind a mirror plane Π is that of the node in front of it, and of a node that is one piece with held matter
Π = 0. Walls that separate are left out, and so is what only lies against held matter: which nodes touch is known only
after the step.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.boundary import DAMPING, make_contact, make_hold
from diffuphy.mpm.substep.mirror import make_reflection
from diffuphy.mpm.substep.obstacle import JOINED, make_obstacle
from diffuphy.mpm.substep.places import make_places
from diffuphy.mpm.substep.sharpen import make_sharpening
from diffuphy.mpm.substep.variant import Variant


def make_nodes(variant: Variant) -> SimpleNamespace:
    """The kernels ``divide``, of two passes the first, and ``move``. Cached."""
    return variant.made(_make_nodes)


def _make_nodes(v: Variant) -> SimpleNamespace:
    return SimpleNamespace(divide=_make_divide(v), move=_make_move(v))


def _make_divide(v: Variant) -> wp.Kernel:
    real, vec3, node_t, step_t, mirror = v.real, v.vec3, v.node_t, v.step_t, v.mirror
    sparse, loads, left, wall_t = v.sparse, v.loads, make_left(v).left, make_contact(v.walls, real).wall_t
    obstructs, pin_of = v.obstructs, make_obstacle(v).pin
    reflection, index = make_reflection(v), make_places().index
    summed, folded, seen = reflection.summed, reflection.folded, reflection.seen

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
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        row: wp.array2d[wall_t],  # (steps, walls)  only with walls that are held
        sdf: wp.array[real],
        ws: wp.int32,  # row of this step
        dx: real,
        pins: wp.array[node_t],  # (scenes · lanes · nodes,) what held matter leaves, only with some
        acc: wp.array[node_t],  # (scenes · nodes,) v⁰ [m/s], mass [kg], velocity change c [m/s], distance [Δx]   out
        load: wp.array[node_t],  # the same with the velocity change a   out, only where c may differ from it
        pin: wp.array[node_t],  # (scenes · nodes,) velocity of held matter, what the node is to it   out
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
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
        if wp.static(obstructs):
            pin[o] = pin_of(pins, m, o - scene * nodes, at, n, scene, lanes, low, high, sticky)
        if m > real(0.0):
            q = node_t(r[0] / m, r[1] / m, r[2] / m, m, r[4] / m + g[0], r[5] / m + g[1], r[6] / m + g[2], r[7] / m)
            if wp.static(loads):
                load[o] = q
                c = left(vec3(q[4], q[5], q[6]), at, low, high, sticky, dx, row, sdf, ws)
                if wp.static(obstructs):
                    if pin[o][7] == real(JOINED):
                        c = vec3()
                q = node_t(q[0], q[1], q[2], m, c[0], c[1], c[2], q[7])
            acc[o] = q
        else:
            acc[o] = node_t()
            if wp.static(loads):
                load[o] = node_t()

    return divide


def make_left(v: Variant) -> SimpleNamespace:
    """Warp functions ``left``, Π a of a node, and ``left_adjoint``, Πᵀ. Cached."""
    return v.made(_make_left)


def _make_left(v: Variant) -> SimpleNamespace:
    return SimpleNamespace(left=_make_held(v, v.held), left_adjoint=_make_held(v, v.held[::-1]))


def _make_held(v: Variant, which: tuple[int, ...]) -> wp.Function:
    real, vec3, mirror = v.real, v.vec3, v.mirror
    hold, front, wall_t = make_hold(v.walls, which, real), make_reflection(v).front, make_contact(v.walls, real).wall_t

    @wp.func(module="unique")
    def held(
        a: vec3, at: wp.vec3i, low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i,
        dx: real, row: wp.array2d[wall_t], sdf: wp.array[real], ws: wp.int32,
    ) -> vec3:  # fmt: skip
        sign = vec3(real(1.0), real(1.0), real(1.0))
        if wp.static(mirror):
            at, sign = front(at, low, high, sticky)
        place = dx * vec3(real(at[0]), real(at[1]), real(at[2]))
        return wp.cw_mul(sign, hold(wp.cw_mul(sign, a), place, row, sdf, ws))

    return held


@lru_cache
def make_free(v: Variant) -> wp.Function:
    """Warp function: velocity of a node before obstacles and walls, after the first pass."""
    vec3, node_t, sharpen, loads = v.vec3, v.node_t, v.scheme.sharpen, v.loads
    sharpened = make_sharpening(v).sharpened if sharpen else None

    @wp.func(module="unique")
    def free(
        acc: wp.array[node_t], load: wp.array[node_t], sigma: wp.array[node_t],
        o: wp.int32, base: wp.int32, at: wp.vec3i, n: wp.vec3i,
    ) -> vec3:  # fmt: skip
        a = acc[o]
        if wp.static(loads):
            a = load[o]
        u = vec3(a[0] + a[4], a[1] + a[5], a[2] + a[6])
        if wp.static(sharpen):
            u += sharpened(acc, acc, sigma, base, at, n) / a[3]
        return u

    return free


def _make_move(v: Variant) -> wp.Kernel:
    real, vec3, node_t, step_t = v.real, v.vec3, v.node_t, v.step_t
    contact, index, summed = make_contact(v.walls, real, v.scheme.order), make_places().index, make_reflection(v).summed
    apply, wall_t, has_walls = contact.apply, contact.wall_t, len(v.walls) > 0
    two_passes, measures, mirror, free = v.two_passes, v.measures, v.mirror, make_free(v)
    elastic, vec4, damping = v.elastic, wp.types.vector(4, real), real(2.0 * DAMPING)
    sparse, obstructs, stops = v.sparse, v.obstructs, make_obstacle(v).stops

    @wp.kernel(module="unique", enable_backward=False)
    def move(
        grid: wp.array[node_t],  # momentum, mass, impulse   in, and cleared for the next step
        pins: wp.array[node_t],  # cleared for the next step, only with held matter
        lanes: wp.int32,
        acc: wp.array[node_t],  # of ``divide``; in one pass unused
        load: wp.array[node_t],  # likewise
        pin: wp.array[node_t],  # likewise
        sigma: wp.array[node_t],  # of ``cells``, with sharpening
        row: wp.array2d[wall_t],  # (steps, walls)
        sdf: wp.array[real],
        ws: wp.int32,  # row of this step
        n: wp.vec3i,
        dx: real,
        gravity: vec3,
        steps: wp.array[step_t],
        s: wp.int32,
        start: wp.int32,
        active: wp.array[wp.int32],  # rows that are worked on, only if sparse
        grid_v: wp.array[node_t],  # (scenes · nodes,) velocity after the step and before it   out
        impulse: wp.array[vec3],  # (scenes · nodes,) [N s] of obstacles and walls   in and out, only if measured
    ):
        o = start + wp.tid()
        if wp.static(sparse):
            o = active[o]
        nodes = n[0] * n[1] * n[2]
        scene = o // nodes
        base = scene * nodes
        r, m = node_t(), real(0.0)
        if wp.static(obstructs):
            for lane in range(lanes):
                pins[(scene * lanes + lane) * nodes + o - base] = node_t()
        if wp.static((measures and mirror) or not two_passes):
            r = summed(grid, o - base, scene, lanes, nodes)
            m = r[3]
        if wp.static(two_passes):
            m = acc[o][3]
        if m > real(0.0):
            at = index(o - base, n)
            g = steps[s][1] * gravity
            u, v0 = vec3(), vec3()
            if wp.static(two_passes):
                a = acc[o]
                v0 = vec3(a[0], a[1], a[2])
                u = free(acc, load, sigma, o, base, at, n)
            else:
                v0 = vec3(r[0], r[1], r[2]) / m
                u = v0 + vec3(r[4], r[5], r[6]) / m + g
            before = u
            if wp.static(obstructs):
                q = pin[o]
                if stops(u, q, acc, base, at, n):
                    u = vec3(q[0], q[1], q[2])
            if wp.static(has_walls):
                e = vec4()
                if wp.static(elastic):
                    w2 = steps[s][3]
                    e = vec4(acc[o][7], steps[s][1] * w2, damping * steps[s][1] * wp.sqrt(w2), dx)
                u = apply(u, dx * vec3(real(at[0]), real(at[1]), real(at[2])), e, row, sdf, ws)
            grid_v[o] = node_t(u[0], u[1], u[2], real(0.0), v0[0], v0[1], v0[2], real(0.0))
            if wp.static(measures and mirror):  # all that changes the momentum but stress and gravity
                alpha = steps[s][2]
                mv, force = vec3(r[0], r[1], r[2]), vec3(r[4], r[5], r[6])
                impulse[o] = impulse[o] + (r[3] * (u - alpha * v0 - g) - (real(1.0) - alpha) * mv - force)
            elif wp.static(measures):
                impulse[o] = impulse[o] + m * (u - before)
            for lane in range(lanes):
                grid[(scene * lanes + lane) * nodes + o - base] = node_t()

    return move
