"""MPM on the particles, compiled for one variant: particles to grid, grid to particles.

    stress            F = I + H,  (τ_p, Fe_p − F) = stress(F, H)
    to the grid       m_i = Σ_p w_ip m_p,   q_i = Σ_p w_ip m_p (v_p + C_p d_ip)
                      f_i = k Σ_p [ −V_p τ_p ∇w_ip + w_ip m_p b_p ],   MLS: ∇w_ip → w_ip d_ip / D
    on the grid       see ``nodes``: v⁰_i = q_i/m_i,  v_i = contact(v⁰_i + a*_i)
    to the particles  V = Σ w v_i,  V⁰ = Σ w v⁰_i,  B = Σ w v_i dᵀ/D,  B⁰ = Σ w v⁰_i dᵀ/D,  L = B, classic: Σ v_i ∇wᵀ
                      v ← V + α (v − V⁰),   C ← B + α (C − B⁰) − Δt turned(B, L),   x ← x + Δt v,
                      H ← Fe − I + Δt L Fe,  ln J ← ln J + ln det(I + Δt L)

d_ip = x_i − x_p, D = Δx²/4 (quadratic) or Δx²/3 (cubic). k is the kick of the substep, half of Δt at both ends of a
frame: the last substep kicks without drifting, with α = 1. turned(B, L) = sym(B L) is the change of an affine field
that moves with the matter; it exists only with retention, and is kept from adding to the energy m D |C|²/2: of a drop
that contracts alone, whose inertia D stays what it is, it would make more and more. Jiang et al. 2015; Hu et al. 2018,
eqs. 16–17.

A position is kept as X + u with X that of the beginning of the frame, a deformation gradient as H = F − I: increments
of one substep are far below the rounding of x and of F in float32, but not below that of u and H.
"""

from types import SimpleNamespace

import warp as wp

from diffuphy.material import volume
from diffuphy.mpm.drive import make_drives
from diffuphy.mpm.substep.obstacle import make_obstacle
from diffuphy.mpm.substep.rows import make_around, make_rows
from diffuphy.mpm.substep.transfer import make_transfer
from diffuphy.mpm.substep.variant import Variant

LEFT, INVERTED, FAST = 0, 1, 2
"""What a particle may do wrong, as the place in the status array where 1 + its index goes."""

SQUEEZED = 64
"""Least det Fe that means something, in rounding units ε of 1. F = I + H is known to ε/2, hence det F of what is
squeezed along one axis to ε/2 det F of itself: at 64 ε to 1 %. The logarithm in a law hides it: its stress stays finite
where no volume is left."""


def least_volume(real: type) -> float:
    """SQUEEZED ε [-]: 7.6e-6 in float32, 1.4e-14 in float64."""
    return SQUEEZED * (2.0**-52 if real is wp.float64 else 2.0**-23)


def make_kernels(variant: Variant) -> SimpleNamespace:
    """The kernels ``p2g`` and ``g2p`` of a substep. Cached; safe to call from several threads."""
    return variant.made(_make_kernels)


def _make_kernels(v: Variant) -> SimpleNamespace:
    return SimpleNamespace(p2g=_make_p2g(v), g2p=_make_g2p(v))


