"""How fast waves run in the present state of a particle: what bounds the time step.

A plane wave of direction n and polarisation u in matter with spatial elasticity a_ijkl (of Kirchhoff stress, so that it
belongs to the rest density) has ρ_0 c² = Σ a_ijkl u_i n_j u_k n_l. In the principal frame of an isotropic law

    along an axis      a_iiii = ∂T_i/∂e_i − T_i
    in shear           a_ijij = q_ij s_j²,   q_ij = (T_i − T_j)/(s_i² − s_j²)           (runs along j, moves along i)
    coupling           B_ij = a_iijj + a_jiij = ∂T_i/∂e_j + q_ij s_j² − T_j = B_ji

With z_i = u_i n_i, Σ |z_i| ≤ 1, and μ̂ the largest of the a_ijij this is at most μ̂ + Σ_ij (B_ij − μ̂ δ_ij) z_i z_j with
B_ii = a_iiii, so that over all directions

    ρ_0 c² ≤ M̂ = max(μ̂, max_i a_iiii, μ̂ + max_ij |B_ij|)

with equality at rest (λ + 2μ), in every state of a neo-Hookean solid, and wherever the fastest wave runs along an axis
of strain. Ogden, Non-linear Elastic Deformations (1984), §6.4 gives the tensor; the bound is one line of algebra.
"""

from typing import Any

import warp as wp

from . import linalg
from .branch import BranchFunctions
from .expert import Layout
from .sums import ElasticSum


def build(layout: Layout, total: ElasticSum, w_e_t: Any, branch: BranchFunctions | None) -> Any:
    """(F, H, w_e, θ) → M̂ [Pa], never less than at rest: what has softened may stiffen within the step. A branch, whose
    own state is not known here, adds its stiffness at rest. NaN where det F ≤ 0."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    la = linalg.build(real)
    nan = real(float("nan"))

    @wp.func(module="unique")
    def tangent(s: vec3, d: vec3, e: vec3, w_e: w_e_t, theta: theta_t):
        """Rows of ∂T_i/∂e_j."""
        one, nil = real(1.0), real(0.0)
        r0, _w0, _t0 = total.stress_adjoint(s, d, e, w_e, theta, vec3(one, nil, nil))
        r1, _w1, _t1 = total.stress_adjoint(s, d, e, w_e, theta, vec3(nil, one, nil))
        r2, _w2, _t2 = total.stress_adjoint(s, d, e, w_e, theta, vec3(nil, nil, one))
        return r0, r1, r2

    @wp.func(module="unique")
    def bound(F: mat33, H: mat33, w_e: w_e_t, theta: theta_t) -> real:
        _B, _V, s, d, e = la.principal(F, H)
        if not s[0] > real(0.0):
            return nan
        T = total.stress(s, d, e, w_e, theta)
        q = total.slope(s, d, e, w_e, theta)
        r0, r1, r2 = tangent(s, d, e, w_e, theta)
        c = wp.cw_mul(s, s)
        q12 = q[0] / (s[1] + s[2])
        q20 = q[1] / (s[2] + s[0])
        q01 = q[2] / (s[0] + s[1])
        shear = wp.max(q12 * wp.max(c[1], c[2]), wp.max(q20 * wp.max(c[2], c[0]), q01 * wp.max(c[0], c[1])))
        axial = wp.max(r0[0] - T[0], wp.max(r1[1] - T[1], r2[2] - T[2]))
        coupling = wp.max(
            wp.abs(r1[2] + q12 * c[2] - T[2]),
            wp.max(wp.abs(r2[0] + q20 * c[0] - T[0]), wp.abs(r0[1] + q01 * c[1] - T[1])),
        )
        one = real(1.0)
        rest, _w, _t = total.stress_adjoint(
            vec3(one, one, one), vec3(), vec3(), w_e, theta, vec3(one, real(0.0), real(0.0))
        )
        return wp.max(rest[0], wp.max(axial, shear + coupling))

    if branch is None:
        return bound
    stiffness = branch.stiffness

    @wp.func(module="unique")
    def bound_with_branch(F: mat33, H: mat33, w_e: w_e_t, theta: theta_t) -> real:
        return bound(F, H, w_e, theta) + stiffness(theta)

    return bound_with_branch
