"""What walls that hold always leave of an acceleration: Π a, for the nodes that they govern.

    sticky   Π = 0        slip   Π = I − n nᵀ        several   Π = Π_b … Π_2 Π_1, in the order of the scene

Linear, and the same whatever the wall and the node do: velocities, friction and elastic reactions have no part in it.
Every Π_b is symmetric, so that the transpose is the product in the opposite order.
"""

from functools import cache

import warp as wp

from diffuphy.mpm.boundary.kernels_shapes import make_surface
from diffuphy.mpm.boundary.layout import ACTS, N_WALL, Signature


@cache
def make_hold(walls: Signature, which: tuple[int, ...], real: type) -> wp.Function:
    """Warp function hold(a, r, row, sdf, s) → Π a with the walls ``which``, the first of them first.

    r is the node from the lowest node of the grid [m]; ``row``, ``sdf`` and s are as for ``make_contact``. By
    recursion, for the reason that ``make_contact`` has.
    """
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)
    if not which:

        @wp.func(module="unique")
        def end(a: vec3, r: vec3, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32) -> vec3:
            return a

        return end
    b, (shape, kind, *_) = which[0], walls[which[0]]
    others, surface, sticky = make_hold(walls, which[1:], real), make_surface(shape, real), kind == "sticky"
    if kind == "separate":
        raise ValueError(f"wall {b} separates: only walls that hold always ('sticky', 'slip') have a Π")

    @wp.func(module="unique")
    def hold(a: vec3, r: vec3, row: wp.array2d[wall_t], sdf: wp.array[real], s: wp.int32) -> vec3:
        w = row[s, b]
        if w[wp.static(ACTS)] != real(0.0):
            n, phi = surface(w, r, sdf)
            if phi <= real(0.0):
                if wp.static(sticky):
                    return vec3()
                a = a - wp.dot(a, n) * n
        return others(a, r, row, sdf, s)

    return hold