def _make_p2g(variant: Variant) -> wp.Kernel:
    mixture, real = variant.mixture, variant.real
    vec3, mat33, node_t, step_t = variant.vec3, variant.mat33, variant.node_t, variant.step_t
    w_e_t, w_p_t, theta_t, memory_t = mixture.w_e_t, mixture.w_p_t, mixture.theta_t, mixture.memory_t
    spline, rows, drives = make_transfer(variant.scheme, real).spline, make_rows(variant), variant.drives
    inside, cell, eye, bring = spline.inside, spline.cell, spline.eye, _make_bring(variant)
    stress, branch_stress = mixture.stress, mixture.branch_stress
    plastic, memory, branched = mixture.is_plastic, len(mixture.memory) > 0, len(mixture.branches) > 0
    material_of, beside, wall_t = rows.material_of, rows.beside, rows.wall_t
    body, driven, sparse = variant.body, len(drives) > 0, variant.sparse
    drive = make_drives(drives, real)
    drive_t, accelerate, hold = drive.drive_t, drive.accelerate, drive.hold
    obstructs, holding, joined = variant.obstructs, drive.holding, drive.joined
    mark, join = make_obstacle(variant).mark, make_obstacle(variant).join

    @wp.kernel(module="unique", enable_backward=False)
    def p2g(
        X: wp.array[vec3],  # (N,) [m]   position at the beginning of the frame
        u: wp.array[vec3],  # (N,) [m]   displacement since
        v: wp.array[vec3],  # (N,) [m/s]
        C: wp.array[mat33],  # (N,) [1/s]
        He: wp.array[mat33],  # (N,) [-]  trial elastic deformation gradient minus I
        HN: wp.array[mat33],  # (N,) [-]  that of the viscous branch, only with one
        memory_in: wp.array[memory_t],  # (N,)  only of laws that remember
        w_e: wp.array[w_e_t],  # (N,) [-]
        w_p: wp.array[w_p_t],  # (N,) [-]
        theta: wp.array[theta_t],  # (N,) SI
        m: wp.array[real],  # (N,) [kg]
        vol: wp.array[real],  # (N,) [m³]
        b: wp.array[vec3],  # (N,) [m/s²]  only with a body acceleration
        tag: wp.array[wp.int32],  # (N,)  only with drives
        drive_row: wp.array2d[drive_t],  # (substeps, drives)
        wall_row: wp.array2d[wall_t],  # (substeps, walls)  only with elastic walls
        sdf: wp.array[real],
        ws: wp.int32,  # row of this substep
        low: vec3,  # [m]  lowest node
        dx: real,
        n: wp.vec3i,  # nodes along each axis
        per: wp.int32,  # particles of a lane; every lane has a copy of the nodes
        steps: wp.array[step_t],
        s: wp.int32,  # number of this substep
        at: wp.int32,  # first row of this state in u, v, C, He
        to: wp.int32,  # first row of the next one
        start: wp.int32,  # first particle of this launch
        cells: wp.array[wp.uint8],  # (nodes,) where a particle may be, only if sparse
        grid: wp.array[node_t],  # (lanes · nodes,) momentum [kg m/s], mass [kg], impulse [N s]   out
        pins: wp.array[node_t],  # (lanes · nodes,) of held matter, see ``obstacle``   out, only with some
        He_out: wp.array[mat33],  # (N,) [-]  elastic part minus I, after flow   out, only with plasticity
        HN_out: wp.array[mat33],
        memory_out: wp.array[memory_t],
        status: wp.array[wp.int32],  # (3,)   out
    ):
        p = start + wp.tid()
        r = at + p
        idx = real(1.0) / dx
        place = (X[p] - low) + u[r]
        g = place * idx
        if not inside(g, n):
            wp.atomic_max(status, LEFT, p + 1)
            return
        bx, by, bz, f = cell(g)
        if wp.static(sparse):
            if cells[(bx * n[1] + by) * n[2] + bz] == wp.uint8(0):
                wp.atomic_max(status, LEFT, p + 1)
                return
        step = steps[s]
        dt, kick = step[0], step[1]
        w_e_p, w_p_p, theta_p = material_of(w_e, w_p, theta, p)
        F = eye() + He[r]
        if wp.static(memory):
            tau, flow_p, h = stress(F, He[r], w_e_p, w_p_p, theta_p, dt, memory_in[r])
            memory_out[to + p] = h
        else:
            tau, flow_p = stress(F, He[r], w_e_p, w_p_p, theta_p, dt)
        if wp.static(plastic):
            He_out[p] = He[r] + flow_p
        if wp.static(branched):
            tau_N, flow_N = branch_stress(eye() + HN[r], HN[r], theta_p, dt)
            HN_out[p] = HN[r] + flow_N
            tau += tau_N
        m_p = m[p]
        v_p = v[r]
        C_p = C[r]
        a_p = vec3()
        if wp.static(driven):
            v_p, C_p = hold(place, v_p, C_p, tag[p], drive_row, s)
            a_p = accelerate(place, v_p, tag[p], drive_row, s)
        if wp.static(body):
            a_p += b[p]
        T = (-kick * vol[p] * idx) * tau
        phi, _n = beside(place, dx, wall_row, sdf, ws)
        base = (p // per) * (n[0] * n[1] * n[2])
        if wp.static(obstructs):
            if holding(tag[p], drive_row, s):
                mark(pins, base, n, bx, by, bz, f, dx, vol[p], v_p, C_p)
                return
            if joined(tag[p]):
                join(pins, base, n, bx, by, bz, f, m_p)
        bring(grid, base, n, bx, by, bz, f, m_p, v_p, (m_p * dx) * C_p, (kick * m_p) * a_p, T, phi)

    return p2g


def _make_bring(variant: Variant) -> wp.Function:
    """Warp function: gives its nodes what a particle brings: mass, momentum m v with the affine part A per cell,
    impulse g, that of stress T per cell, and mass times the distance φ to a wall."""
    real, vec3, mat33, node_t = variant.real, variant.vec3, variant.mat33, variant.node_t
    scatter, rows = make_transfer(variant.scheme, real).scatter, make_rows(variant)
    row, placed, column = rows.row, rows.placed, rows.column
    classic, inverse = variant.scheme.force == "classic", real(1 / variant.scheme.inertia)

    @wp.func(module="unique")
    def bring(
        grid: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        m: real, v: vec3, A: mat33, g: vec3, T: mat33, phi: real,
    ):  # fmt: skip
        q, z, o = m * v - A * f, vec3(), real(0.0)
        if wp.static(classic):
            scatter(
                grid, base, n, bx, by, bz, f, placed(row(q, m, g), phi),
                row(column(A, 0), o, z), row(column(A, 1), o, z), row(column(A, 2), o, z),
                row(z, o, column(T, 0)), row(z, o, column(T, 1)), row(z, o, column(T, 2)),
            )  # fmt: skip
        else:
            T = inverse * T
            scatter(
                grid, base, n, bx, by, bz, f, placed(row(q, m, g - T * f), phi),
                row(column(A, 0), o, column(T, 0)),
                row(column(A, 1), o, column(T, 1)),
                row(column(A, 2), o, column(T, 2)),
            )  # fmt: skip

    return bring


def _make_g2p(variant: Variant) -> wp.Kernel:
    mixture, real = variant.mixture, variant.real
    vec3, mat33, node_t, step_t, memory_t = (
        variant.vec3, variant.mat33, variant.node_t, variant.step_t, mixture.memory_t
    )  # fmt: skip
    spline, drives = make_transfer(variant.scheme, real).spline, variant.drives
    around, log_det, turned = make_around(variant).around, make_rows(variant).log_det, make_rows(variant).turned
    inside, cell, eye = spline.inside, spline.cell, spline.eye
    plastic, branched = mixture.is_plastic, len(mixture.branches) > 0
    opens = "log_J" in mixture.memory
    at_log_J = mixture.memory.index("log_J") if opens else 0
    driven, keeps, turns = len(drives) > 0, variant.scheme.keeps, variant.scheme.retain > 0.0
    drive = make_drives(drives, real)
    drive_t, hold = drive.drive_t, drive.hold
    sparse, determinant, least = variant.sparse, volume.build(real).determinant, real(least_volume(real))

    @wp.kernel(module="unique", enable_backward=False)
    def g2p(
        X: wp.array[vec3],
        u: wp.array[vec3],
        v: wp.array[vec3],
        C: wp.array[mat33],
        He: wp.array[mat33],  # elastic part minus I: with plasticity after flow, one row a particle, else rows as u
        H: wp.array[mat33],  # (N,) [-]  total deformation gradient minus I, only with plasticity
        HN: wp.array[mat33],  # (N,) [-]  viscous branch after flow, one row a particle
        grid_v: wp.array[node_t],  # (scenes · nodes,) velocity after the step and before it [m/s]
        tag: wp.array[wp.int32],
        drive_row: wp.array2d[drive_t],
        low: vec3,
        dx: real,
        n: wp.vec3i,
        per: wp.int32,  # particles of a scene
        steps: wp.array[step_t],
        s: wp.int32,
        at: wp.int32,  # first row of this state
        to: wp.int32,  # first row of the next one; may be the same
        start: wp.int32,
        cells: wp.array[wp.uint8],  # as above
        u_out: wp.array[vec3],
        v_out: wp.array[vec3],
        C_out: wp.array[mat33],
        He_out: wp.array[mat33],
        H_out: wp.array[mat33],
        HN_out: wp.array[mat33],
        memory_out: wp.array[memory_t],
        status: wp.array[wp.int32],
    ):
        p = start + wp.tid()
        r, t = at + p, to + p
        idx = real(1.0) / dx
        u_p = u[r]
        place = (X[p] - low) + u_p
        g = place * idx
        if not inside(g, n):
            return
        bx, by, bz, f = cell(g)
        if wp.static(sparse):
            if cells[(bx * n[1] + by) * n[2] + bz] == wp.uint8(0):
                return
        dt, alpha = steps[s][0], steps[s][2]
        base = (p // per) * (n[0] * n[1] * n[2])
        C_p, L, v_p, V_0, B_0 = around(grid_v, base, n, bx, by, bz, f, idx)
        if wp.static(driven):
            _v, L = hold(place, v_p, L, tag[p], drive_row, s)
        if wp.static(keeps):
            v_0 = v[r]
            C_0 = C[r]
            if wp.static(driven):
                v_0, C_0 = hold(place, v_0, C_0, tag[p], drive_row, s)
            if wp.static(turns):
                C_p -= dt * turned(C_p, L)
            v_p += alpha * (v_0 - V_0)
            C_p += alpha * (C_0 - B_0)
        if wp.static(driven):
            v_p, C_p = hold(place, v_p, C_p, tag[p], drive_row, s)
        L = dt * L
        He_p = He[wp.where(wp.static(plastic), p, r)]
        He_p += L + L * He_p
        if determinant(eye() + He_p) < least:
            wp.atomic_max(status, INVERTED, p + 1)
        if wp.dot(v_p, v_p) * dt * dt > dx * dx:
            wp.atomic_max(status, FAST, p + 1)
        u_out[t] = u_p + dt * v_p
        v_out[t] = v_p
        C_out[t] = C_p
        He_out[t] = He_p
        if wp.static(plastic):
            H_p = H[r]
            H_out[t] = H_p + L + L * H_p
        if wp.static(branched):
            HN_p = HN[p]
            HN_out[t] = HN_p + L + L * HN_p
        if wp.static(opens):
            h = memory_out[t]  # p2g has written what flow adds
            h[wp.static(at_log_J)] = h[wp.static(at_log_J)] + log_det(L)
            memory_out[t] = h

    return g2p
