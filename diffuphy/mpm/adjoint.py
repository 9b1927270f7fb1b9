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

from diffuphy.material import linalg
from diffuphy.mpm.drive import make_drives
from diffuphy.mpm.kernels import make_rows
from diffuphy.mpm.transfer import make_transfer
from diffuphy.mpm.variant import Variant

Needs = tuple[bool, bool, bool, bool]
"""Which of w_e, w_p, θ, mass need a gradient; the others get no buffer. It is data: one compiled kernel serves all
sixteen cases."""


def make_adjoint(variant: Variant) -> SimpleNamespace:
    """The kernels ``g2p_adjoint`` and ``p2g_adjoint`` of a backward substep. Cached."""
    return variant.made(_make_adjoint)


def _make_adjoint(variant: Variant) -> SimpleNamespace:
    return SimpleNamespace(g2p_adjoint=_make_g2p_adjoint(variant), p2g_adjoint=_make_p2g_adjoint(variant))


def _make_g2p_adjoint(variant: Variant) -> wp.Kernel:
    mixture, real = variant.mixture, variant.real
    vec3, mat33, node_t, step_t = variant.vec3, variant.mat33, variant.node_t, variant.step_t
    memory_t = mixture.memory_t
    transfer, rows, drives = make_transfer(variant.scheme, real), make_rows(variant), variant.drives
    spline, gather, gather_adjoint = transfer.spline, transfer.gather, transfer.gather_adjoint
    row, first, second, column, moments = rows.row, rows.first, rows.second, rows.column, rows.moments
    cell, eye, cofactor = spline.cell, spline.eye, linalg.build(real).cofactor
    plastic, branched = mixture.is_plastic, len(mixture.branches) > 0
    opens = "log_J" in mixture.memory
    at_log_J = mixture.memory.index("log_J") if opens else 0
    driven, classic, keeps = len(drives) > 0, variant.scheme.force == "classic", variant.scheme.keeps
    turns = variant.scheme.retain > 0.0
    drive = make_drives(drives, real)
    drive_t, hold_adjoint = drive.drive_t, drive.hold_adjoint
    inverse = real(1 / variant.scheme.inertia)

    @wp.kernel(module="unique", enable_backward=False)
    def g2p_adjoint(
        X: wp.array[vec3],
        u: wp.array[vec3],
        v: wp.array[vec3],
        C: wp.array[mat33],
        He: wp.array[mat33],  # elastic part minus I: with plasticity after flow, one row a particle, else rows as u
        H: wp.array[mat33],  # total minus I, only with plasticity
        HN: wp.array[mat33],  # viscous branch after flow, one row a particle
        grid_v: wp.array[node_t],
        tag: wp.array[wp.int32],
        drive_row: wp.array2d[drive_t],
        low: vec3,
        dx: real,
        n: wp.vec3i,
        per_scene: wp.int32,
        per: wp.int32,  # particles of a lane of ``bar``
        steps: wp.array[step_t],
        s: wp.int32,
        at: wp.int32,  # first row of the beginning of the step
        start: wp.int32,
        x_bar: wp.array[vec3],  # in: of the end, out: of the beginning, the p2g part still missing; likewise below
        v_bar: wp.array[vec3],
        C_bar: wp.array[mat33],
        He_bar: wp.array[mat33],  # out: of Fe
        H_bar: wp.array[mat33],
        HN_bar: wp.array[mat33],  # out: of the branch after flow
        memory_bar: wp.array[memory_t],
        bar: wp.array[node_t],  # (lanes · nodes,) of the velocities after and before the step   out
        alpha_bar: wp.array[real],  # (N,) of α, summed over substeps
        need_alpha: bool,
    ):
        p = start + wp.tid()
        r = at + p
        idx = real(1.0) / dx
        place = (X[p] - low) + u[r]
        bx, by, bz, f = cell(place * idx)
        step = steps[s]
        dt, alpha = step[0], step[2]
        nodes = n[0] * n[1] * n[2]
        base, lane = (p // per_scene) * nodes, (p // per) * nodes
        c = inverse * idx
        L = mat33()
        if wp.static(classic):
            sum, m0, m1, m2, g0, g1, g2 = gather(grid_v, base, n, bx, by, bz, f)
            L = wp.matrix_from_cols(idx * first(g0), idx * first(g1), idx * first(g2))
        else:
            sum, m0, m1, m2 = gather(grid_v, base, n, bx, by, bz, f)
        B = c * moments(first(sum), first(m0), first(m1), first(m2), f)
        if wp.static(not classic):
            L = B
        x_next = x_bar[p]
        v_next, C_next = v_bar[p] + dt * x_next, C_bar[p]
        if wp.static(driven):  # the values that hold overwrites do not matter to its adjoint
            r_bar, v_next, C_next = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, v_next, C_next)
            x_next += r_bar
        B_bar = C_next
        e = r
        if wp.static(plastic):
            e = p
        e_bar = He_bar[p]
        L_bar = dt * (e_bar + e_bar * wp.transpose(He[e]))
        A = dt * wp.transpose(L)
        He_bar[p] = e_bar + A * e_bar
        if wp.static(plastic):
            t_bar = H_bar[p]
            L_bar += dt * (t_bar + t_bar * wp.transpose(H[r]))
            H_bar[p] = t_bar + A * t_bar
        if wp.static(branched):
            n_bar = HN_bar[p]
            L_bar += dt * (n_bar + n_bar * wp.transpose(HN[p]))
            HN_bar[p] = n_bar + A * n_bar
        if wp.static(opens):  # d ln det A = A⁻ᵀ : dA, A = I + Δt L
            D = eye() + dt * L
            L_bar += (dt * memory_bar[p][wp.static(at_log_J)] / wp.determinant(D)) * cofactor(D)
        if wp.static(turns):
            K = (real(-0.5) * dt) * (C_next + wp.transpose(C_next))
            B_bar += K * wp.transpose(L)
            L_bar += wp.transpose(B) * K
        if wp.static(not classic):
            B_bar += L_bar
        B_bar = c * B_bar  # acts on offsets in cells
        V0_bar, B0_bar, o = vec3(), mat33(), real(0.0)
        if wp.static(keeps):
            V0_bar = -alpha * v_next
            B0_bar = (-alpha * c) * C_next
            v_0_bar, C_0_bar = alpha * v_next, alpha * C_next
            if need_alpha and dt > real(0.0):
                V_0 = second(sum)
                lost = c * moments(V_0, second(m0), second(m1), second(m2), f) - C[r]
                alpha_bar[p] = alpha_bar[p] + wp.dot(v_next, v[r] - V_0) - wp.ddot(C_next, lost)
            if wp.static(driven):
                r_bar, v_0_bar, C_0_bar = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, v_0_bar, C_0_bar)
                x_next += r_bar
            v_bar[p] = v_0_bar
            C_bar[p] = C_0_bar
        else:
            v_bar[p] = vec3()
            C_bar[p] = mat33()
        q = row(v_next - B_bar * f, o, V0_bar - B0_bar * f)
        b0 = row(column(B_bar, 0), o, column(B0_bar, 0))
        b1 = row(column(B_bar, 1), o, column(B0_bar, 1))
        b2 = row(column(B_bar, 2), o, column(B0_bar, 2))
        if wp.static(classic):
            L_bar = idx * L_bar
            z = vec3()
            mean, along = gather_adjoint(
                grid_v, base, bar, lane, n, bx, by, bz, f, q, b0, b1, b2,
                row(column(L_bar, 0), o, z), row(column(L_bar, 1), o, z), row(column(L_bar, 2), o, z),
            )  # fmt: skip
        else:
            mean, along = gather_adjoint(grid_v, base, bar, lane, n, bx, by, bz, f, q, b0, b1, b2)
        along -= wp.transpose(B_bar) * first(mean)
        if wp.static(keeps):
            along -= wp.transpose(B0_bar) * second(mean)
        x_bar[p] = x_next + idx * along

    return g2p_adjoint


