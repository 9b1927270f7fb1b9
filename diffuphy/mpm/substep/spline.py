"""B-splines of degree 2 and 3 on the nodes around a particle, and what else transfers share."""

from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import warp as wp


@lru_cache
def make_spline(real: type, order: int = 2) -> SimpleNamespace:
    """Warp functions of a B-spline: ``weights``, ``slopes``, ``curvatures``, ``inside``, ``cell``; and ``eye``.

    Distances are in cells and count from the lowest of the order + 1 nodes along an axis.
    """
    vec3, mat33 = wp.types.vector(3, real), wp.types.matrix((3, 3), real)
    reach = 0.5 * (order - 1)
    upper = order - reach
    vec_w, weights, slopes, curvatures = (_quadratic if order == 2 else _cubic)(real)

    @wp.func(module="unique")
    def inside(g: vec3, n: wp.vec3i):
        """True when all nodes exist; false for anything that is not a number."""
        h, top = real(reach), real(upper)
        return (
            g[0] >= h and g[1] >= h and g[2] >= h
            and g[0] < real(n[0]) - top and g[1] < real(n[1]) - top and g[2] < real(n[2]) - top
        )  # fmt: skip

    @wp.func(module="unique")
    def cell(g: vec3):
        """Lowest of the nodes around a place, and how far the place is from it, both in cells."""
        h = real(reach)
        bx, by, bz = wp.int32(g[0] - h), wp.int32(g[1] - h), wp.int32(g[2] - h)
        return bx, by, bz, g - vec3(real(bx), real(by), real(bz))

    @wp.func(module="unique")
    def eye():
        o, z = real(1.0), real(0.0)
        return mat33(o, z, z, z, o, z, z, z, o)

    return SimpleNamespace(
        weights=weights, slopes=slopes, curvatures=curvatures, inside=inside, cell=cell, eye=eye, vec_w=vec_w
    )


def _quadratic(real: type) -> tuple[Any, Any, Any, Any]:
    """w, dw/df and d²w/df² of the quadratic spline, ½ ≤ f < 3/2."""
    vec = wp.types.vector(3, real)

    @wp.func(module="unique")
    def weights(f: real):
        a, b, c = real(1.5) - f, f - real(1.0), f - real(0.5)
        return vec(real(0.5) * a * a, real(0.75) - b * b, real(0.5) * c * c)

    @wp.func(module="unique")
    def slopes(f: real):
        return vec(f - real(1.5), real(-2.0) * (f - real(1.0)), f - real(0.5))

    @wp.func(module="unique")
    def curvatures(f: real):
        return vec(real(1.0), real(-2.0), real(1.0))

    return vec, weights, slopes, curvatures


def _cubic(real: type) -> tuple[Any, Any, Any, Any]:
    """w, dw/df and d²w/df² of the cubic spline, 1 ≤ f < 2."""
    vec = wp.types.vector(4, real)
    sixth, two = real(1 / 6), real(2 / 3)

    @wp.func(module="unique")
    def weights(f: real):
        t = f - real(1.0)
        u = real(1.0) - t
        t2, u2 = t * t, u * u
        return vec(sixth * u2 * u, two - t2 + real(0.5) * t2 * t, two - u2 + real(0.5) * u2 * u, sixth * t2 * t)

    @wp.func(module="unique")
    def slopes(f: real):
        t = f - real(1.0)
        u, h = real(1.0) - t, real(0.5)
        w1, w2 = real(1.5) * t * t - real(2.0) * t, real(2.0) * u - real(1.5) * u * u
        return vec(-h * u * u, w1, w2, h * t * t)

    @wp.func(module="unique")
    def curvatures(f: real):
        t = f - real(1.0)
        u = real(1.0) - t
        return vec(u, real(3.0) * t - real(2.0), real(3.0) * u - real(2.0), t)

    return vec, weights, slopes, curvatures
