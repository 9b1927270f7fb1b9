"""Adjoint of one substep on the particles, by hand; ``kernels`` has the formulas it belongs to.

With bars for ∂loss/∂ and the rest of the step in ``nodes_adjoint``, one step backwards is

    g2p     v̂ = v̄' + Δt x̄',   V̄ = v̂,  V̄⁰ = −α v̂,  v̄ = α v̂,   B̄⁰ = −α C̄',  C̄ = α C̄',  K̄ = −(Δt/2)(C̄' + C̄'ᵀ)
            B̄ = C̄' + K̄ Lᵀ,   L̄ = Bᵀ K̄ + Δt H̄' Feᵀ,   F̄e = (I + Δt L)ᵀ H̄'
            row̄_i = Σ_p w_ip (V̄ + B̄ d_ip/D) + L̄ ∇w_ip,  likewise V̄⁰, B̄⁰;   x̄ += ∂/∂x of Σ_i row_i · that
    p2g     S = Σ_i w_ip q̄_i,  Ā = Σ_i w_ip q̄_i d_ipᵀ,  likewise S_f, Ā_f:   v̄ += m S,  C̄ += m Ā,
            τ̄ = −k V Ā_f / D,  classic: −k V Σ f̄_i ∇wᵀ,   m̄ = S·v + Ā:C + Σ_i w_ip m̄_i + k S_f·b,
            and (τ̄, F̄e) → H̄, w̄, θ̄ by the mixture's own adjoint

A particle's row is written by its own thread alone; only the grid is summed into. L is gathered again, since a state
does not keep it.
"""

from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.drive import make_drives
from diffuphy.mpm.substep.adjoint_g2p import make_g2p_adjoint
from diffuphy.mpm.substep.obstacle import make_obstacle
from diffuphy.mpm.substep.rows import make_rows
from diffuphy.mpm.substep.survey import make_survey
from diffuphy.mpm.substep.transfer import make_transfer
from diffuphy.mpm.substep.variant import Variant

Needs = tuple[bool, bool, bool, bool]
"""Which of w_e, w_p, θ, mass need a gradient; the others get no buffer. It is data: one compiled kernel serves all
sixteen cases."""


def make_adjoint(variant: Variant) -> SimpleNamespace:
    """The kernels ``g2p_adjoint`` and ``p2g_adjoint`` of a backward substep. Cached."""
    return variant.made(_make_adjoint)


def _make_adjoint(variant: Variant) -> SimpleNamespace:
    return SimpleNamespace(g2p_adjoint=make_g2p_adjoint(variant), p2g_adjoint=_make_p2g_adjoint(variant))


