"""Contact with a separating wall as an elastic reaction on the place of the matter, not on the velocity of nodes.

A node feels particles from three half cells away. A wall that takes the velocity of its nodes therefore turns a body
back while it is still almost a cell above. Here a node pushes only as far as the matter around it lies deeper than
matter that just touches the wall would: with x̄ = Σ w m φ(x_p)/Σ w m the mean distance of the particles of a node to the
wall, X(φ_i) the same of matter that fills all φ > 0, both in cells,

    a_n = r(φ_i) max(ω² Δx (X(φ_i) − x̄) − 2 ζ ω u_n, 0) where X(φ_i) > x̄,     ω² = 2 c²/Δx²,     u_n ← u_n + k a_n

with r = 1 behind the wall and falling to 0 half a cell in front: a spring of one cell of the stiffest material, and
a damper that lets a body at rest come to rest. Friction is Coulomb's law for the impulse k a_n. Nodes deeper than HARD
cells are held as those of a rigid wall, so that nothing gets through.

    X(φ) = Q(s)/M(s),  s = −φ/Δx,  M(s) = ∫_s w(y) dy,  Q(s) = ∫_s (y − s) w(y) dy          w: the B-spline of the grid
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.boundary.kernels_shapes import make_surface
from diffuphy.mpm.boundary.layout import HARD, N_WALL

NEAR = 0.5
"""How far in front of the wall nodes still push [Δx]: of two planes of nodes at least one lies between this and −½."""

FAR = 4.0
"""Distance beyond which a particle is as good as anywhere [Δx]."""


@cache
def make_filled(real: type, order: int) -> wp.Function:
    """X(φ) in cells for −(order + 1)/2 < φ ≤ ½, 0 beyond: mean distance of the matter of a node to a wall that it just
    touches."""
    half, third = real(0.5), real(1 / 3)
    c0, c1, c2 = (real(a) for a in ((13 / 64, 1 / 12, 0.375) if order == 2 else (7 / 30, 1 / 12, 1 / 40)))

    @wp.func(module="unique")
    def filled(phi: real) -> real:
        s = -phi
        if wp.static(order == 2):
            if s >= half:
                return wp.max(real(1.5) - s, real(0.0)) * real(0.25)
            s2 = s * s
            return (c0 - half * s + c2 * s2 - c1 * s2 * s2) / (half - real(0.75) * s + third * s2 * s)
        else:
            if s >= real(1.0):
                return wp.max(real(2.0) - s, real(0.0)) * real(0.2)
            a = wp.abs(s)
            a2 = a * a
            M = half - (real(2.0) * a - a2 * a) * third - real(0.125) * a2 * a2
            Q = c0 - half * a + a2 * third - c1 * a2 * a2 + c2 * a2 * a2 * a
            if s < real(0.0):  # M(−s) = 1 − M(s), Q(−s) = Q(s) + s
                M = real(1.0) - M
                Q = Q + a
            return Q / M

    return filled


@cache
def make_elastic_wall(shape: str, rough: bool, order: int, real: type, moving: wp.Function) -> SimpleNamespace:
    """Warp functions of one wall, as those of ``kernels``; e = (x̄ [Δx], k ω² [1/s], 2 ζ k ω [-], Δx [m])."""
    vec3, vec4, wall_t = (wp.types.vector(n, real) for n in (3, 4, N_WALL))
    surface, filled = make_surface(shape, real), make_filled(real, order)
    hard, near = real(HARD), real(NEAR)

    @wp.func(module="unique")
    def spring(phi: real, e: vec4):
        """r (X − x̄) Δx and r, both 0 where the matter does not press; φ from the surface that is held."""
        d = phi / e[3] - hard
        gap = filled(d) - e[0]
        if d >= near or gap <= real(0.0):
            return real(0.0), real(0.0)
        r = wp.min(real(1.0), real(1.0) - d / near)
        return r * gap * e[3], r

    @wp.func(module="unique")
    def act(v: vec3, r: vec3, e: vec4, w: wall_t, sdf: wp.array[real]) -> vec3:
        if w[8] == real(0.0):
            return v
        n, phi = surface(w, r, sdf)
        depth, ramp = spring(phi, e)
        V = moving(w, r)
        u = v - V
        u_n = wp.dot(u, n)
        push = e[1] * depth - e[2] * ramp * u_n
        if phi <= real(0.0):
            push = wp.max(push, -u_n)
        if push <= real(0.0):
            return v
        t = u - u_n * n
        if wp.static(rough):
            length = wp.length(t)
            drag = w[7] * push
            if drag >= length:
                t = vec3()
            else:
                t = t * (real(1.0) - drag / length)
        return V + t + (u_n + push) * n

    @wp.func(module="unique")
    def act_adjoint(v: vec3, r: vec3, e: vec4, w: wall_t, sdf: wp.array[real], o_bar: vec3):
        if w[8] == real(0.0):
            return o_bar, vec4()
        n, phi = surface(w, r, sdf)
        depth, ramp = spring(phi, e)
        u = v - moving(w, r)
        u_n = wp.dot(u, n)
        push = e[1] * depth - e[2] * ramp * u_n
        held = phi <= real(0.0) and -u_n > push
        if held:
            push = -u_n
        if push <= real(0.0):
            return o_bar, vec4()
        push_bar = wp.dot(o_bar, n)
        n_bar = push_bar
        t_bar = o_bar
        if wp.static(rough):
            t = u - u_n * n
            length = wp.length(t)
            if length <= w[7] * push:
                t_bar = vec3()
            else:
                k = w[7] * push / length
                along = wp.dot(t, o_bar) / length
                t_bar = (real(1.0) - k) * o_bar + (k * along / length) * t
                push_bar -= w[7] * along
        if held:
            return t_bar + (n_bar - push_bar - wp.dot(t_bar, n)) * n, vec4()
        n_bar -= e[2] * ramp * push_bar
        e_bar = vec4(-e[1] * ramp * e[3] * push_bar, depth * push_bar, -ramp * u_n * push_bar, real(0.0))
        return t_bar + (n_bar - wp.dot(t_bar, n)) * n, e_bar

    @wp.func(module="unique")
    def friction_bar(v: vec3, r: vec3, e: vec4, w: wall_t, sdf: wp.array[real], o_bar: vec3) -> real:
        if w[8] == real(0.0):
            return real(0.0)
        n, phi = surface(w, r, sdf)
        depth, ramp = spring(phi, e)
        u = v - moving(w, r)
        u_n = wp.dot(u, n)
        push = e[1] * depth - e[2] * ramp * u_n
        if phi <= real(0.0):
            push = wp.max(push, -u_n)
        t = u - u_n * n
        length = wp.length(t)
        if push > real(0.0) and length > w[7] * push:
            return -push * wp.dot(t, o_bar) / length
        return real(0.0)

    @wp.func(module="unique")
    def nearest(r: vec3, dx: real, w: wall_t, sdf: wp.array[real], phi: real, n: vec3):
        """Distance of a place to the wall in cells, and its direction, if it is less than that to the walls before."""
        if w[8] != real(0.0):
            n_b, phi_b = surface(w, r, sdf)
            d = phi_b / dx - hard
            if d < phi:
                return d, n_b
        return phi, n

    return SimpleNamespace(act=act, act_adjoint=act_adjoint, friction_bar=friction_bar, nearest=nearest)
