"""MLS-MPM kernels, compiled for one mixture of laws, one list of walls and one precision.

    gather of state   F = I + H,  (τ_p, Fe_p) = stress(F)
    to the grid       m_i = Σ_p w_ip m_p
                      q_i = Σ_p w_ip [ m_p v_p + (m_p C_p − Δt V_p (4/Δx²) τ_p) (x_i − x_p) ]
    on the grid       v_i = contact(q_i / m_i + Δt g)
    to the particles  v_p = Σ_i w_ip v_i,   C_p = (4/Δx²) Σ_i w_ip v_i (x_i − x_p)ᵀ,
                      x_p ← x_p + Δt v_p,   H_p ← Fe_p − I + Δt C_p Fe_p,
                      with volumetric memory ln J_p ← ln J_p + ln det(I + Δt C_p)

Quadratic B-splines, affine transfer (Jiang et al. 2015) with the moving-least-squares force (Hu et al. 2018, eqs.
16–17), D = Δx²/4.

A position is kept as X + u with X that of the beginning of the frame, a deformation gradient as H = F − I: increments
of one substep are far below the rounding of x and of F in float32, but not below that of u and H.
"""

from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from diffuphy.compiling import LOCK
from diffuphy.mpm.boundary import Signature, make_contact

LEFT, INVERTED, FAST = 0, 1, 2
"""What a particle may do wrong, as the place in the status array where 1 + its index goes."""

_made: dict[tuple[Any, ...], tuple[Any, SimpleNamespace]] = {}


@lru_cache
def make_spline(real: type) -> SimpleNamespace:
    """Quadratic B-spline and its derivative at the three nodes around a particle, and what else transfers share."""
    vec3, vec4, mat33 = wp.types.vector(3, real), wp.types.vector(4, real), wp.types.matrix((3, 3), real)

    @wp.func
    def weights(f: real):
        """w(f), f the distance to the lowest of the three nodes in cells, ½ ≤ f < 3/2."""
        a, b, c = real(1.5) - f, f - real(1.0), f - real(0.5)
        return vec3(real(0.5) * a * a, real(0.75) - b * b, real(0.5) * c * c)

    @wp.func
    def slopes(f: real):
        """dw/df."""
        return vec3(f - real(1.5), real(-2.0) * (f - real(1.0)), f - real(0.5))

    @wp.func
    def inside(g: vec3, n: wp.vec3i):
        """True when all 27 nodes exist; false for anything that is not a number."""
        h = real(0.5)
        return (
            g[0] >= h and g[1] >= h and g[2] >= h
            and g[0] < real(n[0]) - real(1.5) and g[1] < real(n[1]) - real(1.5) and g[2] < real(n[2]) - real(1.5)
        )  # fmt: skip

    @wp.func
    def cell(g: vec3):
        """Lowest of the 27 nodes around a place, and how far the place is from it, both in cells."""
        h = real(0.5)
        bx, by, bz = wp.int32(g[0] - h), wp.int32(g[1] - h), wp.int32(g[2] - h)
        return bx, by, bz, g - vec3(real(bx), real(by), real(bz))

    @wp.func
    def columns(A: mat33):
        """Columns of a matrix that acts on momentum or velocity, as rows of the grid; they carry no mass."""
        z = real(0.0)
        return (
            vec4(A[0, 0], A[1, 0], A[2, 0], z),
            vec4(A[0, 1], A[1, 1], A[2, 1], z),
            vec4(A[0, 2], A[1, 2], A[2, 2], z),
        )

    @wp.func
    def eye():
        o, z = real(1.0), real(0.0)
        return mat33(o, z, z, z, o, z, z, z, o)

    return SimpleNamespace(weights=weights, slopes=slopes, inside=inside, cell=cell, columns=columns, eye=eye)


def make_kernels(mixture: Any, walls: Signature, real: type) -> SimpleNamespace:
    """The three kernels of a substep: ``p2g``, ``grid_update``, ``g2p``, and their types.

    Cached; safe to call from several threads.
    """
    return cached(_make_kernels, mixture, walls, real)