def _make_p2g_adjoint(variant: Variant) -> wp.Kernel:
    mixture, real = variant.mixture, variant.real
    vec3, mat33, node_t, step_t = variant.vec3, variant.mat33, variant.node_t, variant.step_t
    w_e_t, w_p_t, theta_t, memory_t = mixture.w_e_t, mixture.w_p_t, mixture.theta_t, mixture.memory_t
    spline, drives = make_transfer(variant.scheme, real).spline, variant.drives
    cell, eye, from_nodes = spline.cell, spline.eye, _make_from_nodes(variant)
    stress, stress_adjoint = mixture.stress, mixture.stress_adjoint
    branch_stress, branch_stress_adjoint = mixture.branch_stress, mixture.branch_stress_adjoint
    memory, branched = len(mixture.memory) > 0, len(mixture.branches) > 0
    material_of = make_rows(variant).material_of
    body, driven = variant.body, len(drives) > 0
    drive = make_drives(drives, real)
    drive_t, accelerate, accelerate_adjoint = drive.drive_t, drive.accelerate, drive.accelerate_adjoint
    brings = make_obstacle(variant).brings
    hold, hold_adjoint, pushed, pushes = drive.hold, drive.hold_adjoint, drive.pushed, drive.impulses > 0
    scale = real(1 if variant.scheme.force == "classic" else 1 / variant.scheme.inertia)
    beside, wall_t = make_rows(variant).beside, make_rows(variant).wall_t

    @wp.kernel(module="unique", enable_backward=False)
    def p2g_adjoint(
        X: wp.array[vec3],
        u: wp.array[vec3],
        v: wp.array[vec3],
        C: wp.array[mat33],
        He: wp.array[mat33],  # (N,) trial elastic part minus I
        HN: wp.array[mat33],
        memory_in: wp.array[memory_t],
        w_e: wp.array[w_e_t],
        w_p: wp.array[w_p_t],
        theta: wp.array[theta_t],
        m: wp.array[real],
        vol: wp.array[real],
        b: wp.array[vec3],
        tag: wp.array[wp.int32],
        drive_row: wp.array2d[drive_t],
        wall_row: wp.array2d[wall_t],
        sdf: wp.array[real],
        ws: wp.int32,
        low: vec3,
        dx: real,
        n: wp.vec3i,
        per_scene: wp.int32,
        steps: wp.array[step_t],
        s: wp.int32,
        at: wp.int32,
        start: wp.int32,
        bar: wp.array[node_t],  # (scenes · nodes,) of momentum, mass and impulse
        x_bar: wp.array[vec3],
        v_bar: wp.array[vec3],
        C_bar: wp.array[mat33],
        He_bar: wp.array[mat33],  # in: of Fe, out: of the trial elastic part
        HN_bar: wp.array[mat33],
        memory_bar: wp.array[memory_t],
        w_e_bar: wp.array[w_e_t],  # summed over substeps; likewise below
        w_p_bar: wp.array[w_p_t],
        theta_bar: wp.array[theta_t],
        m_bar: wp.array[real],
        push_bar: wp.array2d[real],  # (N, impulses) of the mass that shares each, times that mass
        need_w_e: bool,
        need_w_p: bool,
        need_theta: bool,
        need_m: bool,
    ):
        p = start + wp.tid()
        r, base, idx = at + p, (p // per_scene) * (n[0] * n[1] * n[2]), real(1.0) / dx
        place = (X[p] - low) + u[r]
        bx, by, bz, f = cell(place * idx)
        dt, kick, share = steps[s][0], steps[s][1], brings(tag, p, drive_row, s)
        w_e_p, w_p_p, theta_p = material_of(w_e, w_p, theta, p)
        F = eye() + He[r]
        if wp.static(memory):
            tau, _flow, _h = stress(F, He[r], w_e_p, w_p_p, theta_p, dt, memory_in[r])
        else:
            tau, _flow = stress(F, He[r], w_e_p, w_p_p, theta_p, dt)
        if wp.static(branched):
            tau_N, _flow_N = branch_stress(eye() + HN[r], HN[r], theta_p, dt)
            tau += tau_N
        m_p = share * m[p]
        v_p = v[r]
        C_p = C[r]
        a_p = vec3()
        if wp.static(driven):
            v_p, C_p = hold(place, v_p, C_p, tag[p], drive_row, s)
            a_p = accelerate(place, v_p, tag[p], drive_row, s)
        if wp.static(body):
            a_p += b[p]
        phi, normal = beside(place, dx, wall_row, sdf, ws)
        S, S_f, A_bar, tau_bar, m_i, along = from_nodes(
            bar, base, n, bx, by, bz, f,
            m_p, v_p, (m_p * dx) * C_p, (kick * m_p) * a_p, (-kick * scale * idx * share) * vol[p], tau, phi, normal,
        )  # fmt: skip
        v_b, C_b, x_b = m_p * S, (m_p * dx) * A_bar, idx * along
        if wp.static(driven):
            r_b, v_a = accelerate_adjoint(place, v_p, tag[p], drive_row, s, (kick * m_p) * S_f)
            if wp.static(pushes):
                if need_m:
                    pushed(tag[p], drive_row, s, (kick * m_p) * S_f, p, push_bar)
            r_h, v_b, C_b = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, v_b + v_a, C_b)
            x_b += r_b + r_h
        x_bar[p] = x_bar[p] + x_b
        v_bar[p] = v_bar[p] + v_b
        C_bar[p] = C_bar[p] + C_b
        if wp.static(memory):
            F_bar, we_b, wp_b, th_b, h_b = stress_adjoint(
                F, He[r], w_e_p, w_p_p, theta_p, dt, tau_bar, He_bar[p], memory_in[r], memory_bar[p]
            )
            memory_bar[p] = h_b
        else:
            F_bar, we_b, wp_b, th_b = stress_adjoint(F, He[r], w_e_p, w_p_p, theta_p, dt, tau_bar, He_bar[p])
        He_bar[p] = F_bar
        if wp.static(branched):
            FN_bar, th_N = branch_stress_adjoint(eye() + HN[r], HN[r], theta_p, dt, tau_bar, HN_bar[p])
            HN_bar[p] = FN_bar
            th_b += th_N
        if need_w_e:
            w_e_bar[p] = w_e_bar[p] + we_b
        if need_w_p:
            w_p_bar[p] = w_p_bar[p] + wp_b
        if need_theta:
            theta_bar[p] = theta_bar[p] + th_b
        if need_m:
            brought = wp.dot(S, v_p) + dx * wp.ddot(A_bar, C_p) + m_i + kick * wp.dot(S_f, a_p)
            m_bar[p] = m_bar[p] + share * brought

    return p2g_adjoint


