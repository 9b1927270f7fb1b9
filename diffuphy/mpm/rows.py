"""The row of eight numbers that a particle and a node exchange, and what else both directions of the kernels share."""

from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.variant import Variant


def make_rows(variant: Variant) -> SimpleNamespace:
    """Warp functions that make the rows of a particle and take them apart. Cached."""
    return variant.made(_make_rows)


def _make_rows(v: Variant) -> SimpleNamespace:
    real, vec3, mat33, node_t = v.real, v.vec3, v.mat33, v.node_t

    @wp.func(module="unique")
    def row(q: vec3, m: real, f: vec3) -> node_t:
        """Momentum, mass and what the step adds to the momentum."""
        return node_t(q[0], q[1], q[2], m, f[0], f[1], f[2], real(0.0))

    @wp.func(module="unique")
    def placed(r: node_t, phi: real) -> node_t:
        """The row with mass times the distance to a wall."""
        return node_t(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[3] * phi)

    @wp.func(module="unique")
    def first(r: node_t) -> vec3:
        return vec3(r[0], r[1], r[2])

    @wp.func(module="unique")
    def second(r: node_t) -> vec3:
        return vec3(r[4], r[5], r[6])

    @wp.func(module="unique")
    def column(A: mat33, i: wp.int32) -> vec3:
        return vec3(A[0, i], A[1, i], A[2, i])

    @wp.func(module="unique")
    def moments(s: vec3, a: vec3, b: vec3, c: vec3, f: vec3) -> mat33:
        """Σ w v dᵀ from Σ w v and Σ w v iᵀ."""
        return wp.matrix_from_cols(a - s * f[0], b - s * f[1], c - s * f[2])

    @wp.func(module="unique")
    def affine(V: vec3, V0: vec3, B: mat33, B0: mat33, f: vec3):
        """Rows of the fields V + B (d − f) and V⁰ + B⁰ (d − f): at the lowest node, and per cell along each axis."""
        o = real(0.0)
        return (
            row(V - B * f, o, V0 - B0 * f),
            row(column(B, 0), o, column(B0, 0)),
            row(column(B, 1), o, column(B0, 1)),
            row(column(B, 2), o, column(B0, 2)),
        )

    @wp.func(module="unique")
    def carried_adjoint(bar: mat33, H: mat33, L: mat33):
        """Adjoint of (I + L)(I + H) in L and in H."""
        return bar + bar * wp.transpose(H), bar + wp.transpose(L) * bar

    @wp.func(module="unique")
    def log_det(L: mat33) -> real:
        """ln det(I + L) to the digits of L: ln u · y/(u − 1) makes good the rounding of u = 1 + y (Kahan)."""
        minors = (
            L[0, 0] * L[1, 1] - L[0, 1] * L[1, 0]
            + L[1, 1] * L[2, 2] - L[1, 2] * L[2, 1]
            + L[2, 2] * L[0, 0] - L[2, 0] * L[0, 2]
        )  # fmt: skip
        y = wp.trace(L) + minors + wp.determinant(L)
        u = real(1.0) + y
        if u == real(1.0):
            return y
        return wp.log(u) * (y / (u - real(1.0)))

    return SimpleNamespace(
        row=row, placed=placed, first=first, second=second, column=column, moments=moments, affine=affine,
        carried_adjoint=carried_adjoint, log_det=log_det,
    )  # fmt: skip
