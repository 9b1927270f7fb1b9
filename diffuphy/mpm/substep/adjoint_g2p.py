"""Adjoint of the way from the grid to the particles; ``adjoint`` has the formulas."""

from typing import Any

import warp as wp

from diffuphy.material import linalg
from diffuphy.mpm.drive import make_drives
from diffuphy.mpm.substep.rows import make_around, make_rows
from diffuphy.mpm.substep.survey import make_survey
from diffuphy.mpm.substep.transfer import make_transfer
from diffuphy.mpm.substep.variant import Variant


def make_g2p_adjoint(variant: Variant) -> wp.Kernel:
    """The kernel ``g2p_adjoint``; ``adjoint`` has its formulas."""
    mixture, real = variant.mixture, variant.real
    vec3, mat33, node_t, step_t = variant.vec3, variant.mat33, variant.node_t, variant.step_t
    memory_t = mixture.memory_t
    transfer, rows, drives = make_transfer(variant.scheme, real), make_rows(variant), variant.drives
    spline, carried_adjoint, turned_adjoint = transfer.spline, rows.carried_adjoint, rows.turned_adjoint
    survey, surveyed = make_survey(variant.scheme, real).survey, make_around(variant).surveyed
    to_nodes = _make_to_nodes(variant)
    cell, eye, cofactor = spline.cell, spline.eye, linalg.build(real).cofactor
    plastic, branched = mixture.is_plastic, len(mixture.branches) > 0
    opens = "log_J" in mixture.memory
    at_log_J = mixture.memory.index("log_J") if opens else 0
    driven, classic, keeps = len(drives) > 0, variant.scheme.force == "classic", variant.scheme.keeps
    turns = variant.scheme.retain > 0.0
    drive = make_drives(drives, real)
    drive_t, hold, hold_adjoint = drive.drive_t, drive.hold, drive.hold_adjoint
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
        dt, alpha = steps[s][0], steps[s][2]
        nodes = n[0] * n[1] * n[2]
        base, lane = (p // per_scene) * nodes, (p // per) * nodes
        c = inverse * idx
        around = survey(grid_v, base, n, bx, by, bz, f)
        B, L, V_0, B_0 = surveyed(around, f, idx)
        if wp.static(driven):
            _v, L = hold(place, v[r], L, tag[p], drive_row, s)
        x_next = x_bar[p]
        v_next = v_bar[p] + dt * x_next
        C_next = C_bar[p]
        if wp.static(driven):  # the values that hold overwrites do not matter to its adjoint
            r_bar, v_next, C_next = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, v_next, C_next)
            x_next += r_bar
        B_bar = C_next
        A = dt * L
        A_bar, e_bar = carried_adjoint(He_bar[p], He[wp.where(wp.static(plastic), p, r)], A)
        He_bar[p] = e_bar
        if wp.static(plastic):
            A_t, e_bar = carried_adjoint(H_bar[p], H[r], A)
            A_bar += A_t
            H_bar[p] = e_bar
        if wp.static(branched):
            A_n, n_bar = carried_adjoint(HN_bar[p], HN[p], A)
            A_bar += A_n
            HN_bar[p] = n_bar
        if wp.static(opens):  # d ln det D = D⁻ᵀ : dD
            A_bar += (memory_bar[p][wp.static(at_log_J)] / wp.determinant(eye() + A)) * cofactor(eye() + A)
        L_bar = dt * A_bar
        if wp.static(turns):
            B_turn, L_turn = turned_adjoint(B, L, -dt * C_next)
            B_bar += B_turn
            L_bar += L_turn
        if wp.static(driven):
            _r, _v_bar, L_bar = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, vec3(), L_bar)
        if wp.static(not classic):
            B_bar += L_bar
        B_bar = c * B_bar  # acts on offsets in cells
        V0_bar, B0_bar = vec3(), mat33()
        if wp.static(keeps):
            V0_bar = -alpha * v_next
            B0_bar = (-alpha * c) * C_next
            v_0_bar, C_0_bar = alpha * v_next, alpha * C_next
            if need_alpha and dt > real(0.0):
                alpha_bar[p] = alpha_bar[p] + wp.dot(v_next, v[r] - V_0) - wp.ddot(C_next, B_0 - C[r])
            if wp.static(driven):
                r_bar, v_0_bar, C_0_bar = hold_adjoint(place, v[r], C[r], tag[p], drive_row, s, v_0_bar, C_0_bar)
                x_next += r_bar
            v_bar[p] = v_0_bar
            C_bar[p] = C_0_bar
        else:
            v_bar[p] = vec3()
            C_bar[p] = mat33()
        along = to_nodes(around, bar, lane, n, bx, by, bz, f, v_next, V0_bar, B_bar, B0_bar, idx * L_bar)
        x_bar[p] = x_next + idx * along

    return g2p_adjoint


def _make_to_nodes(variant: Variant) -> wp.Function:
    """Warp function: adds what a particle hands back to the bars of its nodes; the derivative along each axis [cells]
    of Σ_i row_i · that."""
    real, vec3, mat33, node_t = variant.real, variant.vec3, variant.mat33, variant.node_t
    scatter, slope, rows = (
        make_transfer(variant.scheme, real).scatter, make_survey(variant.scheme, real).along, make_rows(variant)
    )  # fmt: skip
    row, first, second, column, affine = rows.row, rows.first, rows.second, rows.column, rows.affine
    classic, keeps = variant.scheme.force == "classic", variant.scheme.keeps

    @wp.func(module="unique")
    def to_nodes(
        around: Any, bar: wp.array[node_t], lane: wp.int32, n: wp.vec3i,
        bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3, V: vec3, V0: vec3, B: mat33, B0: mat33, G: mat33,
    ):  # fmt: skip
        q, b0, b1, b2 = affine(V, V0, B, B0, f)
        if wp.static(classic):
            z, o = vec3(), real(0.0)
            c0, c1, c2 = row(column(G, 0), o, z), row(column(G, 1), o, z), row(column(G, 2), o, z)
            scatter(bar, lane, n, bx, by, bz, f, q, b0, b1, b2, c0, c1, c2)
            along = slope(around, q, b0, b1, b2, c0, c1, c2)
        else:
            scatter(bar, lane, n, bx, by, bz, f, q, b0, b1, b2)
            along = slope(around, q, b0, b1, b2)
        along -= wp.transpose(B) * first(around[0])
        if wp.static(keeps):
            along -= wp.transpose(B0) * second(around[0])
        return along

    return to_nodes
