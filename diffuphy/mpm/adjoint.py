"""Adjoint of one substep, by hand: only particle states are kept, the grid is computed again.

With bars for ∂loss/∂, v_i after contact and P = 1/m_i the scaling of the grid, one step backwards is

    g2p     V̄_p = v̄_p' + Δt x̄_p',  C̄_p ← C̄_p' + Δt H̄_p' Fe_pᵀ,  F̄e_p = (I + Δt C_p')ᵀ H̄_p'
            v̄_i = Σ_p w_ip (V̄_p + (4/Δx²) C̄_p d_ip),     x̄_p += Σ_i v_i · ∂(w_ip (V̄_p + (4/Δx²) C̄_p d_ip))/∂x_p
    grid    v̄_i ← contactᵀ v̄_i,   q̄_i = v̄_i / m_i,   m̄_i = −v̄_i · q_i / m_i²
    p2g     S = Σ_i w_ip q̄_i,  Ā = Σ_i w_ip q̄_i d_ipᵀ:   v̄_p = m_p S,  C̄_p = m_p Ā,  τ̄_p = −Δt V_p (4/Δx²) Ā,
            m̄_p = S·v_p + Ā:C_p + Σ_i w_ip m̄_i,  x̄_p += Σ_i (q̄_i · q_ip + m̄_i m_p) ∂w_ip/∂x_p − Aᵀ S
            and (τ̄_p, F̄e_p) → H̄_p, w̄, θ̄ by the mixture's own adjoint

with d_ip = x_i − x_p. A particle's row is written by its own thread alone; only the grid is summed into.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from diffuphy.material import linalg
from diffuphy.mpm.boundary import Signature, make_contact
from diffuphy.mpm.kernels import cached, make_kernels, make_spline

Needs = tuple[bool, bool, bool, bool]
"""Which of w_e, w_p, θ, mass need a gradient; the others get no buffer. It is data: one compiled kernel serves all
sixteen cases."""


def make_adjoint(mixture: Any, walls: Signature, real: type) -> SimpleNamespace:
    """The four kernels of a backward substep: ``grid_again``, ``g2p_adjoint``, ``grid_adjoint``, ``p2g_adjoint``.

    Cached.
    """
    return cached(_make_adjoint, mixture, walls, real)


def _make_adjoint(mixture: Any, walls: Signature, real: type) -> SimpleNamespace:
    forward = make_kernels(mixture, walls, real)
    vec3, mat33, vec4, wall_t = forward.vec3, forward.mat33, forward.vec4, forward.wall_t
    w_e_t, w_p_t, theta_t = mixture.w_e_t, mixture.w_p_t, mixture.theta_t
    spline, contact = make_spline(real), make_contact(walls, real)
    weights, slopes, cell, columns, eye = spline.weights, spline.slopes, spline.cell, spline.columns, spline.eye
    stress, stress_adjoint = mixture.stress, mixture.stress_adjoint
    apply, contact_adjoint, velocity, place = contact.apply, contact.adjoint, forward.velocity, forward.place
    plastic, has_walls = mixture.is_plastic, len(walls) > 0
    memory, cofactor = mixture.volumetric_memory, linalg.build(real).cofactor
    ke, kp = mixture.Ke, mixture.Kp

    @wp.func
    def gathered(
        grid_bar: wp.array[vec4],
        n: wp.vec3i,
        bx: wp.int32,
        by: wp.int32,
        bz: wp.int32,
        f: vec3,
        q: vec4,
        A: mat33,
    ):
        """What the nodes return to a particle that gave them w_ip q_ip, q_ip = q + A (x_i − x_low): Σ_i w_ip q̄_i, its
        first moments about the particle Σ_i w_ip q̄_i d_ipᵀ, and Σ_i (q̄_i · q_ip) ∂w_ip; lengths in cells."""
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        a0, a1, a2 = columns(A)
        s0, s1, s2, s3 = vec4(), vec4(), vec4(), vec4()
        along = vec3()
        for i in range(3):
            for j in range(3):
                w_ij = wx[i] * wy[j]
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                g0 = grid_bar[o]
                g1 = grid_bar[o + 1]
                g2 = grid_bar[o + 2]
                d0, d1, d2 = wp.dot(g0, q_ij), wp.dot(g1, q_ij + a2), wp.dot(g2, q_ij + real(2.0) * a2)
                s_w = wz[0] * d0 + wz[1] * d1 + wz[2] * d2
                s_d = dwz[0] * d0 + dwz[1] * d1 + dwz[2] * d2
                along += vec3(dwx[i] * wy[j] * s_w, wx[i] * dwy[j] * s_w, w_ij * s_d)
                t0, t1, t2 = (w_ij * wz[0]) * g0, (w_ij * wz[1]) * g1, (w_ij * wz[2]) * g2
                t = t0 + t1 + t2
                s3 += t
                s0 += wp.static(real(i)) * t
                s1 += wp.static(real(j)) * t
                s2 += t1 + real(2.0) * t2
        S = vec3(s3[0], s3[1], s3[2])
        A_bar = wp.matrix_from_cols(
            vec3(s0[0], s0[1], s0[2]) - S * f[0],
            vec3(s1[0], s1[1], s1[2]) - S * f[1],
            vec3(s2[0], s2[1], s2[2]) - S * f[2],
        )
        return s3, A_bar, along

    @wp.kernel(module="unique", enable_backward=False)
    def grid_again(
        grid: wp.array[vec4],  # (nodes,) momentum, mass; kept for grid_adjoint
        row: wp.array2d[wall_t],
        sdf: wp.array[real],  # samples of signed-distance walls [m]
        s: wp.int32,
        g_dt: vec3,
        dx: real,
        n: wp.vec3i,
        grid_v: wp.array[vec4],  # (nodes,) velocity   out
        grid_bar: wp.array[vec4],  # (nodes,) cleared for g2p_adjoint
    ):
        o = wp.tid()
        a = grid[o]
        if a[3] > real(0.0):
            v = velocity(a, g_dt)
            if wp.static(has_walls):
                v = apply(v, place(o, n, dx), row, sdf, s)
            grid_v[o] = vec4(v[0], v[1], v[2], real(0.0))
            grid_bar[o] = vec4(real(0.0))

    @wp.kernel(module="unique", enable_backward=False)
    def g2p_adjoint(
        X: wp.array[vec3],
        u: wp.array[vec3],
        He: wp.array[mat33],  # elastic part minus I: with plasticity after flow, one row a particle, else rows as u
        H: wp.array[mat33],  # total minus I, only with plasticity
        C: wp.array[mat33],
        grid_v: wp.array[vec4],
        low: vec3,
        dx: real,
        dt: real,
        n: wp.vec3i,
        at: wp.int32,  # first row of the beginning of the step
        to: wp.int32,  # first row of its end
        x_bar: wp.array[vec3],  # in: of the end, out: of the beginning, the p2g part still missing; likewise below
        v_bar: wp.array[vec3],
        C_bar: wp.array[mat33],
        He_bar: wp.array[mat33],  # out: of Fe
        H_bar: wp.array[mat33],
        log_J_bar: wp.array[real],
        grid_bar: wp.array[vec4],  # (nodes,) of the node velocities   out
    ):
        p = wp.tid()
        r = at + p
        idx = real(1.0) / dx
        g = ((X[p] - low) + u[r]) * idx
        bx, by, bz, f = cell(g)
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dwx, dwy, dwz = slopes(f[0]), slopes(f[1]), slopes(f[2])
        Lt = dt * wp.transpose(C[to + p])
        e = r
        if wp.static(plastic):
            e = p
        e_bar = He_bar[p]
        B = C_bar[p] + dt * (e_bar + e_bar * wp.transpose(He[e]))
        He_bar[p] = e_bar + Lt * e_bar
        if wp.static(plastic):
            t_bar = H_bar[p]
            B += dt * (t_bar + t_bar * wp.transpose(H[r]))
            H_bar[p] = t_bar + Lt * t_bar
        if wp.static(memory):  # d ln det A = A⁻ᵀ : dA, A = I + Δt C
            A = eye() + dt * C[to + p]
            B += (dt * log_J_bar[p] / wp.determinant(A)) * cofactor(A)
        B = (real(4.0) * idx) * B  # acts on offsets in cells
        x_next = x_bar[p]
        q3 = v_bar[p] + dt * x_next - B * f
        q = vec4(q3[0], q3[1], q3[2], real(0.0))
        b0, b1, b2 = columns(B)
        along = vec3()
        total = vec4()
        for i in range(3):
            for j in range(3):
                w_ij = wx[i] * wy[j]
                q_ij = q + wp.static(real(i)) * b0 + wp.static(real(j)) * b1
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                s_w, s_d = real(0.0), real(0.0)
                for k in range(3):
                    h = q_ij + wp.static(real(k)) * b2
                    v_i = grid_v[o + k]
                    wp.atomic_add(grid_bar, o + k, (w_ij * wz[k]) * h)
                    s = wp.dot(v_i, h)
                    s_w += wz[k] * s
                    s_d += dwz[k] * s
                    total += (w_ij * wz[k]) * v_i
                along += vec3(dwx[i] * wy[j] * s_w, wx[i] * dwy[j] * s_w, w_ij * s_d)
        mean = vec3(total[0], total[1], total[2])
        x_bar[p] = x_next + idx * (along - wp.transpose(B) * mean)

    @wp.kernel(module="unique", enable_backward=False)
    def grid_adjoint(
        grid: wp.array[vec4],  # (nodes,) momentum, mass   in, and cleared for the next step
        row: wp.array2d[wall_t],
        sdf: wp.array[real],  # samples of signed-distance walls [m]
        s: wp.int32,
        g_dt: vec3,
        dx: real,
        n: wp.vec3i,
        grid_bar: wp.array[vec4],  # (nodes,) in: of the velocity, out: of momentum and mass
    ):
        o = wp.tid()
        a = grid[o]
        if a[3] > real(0.0):
            b4 = grid_bar[o]
            b = vec3(b4[0], b4[1], b4[2])
            if wp.static(has_walls):
                b = contact_adjoint(velocity(a, g_dt), place(o, n, dx), row, sdf, s, b)
            b = vec3(b[0] / a[3], b[1] / a[3], b[2] / a[3])
            v = velocity(a, vec3())
            grid_bar[o] = vec4(b[0], b[1], b[2], -wp.dot(b, v))
            grid[o] = vec4(real(0.0))

    @wp.kernel(module="unique", enable_backward=False)
    def p2g_adjoint(
        X: wp.array[vec3],
        u: wp.array[vec3],
        v: wp.array[vec3],
        C: wp.array[mat33],
        He: wp.array[mat33],  # (N,) trial elastic part minus I
        log_J: wp.array[real],  # (N,) ln det of the total one, only with volumetric memory
        w_e: wp.array[w_e_t],
        w_p: wp.array[w_p_t],
        theta: wp.array[theta_t],
        m: wp.array[real],
        vol: wp.array[real],
        low: vec3,
        dx: real,
        dt: real,
        n: wp.vec3i,
        at: wp.int32,
        grid_bar: wp.array[vec4],
        x_bar: wp.array[vec3],
        v_bar: wp.array[vec3],
        C_bar: wp.array[mat33],
        He_bar: wp.array[mat33],  # in: of Fe, out: of the trial elastic part
        log_J_bar: wp.array[real],
        w_e_bar: wp.array[w_e_t],  # summed over substeps; likewise below
        w_p_bar: wp.array[w_p_t],
        theta_bar: wp.array[theta_t],
        m_bar: wp.array[real],
        need_w_e: bool,
        need_w_p: bool,
        need_theta: bool,
        need_m: bool,
    ):
        p = wp.tid()
        r = at + p
        idx = real(1.0) / dx
        g = ((X[p] - low) + u[r]) * idx
        bx, by, bz, f = cell(g)
        w_e_p = w_e_t()
        w_p_p = w_p_t()
        if wp.static(ke > 1):
            w_e_p = w_e[p]
        if wp.static(kp > 1):
            w_p_p = w_p[p]
        F = eye() + He[r]
        theta_p = theta[p]
        if wp.static(memory):
            tau, _Fe = stress(F, w_e_p, w_p_p, theta_p, dt, log_J[r])
        else:
            tau, _Fe = stress(F, w_e_p, w_p_p, theta_p, dt)
        k4 = real(4.0) * dt * vol[p] * idx
        m_p, v_p, C_p = m[p], v[r], C[r]
        A = (m_p * dx) * C_p - k4 * tau
        q3 = m_p * v_p - A * f
        q = vec4(q3[0], q3[1], q3[2], m_p)
        s3, A_bar, along = gathered(grid_bar, n, bx, by, bz, f, q, A)
        S = vec3(s3[0], s3[1], s3[2])
        x_bar[p] = x_bar[p] + idx * (along - wp.transpose(A) * S)
        v_bar[p] = m_p * S
        C_bar[p] = (m_p * dx) * A_bar
        tau_bar = -k4 * A_bar
        if wp.static(memory):
            F_bar, we_b, wp_b, th_b, t_b = stress_adjoint(F, w_e_p, w_p_p, theta_p, dt, tau_bar, He_bar[p], log_J[r])
            log_J_bar[p] = log_J_bar[p] + t_b
        else:
            F_bar, we_b, wp_b, th_b = stress_adjoint(F, w_e_p, w_p_p, theta_p, dt, tau_bar, He_bar[p])
        He_bar[p] = F_bar
        if need_w_e:
            w_e_bar[p] = w_e_bar[p] + we_b
        if need_w_p:
            w_p_bar[p] = w_p_bar[p] + wp_b
        if need_theta:
            theta_bar[p] = theta_bar[p] + th_b
        if need_m:
            m_bar[p] = m_bar[p] + wp.dot(S, v_p) + dx * wp.ddot(A_bar, C_p) + s3[3]

    return SimpleNamespace(
        grid_again=grid_again, g2p_adjoint=g2p_adjoint, grid_adjoint=grid_adjoint, p2g_adjoint=p2g_adjoint
    )
