"""What walls do to the velocity of a node, and the adjoint of that, compiled for one list of walls.

A node i with signed distance φ(x_i) ≤ −reach·Δx to the surface belongs to the wall. With the velocity of the surface
S = V + ω × (x_i − c), that relative to it u = v_i − S, u_n = u·n and u_t = u − u_n n (n points out of the wall):

    sticky      u ← 0
    slip        u ← u_t                                          always (bilateral)
    separate    u ← u_t max(0, 1 − μ |u_n| / |u_t|)  if u_n < 0, else unchanged

The last line is Coulomb's law for the impulse: the normal impulse m |u_n| allows a tangential one of at most μ m |u_n|.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.boundary.kernels_elastic import FAR, make_elastic_wall
from diffuphy.mpm.boundary.kernels_shapes import make_surface
from diffuphy.mpm.boundary.layout import N_WALL, Signature


@cache
def _make_wall(
    shape: str, kind: str, rough: bool, turns: bool, elastic: bool, order: int, real: type
) -> SimpleNamespace:
    """Warp functions of one wall: the velocity after it, the adjoint of that, and the gradient in its row."""
    vec3, vec4, wall_t = (wp.types.vector(n, real) for n in (3, 4, N_WALL))
    sticky, separate = kind == "sticky", kind == "separate"
    surface = make_surface(shape, real)

    @wp.func(module="unique")
    def moving(w: wall_t, r: vec3) -> vec3:
        """Velocity of the surface."""
        V = vec3(w[4], w[5], w[6])
        if wp.static(turns):
            V += wp.cross(vec3(w[9], w[10], w[11]), r - vec3(w[12], w[13], w[14]))
        return V

    if elastic and separate:
        wall = make_elastic_wall(shape, rough, order, real, moving)
        return SimpleNamespace(**vars(wall), separate=True, elastic=True)

    @wp.func(module="unique")
    def act(v: vec3, r: vec3, e: vec4, w: wall_t, sdf: wp.array[real]) -> vec3:
        if w[8] == real(0.0):
            return v
        n, phi = surface(w, r, sdf)
        if phi > real(0.0):
            return v
        V = moving(w, r)
        if wp.static(sticky):
            return V
        u = v - V
        u_n = wp.dot(u, n)
        if wp.static(separate):
            if u_n >= real(0.0):
                return v
        t = u - u_n * n
        if wp.static(rough):
            length = wp.length(t)
            drag = -w[7] * u_n
            if drag >= length:
                return V
            t = t * (real(1.0) - drag / length)
        return V + t

    @wp.func(module="unique")
    def act_adjoint(v: vec3, r: vec3, e: vec4, w: wall_t, sdf: wp.array[real], o_bar: vec3):
        if w[8] == real(0.0):
            return o_bar, vec4()
        n, phi = surface(w, r, sdf)
        if phi > real(0.0):
            return o_bar, vec4()
        if wp.static(sticky):
            return vec3(), vec4()
        u = v - moving(w, r)
        u_n = wp.dot(u, n)
        if wp.static(separate):
            if u_n >= real(0.0):
                return o_bar, vec4()
        if wp.static(rough):
            # o = t (1 + μ u_n/|t|):  do = dt (1 + μ u_n/|t|) + t (μ du_n/|t| − μ u_n t·dt/|t|³)
            t = u - u_n * n
            length = wp.length(t)
            k = w[7] * u_n / length
            if length <= -w[7] * u_n:
                return vec3(), vec4()
            d = t / length
            along = wp.dot(d, o_bar)
            t_bar = (real(1.0) + k) * o_bar - (k * along) * d
            return t_bar - wp.dot(t_bar, n) * n + (w[7] * along) * n, vec4()
        return o_bar - wp.dot(o_bar, n) * n, vec4()

    @wp.func(module="unique")
    def friction_bar(v: vec3, r: vec3, e: vec4, w: wall_t, sdf: wp.array[real], o_bar: vec3) -> real:
        """∂/∂μ of o·ō: u_n t/|t| · ō while it slides, of a smooth wall its right-hand derivative; else 0."""
        if wp.static(separate):
            if w[8] == real(0.0):
                return real(0.0)
            n, phi = surface(w, r, sdf)
            if phi > real(0.0):
                return real(0.0)
            u = v - moving(w, r)
            u_n = wp.dot(u, n)
            t = u - u_n * n
            length = wp.length(t)
            if u_n < real(0.0) and length > -w[7] * u_n:
                return u_n * wp.dot(t, o_bar) / length
        return real(0.0)

    return SimpleNamespace(
        act=act, act_adjoint=act_adjoint, friction_bar=friction_bar, separate=separate, elastic=False
    )


@cache
def make_contact(walls: Signature, real: type, order: int = 2) -> SimpleNamespace:
    """Warp functions of a list of walls, which act in order; without walls they are the identity.

        apply(v, r, e, row, sdf, s) → v
        adjoint(v, r, e, row, sdf, s, v_bar) → v_bar, e_bar
        adjoint_rows(v, r, e, row, sdf, s, v_bar, row_bar) → v_bar, e_bar
        nearest(r, dx, row, sdf, s) → φ [Δx], n                  the nearest of the elastic walls, FAR if none is near

    v is the velocity before all walls [m/s], v_bar the gradient in the velocity after them, and returned is that in v;
    ``adjoint_rows`` moreover adds to row_bar[s, b] the gradients in μ, V and ω of each wall b. r is the node from the
    lowest node of the grid [m], e (vec4) what elastic walls read (``kernels_elastic``), ``row`` the wall data
    of ``layout.rows``, ``sdf`` the samples of ``mesh.sdf_samples``, s the row of this step. Gradients are exact within
    the branch a node is in; which nodes a wall governs, its normals and its places are held fixed.
    """
    apply, adjoint, adjoint_rows, nearest = _make_chain(walls, 0, real, order)
    vec3, wall_t = (wp.types.vector(n, real) for n in (3, N_WALL))

    @wp.func(module="unique")
    def first(r: vec3, dx: real, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32):
        phi, n = nearest(r, dx, row, sdf, s, real(FAR), vec3())
        return phi, n

    return SimpleNamespace(apply=apply, adjoint=adjoint, adjoint_rows=adjoint_rows, nearest=first, wall_t=wall_t)


@cache
def _make_chain(walls: Signature, b: int, real: type, order: int) -> tuple[wp.Function, ...]:
    """Wall b and those after it: each function handles its wall and hands on to the function of the others.

    No loop over wp.static(walls[b]): what a loop resolves is not part of the hash under which Warp keeps compiled
    kernels, and two lists of walls of one length would share one kernel.
    """
    vec3, vec4, wall_t = (wp.types.vector(n, real) for n in (3, 4, N_WALL))
    if not walls:
        return _end(vec3, vec4, wall_t, real)
    others, others_adjoint, others_rows, others_nearest = _make_chain(walls[1:], b + 1, real, order)
    wall = _make_wall(*walls[0], order, real)
    act, act_adjoint, friction_bar, separate = wall.act, wall.act_adjoint, wall.friction_bar, wall.separate
    elastic, near = wall.elastic, wall.nearest if wall.elastic else None

    @wp.func(module="unique")
    def apply(v: vec3, r: vec3, e: vec4, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32) -> vec3:
        return others(act(v, r, e, row[s, b], sdf), r, e, row, sdf, s)

    @wp.func(module="unique")
    def adjoint(v: vec3, r: vec3, e: vec4, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32, v_bar: vec3):
        w = row[s, b]
        after, e_after = others_adjoint(act(v, r, e, w, sdf), r, e, row, sdf, s, v_bar)
        before, e_bar = act_adjoint(v, r, e, w, sdf, after)
        return before, e_bar + e_after

    @wp.func(module="unique")
    def adjoint_rows(
        v: vec3,
        r: vec3,
        e: vec4,
        row: wp.array2d[wall_t],
        sdf: wp.array[real],
        s: wp.int32,
        v_bar: vec3,
        row_bar: wp.array2d[wall_t],
    ):
        w = row[s, b]
        after, e_after = others_rows(act(v, r, e, w, sdf), r, e, row, sdf, s, v_bar, row_bar)
        before, e_bar = act_adjoint(v, r, e, w, sdf, after)
        S_bar = after - before  # the result is S + f(v − S)
        if wp.dot(S_bar, S_bar) > real(0.0):
            w_bar = wp.cross(r - vec3(w[12], w[13], w[14]), S_bar)
            for k in range(3):
                row_bar[s, b][4 + k] += S_bar[k]
                row_bar[s, b][9 + k] += w_bar[k]
        if wp.static(separate):
            mu_bar = friction_bar(v, r, e, w, sdf, after)
            if mu_bar != real(0.0):
                row_bar[s, b][7] += mu_bar
        return before, e_bar + e_after

    @wp.func(module="unique")
    def nearest(r: vec3, dx: real, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32, phi: real, n: vec3):
        if wp.static(elastic):
            phi_b, n_b = near(r, dx, row[s, b], sdf, phi, n)
            phi_c, n_c = others_nearest(r, dx, row, sdf, s, phi_b, n_b)
            return phi_c, n_c
        else:
            phi_c, n_c = others_nearest(r, dx, row, sdf, s, phi, n)
            return phi_c, n_c

    return apply, adjoint, adjoint_rows, nearest


def _end(vec3: type, vec4: type, wall_t: type, real: type) -> tuple[wp.Function, ...]:
    """No walls: the identity."""

    @wp.func(module="unique")
    def apply(v: vec3, r: vec3, e: vec4, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32) -> vec3:
        return v

    @wp.func(module="unique")
    def adjoint(v: vec3, r: vec3, e: vec4, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32, v_bar: vec3):
        return v_bar, vec4()

    @wp.func(module="unique")
    def adjoint_rows(
        v: vec3,
        r: vec3,
        e: vec4,
        row: wp.array2d[wall_t],
        sdf: wp.array[real],
        s: wp.int32,
        v_bar: vec3,
        row_bar: wp.array2d[wall_t],
    ):
        return v_bar, vec4()

    @wp.func(module="unique")
    def nearest(r: vec3, dx: real, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32, phi: real, n: vec3):
        return phi, n

    return apply, adjoint, adjoint_rows, nearest
