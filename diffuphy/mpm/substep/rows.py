"""The row of eight numbers that a particle and a node exchange, and what else both directions of the kernels share."""

from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from diffuphy.material import volume
from diffuphy.mpm.boundary import make_contact
from diffuphy.mpm.substep.transfer import make_transfer
from diffuphy.mpm.substep.variant import Variant


def make_rows(variant: Variant) -> SimpleNamespace:
    """Warp functions that make the rows of a particle and take them apart. Cached."""
    return variant.made(_make_rows)


def _make_rows(v: Variant) -> SimpleNamespace:
    elastic = v.elastic
    contact = make_contact(v.walls if elastic else (), v.real, v.scheme.order)
    nearest, wall_t = contact.nearest, contact.wall_t
    real, vec3, mat33, node_t, mixture = v.real, v.vec3, v.mat33, v.node_t, v.mixture
    w_e_t, w_p_t, theta_t = mixture.w_e_t, mixture.w_p_t, mixture.theta_t
    log_det = volume.build(real).log_det
    mixes_e, mixes_p = mixture.Ke > 1, mixture.Kp > 1

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
    def turned(B: mat33, L: mat33) -> mat33:
        """S = sym(B L), how fast an affine field changes that moves with the matter, less what would add to its energy:
        S − min(0, E : S) E/(E : E), E = sym B."""
        K = B * L
        S = real(0.5) * (K + wp.transpose(K))
        E = real(0.5) * (B + wp.transpose(B))
        work = wp.ddot(E, S)
        if work < real(0.0):
            S -= (work / wp.ddot(E, E)) * E
        return S

    @wp.func(module="unique")
    def turned_adjoint(B: mat33, L: mat33, bar: mat33):
        """Adjoint of ``turned`` in B and in L."""
        K = B * L
        S = real(0.5) * (K + wp.transpose(K))
        E = real(0.5) * (B + wp.transpose(B))
        S_bar = real(0.5) * (bar + wp.transpose(bar))
        B_bar = mat33()
        work = wp.ddot(E, S)
        if work < real(0.0):
            e = wp.ddot(E, E)
            along = wp.ddot(E, S_bar) / e
            B_bar = (-along) * S + (real(2.0) * work * along / e) * E - (work / e) * S_bar  # symmetric, as E is
            S_bar -= along * E
        return B_bar + S_bar * wp.transpose(L), wp.transpose(B) * S_bar

    @wp.func(module="unique")
    def material_of(w_e: wp.array[w_e_t], w_p: wp.array[w_p_t], theta: wp.array[theta_t], p: wp.int32):
        """Weights and parameters of a particle; weights of a single law are not read."""
        a, b = w_e_t(), w_p_t()
        if wp.static(mixes_e):
            a = w_e[p]
        if wp.static(mixes_p):
            b = w_p[p]
        return a, b, theta[p]

    @wp.func(module="unique")
    def beside(place: vec3, dx: real, wall_row: wp.array2d[wall_t], sdf: wp.array[real], ws: wp.int32):
        """Distance of a particle to the nearest elastic wall [Δx], and the direction that leads away from it."""
        if wp.static(elastic):
            phi, normal = nearest(place, dx, wall_row, sdf, ws)
            return phi, normal
        else:
            return real(0.0), vec3()

    return SimpleNamespace(
        row=row, placed=placed, beside=beside, wall_t=wall_t, first=first, second=second, column=column,
        moments=moments, affine=affine, material_of=material_of, carried_adjoint=carried_adjoint, log_det=log_det,
        turned=turned, turned_adjoint=turned_adjoint,
    )  # fmt: skip


@lru_cache
def make_around(variant: Variant) -> SimpleNamespace:
    """Warp functions ``around``: B, L, V, and V⁰ and B⁰ at a particle, the last two only if particles keep something of
    their velocity; and ``surveyed``: the same from what was summed for an adjoint."""
    real, vec3, mat33, node_t = variant.real, variant.vec3, variant.mat33, variant.node_t
    gather, rows = make_transfer(variant.scheme, real).gather, make_rows(variant)
    first, second, moments = rows.first, rows.second, rows.moments
    classic, keeps = variant.scheme.force == "classic", variant.scheme.keeps
    inverse = real(1 / variant.scheme.inertia)

    @wp.func(module="unique")
    def fields(
        sum: node_t, m0: node_t, m1: node_t, m2: node_t, g0: node_t, g1: node_t, g2: node_t, f: vec3, idx: real
    ):  # fmt: skip
        """From Σ w row, Σ w row i for each axis and, classic alone, Σ row ∂w for each axis."""
        c = inverse * idx
        V_0, B_0 = vec3(), mat33()
        B = c * moments(first(sum), first(m0), first(m1), first(m2), f)
        L = B
        if wp.static(classic):
            L = wp.matrix_from_cols(idx * first(g0), idx * first(g1), idx * first(g2))
        if wp.static(keeps):
            V_0 = second(sum)
            B_0 = c * moments(V_0, second(m0), second(m1), second(m2), f)
        return B, L, first(sum), V_0, B_0

    @wp.func(module="unique")
    def around(
        grid_v: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        idx: real,
    ):  # fmt: skip
        g0, g1, g2 = node_t(), node_t(), node_t()
        if wp.static(classic):
            sum, m0, m1, m2, g0, g1, g2 = gather(grid_v, base, n, bx, by, bz, f)
        else:
            sum, m0, m1, m2 = gather(grid_v, base, n, bx, by, bz, f)
        B, L, V, V_0, B_0 = fields(sum, m0, m1, m2, g0, g1, g2, f, idx)
        return B, L, V, V_0, B_0

    @wp.func(module="unique")
    def surveyed(rows: Any, f: vec3, idx: real):
        """B, L, V⁰ and B⁰ from the rows of a ``survey``."""
        B, L, _V, V_0, B_0 = fields(rows[0], rows[1], rows[2], rows[3], rows[4], rows[8], rows[12], f, idx)
        return B, L, V_0, B_0

    return SimpleNamespace(around=around, surveyed=surveyed)