def _make_p2g_adjoint(variant: Variant) -> wp.Kernel:
    mixture, real = variant.mixture, variant.real
    vec3, mat33, node_t, step_t = variant.vec3, variant.mat33, variant.node_t, variant.step_t
    w_e_t, w_p_t, theta_t, memory_t = mixture.w_e_t, mixture.w_p_t, mixture.theta_t, mixture.memory_t
    transfer, rows, drives = make_transfer(variant.scheme, real), make_rows(variant), variant.drives
    spline, scatter_adjoint, row, column = transfer.spline, transfer.scatter_adjoint, rows.row, rows.column
    first, second, moments = rows.first, rows.second, rows.moments
    cell, eye = spline.cell, spline.eye
    stress, stress_adjoint = mixture.stress, mixture.stress_adjoint
    branch_stress, branch_stress_adjoint = mixture.branch_stress, mixture.branch_stress_adjoint
    memory, branched = len(mixture.memory) > 0, len(mixture.branches) > 0
    mixes_e, mixes_p = mixture.Ke > 1, mixture.Kp > 1
    body, driven, classic = variant.body, len(drives) > 0, variant.scheme.force == "classic"
    drive = make_drives(drives, real)
    drive_t, accelerate, accelerate_adjoint = drive.drive_t, drive.accelerate, drive.accelerate_adjoint
    hold, hold_adjoint = drive.hold, drive.hold_adjoint
    inverse = real(1 / variant.scheme.inertia)

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
        need_w_e: bool,
        need_w_p: bool,
        need_theta: bool,
        need_m: bool,
    ):
        p = start + wp.tid()
        r = at + p
        idx = real(1.0) / dx
        place = (X[p] - low) + u[r]
        bx, by, bz, f = cell(place * idx)
        step = steps[s]
        dt, kick = step[0], step[1]
        w_e_p = w_e_t()
        w_p_p = w_p_t()
        if wp.static(mixes_e):
            w_e_p = w_e[p]
        if wp.static(mixes_p):
            w_p_p = w_p[p]
        F = eye() + He[r]
        theta_p = theta[p]
        if wp.static(memory):
            tau, _Fe, _h = stress(F, w_e_p, w_p_p, theta_p, dt, memory_in[r])
        else:
            tau, _Fe = stress(F, w_e_p, w_p_p, theta_p, dt)
        if wp.static(branched):
            tau_N, _FN = branch_stress(eye() + HN[r], theta_p, dt)
            tau += tau_N
        m_p, v_p, C_p = m[p], v[r], C[r]
        a_p = vec3()
        if wp.static(driven):
            v_p, C_p = hold(place, v_p, C_p, tag[p], drive_row, s)
            a_p = accelerate(place, v_p, tag[p], drive_row, s)
        if wp.static(body):
            a_p += b[p]
        A = (m_p * dx) * C_p
        k = -kick * vol[p] * idx
        T = k * tau
        z, o = vec3(), real(0.0)
        q3, f3 = m_p * v_p - A * f, (kick * m_p) * a_p
        base = (p // per_scene) * (n[0] * n[1] * n[2])
        tau_bar = mat33()
        if wp.static(classic):
            sum, m0, m1, m2, g0, g1, g2, along = scatter_adjoint(
                bar, base, n, bx, by, bz, f, row(q3, m_p, f3),
                row(column(A, 0), o, z), row(column(A, 1), o, z), row(column(A, 2), o, z),
                row(z, o, column(T, 0)), row(z, o, column(T, 1)), row(z, o, column(T, 2)),
            )  # fmt: skip
            tau_bar = k * wp.matrix_from_cols(second(g0), second(g1), second(g2))
            along -= wp.transpose(A) * first(sum)
        else:
            k *= inverse
            T = k * tau
            sum, m0, m1, m2, along = scatter_adjoint(
                bar, base, n, bx, by, bz, f, row(q3, m_p, f3 - T * f),
                row(column(A, 0), o, column(T, 0)),
                row(column(A, 1), o, column(T, 1)),
                row(column(A, 2), o, column(T, 2)),
            )  # fmt: skip
            tau_bar = k * moments(second(sum), second(m0), second(m1), second(m2), f)
            along -= wp.transpose(A) * first(sum) + wp.transpose(T) * second(sum)
        S, S_f = first(sum), second(sum)
        A_bar = moments(S, first(m0), first(m1), first(m2), f)
        v_b, C_b, x_b = m_p * S, (m_p * dx) * A_bar, idx * along
        if wp.static(driven):
            r_b, v_a = accelerate_adjoint(place, v_p, tag[p], drive_row, s, (kick * m_p) * S_f)
            r_h, v_b, C_b = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, v_b + v_a, C_b)
            x_b += r_b + r_h
        x_bar[p] = x_bar[p] + x_b
        v_bar[p] = v_bar[p] + v_b
        C_bar[p] = C_bar[p] + C_b
        if wp.static(memory):
            F_bar, we_b, wp_b, th_b, h_b = stress_adjoint(
                F, w_e_p, w_p_p, theta_p, dt, tau_bar, He_bar[p], memory_in[r], memory_bar[p]
            )
            memory_bar[p] = h_b
        else:
            F_bar, we_b, wp_b, th_b = stress_adjoint(F, w_e_p, w_p_p, theta_p, dt, tau_bar, He_bar[p])
        He_bar[p] = F_bar
        if wp.static(branched):
            FN_bar, th_N = branch_stress_adjoint(eye() + HN[r], theta_p, dt, tau_bar, HN_bar[p])
            HN_bar[p] = FN_bar
            th_b += th_N
        if need_w_e:
            w_e_bar[p] = w_e_bar[p] + we_b
        if need_w_p:
            w_p_bar[p] = w_p_bar[p] + wp_b
        if need_theta:
            theta_bar[p] = theta_bar[p] + th_b
        if need_m:
            m_bar[p] = m_bar[p] + wp.dot(S, v_p) + dx * wp.ddot(A_bar, C_p) + sum[3] + kick * wp.dot(S_f, a_p)

    return p2g_adjoint