def _make_from_nodes(variant: Variant) -> wp.Function:
    """Warp function: S, S_f, Ā per cell, τ̄, Σ w m̄ and the derivative along each axis [cells] of what a particle brought
    to its nodes: mass, momentum m v with the affine part A per cell, impulse g and stress k τ."""
    real, vec3, mat33, node_t = variant.real, variant.vec3, variant.mat33, variant.node_t
    transfer, rows = make_survey(variant.scheme, real), make_rows(variant)
    survey, slope = transfer.survey, transfer.along
    row, first, second, column, moments = rows.row, rows.first, rows.second, rows.column, rows.moments
    placed = rows.placed
    classic = variant.scheme.force == "classic"

    @wp.func(module="unique")
    def from_nodes(
        bar: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        m: real, v: vec3, A: mat33, g: vec3, k: real, tau: mat33, phi: real, normal: vec3,
    ):  # fmt: skip
        q, T, z, o = m * v - A * f, k * tau, vec3(), real(0.0)
        tau_bar = mat33()
        at = survey(bar, base, n, bx, by, bz, f)
        sum = at[0]
        if wp.static(classic):
            along = slope(
                at, placed(row(q, m, g), phi),
                row(column(A, 0), o, z), row(column(A, 1), o, z), row(column(A, 2), o, z),
                row(z, o, column(T, 0)), row(z, o, column(T, 1)), row(z, o, column(T, 2)),
            )  # fmt: skip
            tau_bar = k * wp.matrix_from_cols(second(at[4]), second(at[8]), second(at[12]))
        else:
            along = slope(
                at, placed(row(q, m, g - T * f), phi),
                row(column(A, 0), o, column(T, 0)),
                row(column(A, 1), o, column(T, 1)),
                row(column(A, 2), o, column(T, 2)),
            )  # fmt: skip
            tau_bar = k * moments(second(sum), second(at[1]), second(at[2]), second(at[3]), f)
            along -= wp.transpose(T) * second(sum)
        along -= wp.transpose(A) * first(sum)
        A_bar = moments(first(sum), first(at[1]), first(at[2]), first(at[3]), f)
        along += (m * sum[7]) * normal
        return first(sum), second(sum), A_bar, tau_bar, sum[3] + sum[7] * phi, along

    return from_nodes
