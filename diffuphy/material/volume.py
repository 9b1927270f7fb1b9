"""Determinants: of a state of matter, to the digits of H = F − I where that is small and of F elsewhere."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from . import linalg, near_one


@dataclass(frozen=True)
class VolumeFunctions:
    """Warp functions of one precision; J = det F."""

    excess: Any
    """(s, d) → s_0 s_1 s_2 − 1."""
    dilation: Any
    """(F, H) → (J, J − 1) with J = det F; NaN where J ≤ 0."""
    volume: Any
    """(F, H) → (J, J − 1, ln J); NaN where J ≤ 0."""
    log_det: Any
    """H → ln det(I + H)."""
    determinant: Any
    """F → det F, right in sign up to a condition number of 1/(some ulp), however F is turned."""
    valid: Any
    """F → bool, finite and det F > 0, as sure as :attr:`determinant`."""


@cache
def build(real: Any) -> VolumeFunctions:
    """Functions for ``wp.float32`` or ``wp.float64``."""
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)
    nan = real(float("nan"))
    tiny = real(1e-37 if real is wp.float32 else 1e-290)
    # (det/|F|³)² to which a sum of products is right: 4 of its roundings, times a hundred for the digits themselves
    rounding = real((400 * (2**-23 if real is wp.float32 else 2**-52)) ** 2)
    near = real(linalg.NEAR)
    log1p = near_one.build(real).log1p

    @wp.func(module="unique")
    def eliminated(F: mat33) -> real:
        """det F from columns that are made orthogonal, longest first: right in sign up to a condition of 1/(some ulp),
        as the stretches are, in any frame."""
        a = vec3(F[0, 0], F[1, 0], F[2, 0])
        b = vec3(F[0, 1], F[1, 1], F[2, 1])
        c = vec3(F[0, 2], F[1, 2], F[2, 2])
        for _i in range(2):  # the longest first, by even permutations
            if wp.dot(a, a) < wp.max(wp.dot(b, b), wp.dot(c, c)):
                q = a
                a = b
                b = c
                c = q
        aa = wp.dot(a, a)
        b = b - (wp.dot(a, b) / aa) * a
        c = c - (wp.dot(a, c) / aa) * a
        sign = real(1.0)
        if wp.dot(b, b) < wp.dot(c, c):
            q = b
            b = c
            c = q
            sign = real(-1.0)
        c = c - (wp.dot(b, c) / (wp.dot(b, b) + tiny)) * b
        return sign * wp.dot(wp.cross(a, b), c)

    @wp.func(module="unique")
    def determinant(F: mat33) -> real:
        det = wp.determinant(F)
        size = wp.ddot(F, F)
        if det * det < rounding * size * size * size:
            det = eliminated(F)
        return det

    @wp.func(module="unique")
    def valid(F: mat33) -> bool:
        det = determinant(F)
        return det > real(0.0) and wp.isfinite(det)

    @wp.func(module="unique")
    def excess(s: vec3, d: vec3) -> real:
        if wp.dot(d, d) < near:
            return d[2] + s[2] * (d[1] + s[1] * d[0])
        return s[0] * s[1] * s[2] - real(1.0)

    @wp.func(module="unique")
    def growth(H: mat33) -> real:
        """det(I + H) − 1, the sum of the principal minors of H."""
        minors = (
            H[0, 0] * H[1, 1] - H[0, 1] * H[1, 0]
            + H[1, 1] * H[2, 2] - H[1, 2] * H[2, 1]
            + H[2, 2] * H[0, 0] - H[2, 0] * H[0, 2]
        )  # fmt: skip
        return wp.trace(H) + minors + wp.determinant(H)

    @wp.func(module="unique")
    def dilation(F: mat33, H: mat33):
        j = growth(H)
        J = real(1.0) + j
        if wp.ddot(H, H) >= near:
            J = determinant(F)
            if not J > real(0.0):
                J = nan
            j = J - real(1.0)
        return J, j

    @wp.func(module="unique")
    def volume(F: mat33, H: mat33):
        J, j = dilation(F, H)
        if wp.ddot(H, H) < near:
            return J, j, log1p(j)
        return J, j, wp.log(J)

    @wp.func(module="unique")
    def log_det(H: mat33) -> real:
        """To the digits of H: ln u · y/(u − 1) makes good the rounding of u = 1 + y (Kahan), for any y."""
        y = growth(H)
        u = real(1.0) + y
        if u == real(1.0):
            return y
        return wp.log(u) * (y / (u - real(1.0)))

    return VolumeFunctions(excess, dilation, volume, log_det, determinant, valid)