def cached(make: Callable[..., SimpleNamespace], mixture: Any, *key: Any) -> SimpleNamespace:
    """``make(mixture, *key)``, made once for each mixture object, by one thread at a time."""
    with LOCK:
        known = (make, id(mixture), key)
        if known not in _made:
            _made[known] = (mixture, make(mixture, *key))  # holding the mixture keeps its id its own
        return _made[known][1]


def _make_kernels(mixture: Any, walls: Signature, real: type) -> SimpleNamespace:
    vec3, mat33, vec4 = mixture.vec3, mixture.mat33, wp.types.vector(4, real)
    w_e_t, w_p_t, theta_t = mixture.w_e_t, mixture.w_p_t, mixture.theta_t
    spline, contact = make_spline(real), make_contact(walls, real)
    weights, inside, cell, columns, eye = spline.weights, spline.inside, spline.cell, spline.columns, spline.eye
    apply, wall_t = contact.apply, contact.wall_t
    plastic, has_walls = mixture.is_plastic, len(walls) > 0
    stress, ke, kp = mixture.stress, mixture.Ke, mixture.Kp
    memory = mixture.volumetric_memory

    @wp.kernel(module="unique", enable_backward=False)
    def p2g(
        X: wp.array[vec3],  # (N,) [m]   position at the beginning of the frame
        u: wp.array[vec3],  # (N,) [m]   displacement since
        v: wp.array[vec3],  # (N,) [m/s]
        C: wp.array[mat33],  # (N,) [1/s]
        He: wp.array[mat33],  # (N,) [-]  trial elastic deformation gradient minus I
        log_J: wp.array[real],  # (N,) [-]  ln det of the total one, only with volumetric memory
        w_e: wp.array[w_e_t],  # (N,) [-]
        w_p: wp.array[w_p_t],  # (N,) [-]
        theta: wp.array[theta_t],  # (N,) SI
        m: wp.array[real],  # (N,) [kg]
        vol: wp.array[real],  # (N,) [m³]
        low: vec3,  # [m]  lowest node
        dx: real,
        dt: real,
        n: wp.vec3i,  # nodes along each axis
        at: wp.int32,  # first row of this state in u, v, C, He
        grid: wp.array[vec4],  # (nodes,) momentum [kg m/s], mass [kg]   out
        He_out: wp.array[mat33],  # (N,) [-]  elastic part minus I, after flow   out, only with plasticity
        status: wp.array[wp.int32],  # (3,)   out
    ):
        p = wp.tid()
        r = at + p
        idx = real(1.0) / dx
        g = ((X[p] - low) + u[r]) * idx
        if not inside(g, n):
            wp.atomic_max(status, LEFT, p + 1)
            return
        bx, by, bz, f = cell(g)
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        w_e_p = w_e_t()
        w_p_p = w_p_t()
        if wp.static(ke > 1):
            w_e_p = w_e[p]
        if wp.static(kp > 1):
            w_p_p = w_p[p]
        F = eye() + He[r]
        if wp.static(memory):
            tau, Fe = stress(F, w_e_p, w_p_p, theta[p], dt, log_J[r])
        else:
            tau, Fe = stress(F, w_e_p, w_p_p, theta[p], dt)
        if wp.static(plastic):
            He_out[p] = He[r] + (Fe - F)  # what does not flow keeps the digits that F rounds away
        m_p = m[p]
        A = (m_p * dx) * C[r] - (real(4.0) * dt * vol[p] * idx) * tau  # per cell, not per metre
        q3 = m_p * v[r] - A * f
        q = vec4(q3[0], q3[1], q3[2], m_p)
        a0, a1, a2 = columns(A)
        for i in range(3):
            for j in range(3):
                w_ij = wx[i] * wy[j]
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                wp.atomic_add(grid, o, (w_ij * wz[0]) * q_ij)
                wp.atomic_add(grid, o + 1, (w_ij * wz[1]) * (q_ij + a2))
                wp.atomic_add(grid, o + 2, (w_ij * wz[2]) * (q_ij + real(2.0) * a2))

    @wp.func
    def log_det(L: mat33):
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

    @wp.func
    def velocity(a: vec4, g_dt: vec3):
        return vec3(a[0] / a[3] + g_dt[0], a[1] / a[3] + g_dt[1], a[2] / a[3] + g_dt[2])

    @wp.func
    def place(o: wp.int32, n: wp.vec3i, dx: real):
        """Node o from the lowest node [m]."""
        yz = n[1] * n[2]
        i = o // yz
        j = (o - i * yz) // n[2]
        k = o - i * yz - j * n[2]
        return dx * vec3(real(i), real(j), real(k))

    @wp.kernel(module="unique", enable_backward=False)
    def grid_update(
        grid: wp.array[vec4],  # (nodes,) momentum, mass   in, and cleared for the next step
        row: wp.array2d[wall_t],  # (steps, walls)
        sdf: wp.array[real],  # samples of signed-distance walls [m]
        s: wp.int32,  # row of this step
        g_dt: vec3,  # [m/s]  g Δt
        dx: real,
        n: wp.vec3i,
        grid_v: wp.array[vec4],  # (nodes,) velocity [m/s], -   out
    ):
        o = wp.tid()
        a = grid[o]
        if a[3] > real(0.0):
            v = velocity(a, g_dt)
            if wp.static(has_walls):
                v = apply(v, place(o, n, dx), row, sdf, s)
            grid_v[o] = vec4(v[0], v[1], v[2], real(0.0))
            grid[o] = vec4(real(0.0))

    @wp.kernel(module="unique", enable_backward=False)
    def g2p(
        X: wp.array[vec3],
        u: wp.array[vec3],
        He: wp.array[mat33],  # elastic part minus I: with plasticity after flow, one row a particle, else rows as u
        H: wp.array[mat33],  # (N,) [-]  total deformation gradient minus I, only with plasticity
        log_J: wp.array[real],  # (N,) [-]  its ln det, only with volumetric memory
        grid_v: wp.array[vec4],
        low: vec3,
        dx: real,
        dt: real,
        n: wp.vec3i,
        at: wp.int32,  # first row of this state
        to: wp.int32,  # first row of the next one; may be the same
        u_out: wp.array[vec3],
        v_out: wp.array[vec3],
        C_out: wp.array[mat33],
        He_out: wp.array[mat33],
        H_out: wp.array[mat33],
        log_J_out: wp.array[real],
        status: wp.array[wp.int32],
    ):
        p = wp.tid()
        r, t = at + p, to + p
        idx = real(1.0) / dx
        u_p = u[r]
        g = ((X[p] - low) + u_p) * idx
        if not inside(g, n):
            return
        bx, by, bz, f = cell(g)
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        b0, b1, b2, b3 = vec4(), vec4(), vec4(), vec4()
        for i in range(3):
            for j in range(3):
                w_ij = wx[i] * wy[j]
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                v0, v1, v2 = w_ij * wz[0] * grid_v[o], w_ij * wz[1] * grid_v[o + 1], w_ij * wz[2] * grid_v[o + 2]
                v_ij = v0 + v1 + v2
                b3 += v_ij
                b0 += wp.static(real(i)) * v_ij
                b1 += wp.static(real(j)) * v_ij
                b2 += v1 + real(2.0) * v2
        v_p = vec3(b3[0], b3[1], b3[2])
        m0 = vec3(b0[0], b0[1], b0[2])
        m1 = vec3(b1[0], b1[1], b1[2])
        m2 = vec3(b2[0], b2[1], b2[2])
        c = real(4.0) * idx
        C_p = wp.matrix_from_cols((m0 - v_p * f[0]) * c, (m1 - v_p * f[1]) * c, (m2 - v_p * f[2]) * c)
        L = dt * C_p
        e = r
        if wp.static(plastic):
            e = p
        He_p = He[e]
        He_p += L + L * He_p
        if wp.determinant(eye() + He_p) <= real(0.0):
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
        if wp.static(memory):
            log_J_out[t] = log_J[r] + log_det(L)

    return SimpleNamespace(
        p2g=p2g, grid_update=grid_update, g2p=g2p, velocity=velocity, place=place,
        real=real, vec3=vec3, vec4=vec4, mat33=mat33, wall_t=wall_t, mixture=mixture, walls=walls,
    )  # fmt: skip
