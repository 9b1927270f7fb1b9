"""Stress, return map and their adjoint in the shared principal frame; the formulas are in :mod:`.mixture`."""

from typing import Any

import warp as wp

from . import linalg, near_one
from .expert import Layout
from .sums import ElasticSum, PlasticSum


def energy(layout: Layout, total: ElasticSum, w_e_t: Any) -> Any:
    """(Fe, He, w_e, θ) → ψ [Pa]."""
    real, mat33, theta_t = layout.real, layout.mat33, layout.theta_t
    la = linalg.build(real)

    @wp.func(module="unique")
    def stored(F: mat33, H: mat33, w_e: w_e_t, theta: theta_t) -> real:
        _B, _V, s, d, e = la.principal(F, H)
        return total.energy(s, d, e, w_e, theta)

    return stored


def elastic(layout: Layout, total: ElasticSum, w_e_t: Any, w_p_t: Any) -> tuple[Any, Any]:
    """Stress and adjoint when nothing flows: z = s, Fe − F = 0."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    la = linalg.build(real)

    @wp.func(module="unique")
    def stress(F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real):
        B, _V, s, d, e = la.principal(F, H)
        T = wp.cw_div(total.stress(s, d, e, w_e, theta), wp.cw_mul(s, s))
        return (B * wp.diag(T)) * wp.transpose(B), mat33()

    @wp.func(module="unique")
    def stress_adjoint(
        F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real, tau_bar: mat33, Fe_bar: mat33
    ):
        B, V, s, d, e = la.principal(F, H)
        U = B * wp.diag(vec3(real(1.0) / s[0], real(1.0) / s[1], real(1.0) / s[2]))
        G = wp.transpose(U) * (tau_bar + wp.transpose(tau_bar)) * U  # twice the symmetric part
        e_bar, w_e_bar, theta_bar = total.stress_adjoint(s, d, e, w_e, theta, real(0.5) * wp.get_diag(G))
        q = total.slope(s, d, e, w_e, theta)
        g = vec3(q[0] * G[1, 2] / (s[1] + s[2]), q[1] * G[2, 0] / (s[2] + s[0]), q[2] * G[0, 1] / (s[0] + s[1]))
        X = mat33(
            e_bar[0] / s[0], g[2] * s[1], g[1] * s[2],
            g[2] * s[0], e_bar[1] / s[1], g[0] * s[2],
            g[1] * s[0], g[0] * s[1], e_bar[2] / s[2],
        )  # fmt: skip
        return Fe_bar + U * X * wp.transpose(V), w_e_bar, w_p_t(), theta_bar

    return stress, stress_adjoint


def elastoplastic(
    layout: Layout, total: ElasticSum, plastic: PlasticSum, w_e_t: Any, w_p_t: Any
) -> tuple[Any, Any, Any, Any]:
    """Stress and adjoint with a return map, without and with memory: (stress, stress_adjoint, the two with h)."""
    real, vec3, mat33, theta_t, memory_t = layout.real, layout.vec3, layout.mat33, layout.theta_t, layout.memory_t
    la, forward, backward = linalg.build(real), _mapped(layout, total, w_e_t), _pulled_back(layout, total, w_e_t)
    split, remember, remember_adjoint = _split(layout), *_remembering(layout)

    @wp.func(module="unique")
    def stress(F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real):
        B, V, s, d, e = la.principal(F, H)
        tr, dev, n = split(e)
        a, b = plastic.flow(n, tr, w_p, theta, dt, memory_t())
        tau, flows = forward(B, V, s, d, e, dev, a, b, w_e, theta)
        return tau, flows

    @wp.func(module="unique")
    def stress_h(F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real, h: memory_t):
        B, V, s, d, e = la.principal(F, H)
        tr, dev, n = split(e)
        a, b = plastic.flow(n, tr, w_p, theta, dt, h)
        tau, flows = forward(B, V, s, d, e, dev, a, b, w_e, theta)
        return tau, flows, remember(n, a, theta, dt, h)

    @wp.func(module="unique")
    def stress_adjoint_h(
        F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real, tau_bar: mat33, Fe_bar: mat33,
        h: memory_t, h_bar: memory_t,
    ):  # fmt: skip
        B, V, s, d, e = la.principal(F, H)
        tr, dev, n = split(e)
        a, b = plastic.flow(n, tr, w_p, theta, dt, h)
        X, x_bar, w_e_bar, theta_bar, U = backward(B, V, s, d, e, dev, a, b, w_e, theta, tau_bar, Fe_bar)
        a_h, n_h, theta_h = remember_adjoint(n, a, theta, dt, h_bar)
        sum = x_bar[0] + x_bar[1] + x_bar[2]
        a_bar = a_h - wp.dot(x_bar, dev)
        n_bar, tr_bar, w_p_bar, theta_p, h_p = plastic.flow_adjoint(n, tr, w_p, theta, dt, a_bar, sum, h)
        n_bar += n_h
        # ē = (1 − a) x̄ + (a tr x̄/3 + t̄r) + n̄ ê/n
        mean = a * sum / real(3.0) + tr_bar
        e_bar = (real(1.0) - a) * x_bar + vec3(mean, mean, mean)
        if n > real(0.0):
            e_bar += (n_bar / n) * dev
        X += wp.diag(wp.cw_div(e_bar, s))
        return Fe_bar + U * X * wp.transpose(V), w_e_bar, w_p_bar, theta_bar + theta_h + theta_p, h_bar + h_p

    @wp.func(module="unique")
    def stress_adjoint(
        F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real, tau_bar: mat33, Fe_bar: mat33
    ):
        F_bar, w_e_bar, w_p_bar, theta_bar, _h = stress_adjoint_h(
            F, H, w_e, w_p, theta, dt, tau_bar, Fe_bar, memory_t(), memory_t()
        )
        return F_bar, w_e_bar, w_p_bar, theta_bar

    return stress, stress_adjoint, stress_h, stress_adjoint_h


def _split(layout: Layout) -> Any:
    """e → (tr e, ê = e − tr e/3, |ê|).

    The mean of ê is taken off again: a state whose ê is mere rounding, as on the tip of a cone, has a trace as large as
    ê otherwise, and return maps that divide by |ê| make a wrong gradient of it.
    """
    real, vec3 = layout.real, layout.vec3

    @wp.func(module="unique")
    def split(e: vec3):
        tr = e[0] + e[1] + e[2]
        t = tr / real(3.0)
        dev = e - vec3(t, t, t)
        t = (dev[0] + dev[1] + dev[2]) / real(3.0)
        dev -= vec3(t, t, t)
        return tr, dev, wp.length(dev)

    return split


def _remembering(layout: Layout) -> tuple[Any, Any]:
    """(|ê|, a, θ, dt, h) → h' and its adjoint (…, h̄') → (ā, n̄, θ̄); h̄ = h̄' besides."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t
    slips, heats = "slip" in layout.memory, "heat" in layout.memory
    at_slip = layout.remembers("slip") if slips else 0
    at_heat, at_time = (layout.remembers("heat"), layout.at("melt_time")) if heats else (0, 0)
    root = real((2.0 / 3.0) ** 0.5)

    @wp.func(module="unique")
    def remember(n: real, a: real, theta: theta_t, dt: real, h: memory_t):
        step = memory_t()
        if wp.static(slips):
            step[at_slip] = root * a * n
        if wp.static(heats):
            step[at_heat] = dt / theta[at_time]
        return h + step

    @wp.func(module="unique")
    def remember_adjoint(n: real, a: real, theta: theta_t, dt: real, h_bar: memory_t):
        a_bar = real(0.0)
        n_bar = real(0.0)
        theta_bar = theta_t()
        if wp.static(slips):
            a_bar = root * n * h_bar[at_slip]
            n_bar = root * a * h_bar[at_slip]
        if wp.static(heats):
            theta_bar[at_time] = -h_bar[at_heat] * dt / (theta[at_time] * theta[at_time])
        return a_bar, n_bar, theta_bar

    return remember, remember_adjoint


def _flowed(layout: Layout) -> Any:
    """(s, s − 1, x) → (eˣ − 1, z = s eˣ, z − 1)."""
    vec3, exponential = layout.vec3, near_one.build(layout.real).exponential

    @wp.func(module="unique")
    def flowed(s: vec3, d: vec3, x: vec3):
        q0, r0 = exponential(x[0])
        q1, r1 = exponential(x[1])
        q2, r2 = exponential(x[2])
        r = vec3(r0, r1, r2)
        return r, wp.cw_mul(s, vec3(q0, q1, q2)), d + wp.cw_mul(s, r)

    return flowed


def _mapped(layout: Layout, total: ElasticSum, w_e_t: Any) -> Any:
    """Stress, and Fe − F, from the frame of the trial state and what flows."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    flowed = _flowed(layout)

    @wp.func(module="unique")
    def mapped(
        B: mat33, V: mat33, s: vec3, d: vec3, e: vec3, dev: vec3, a: real, b: real, w_e: w_e_t, theta: theta_t
    ):  # fmt: skip
        flows = mat33()
        z = s
        g = d
        h = e
        if a != real(0.0) or b != real(0.0):
            x = vec3(b, b, b) - a * dev
            h = e + x
            r, z, g = flowed(s, d, x)
            flows = (B * wp.diag(r)) * wp.transpose(V)
        T = wp.cw_div(total.stress(z, g, h, w_e, theta), wp.cw_mul(s, s))
        return (B * wp.diag(T)) * wp.transpose(B), flows

    return mapped


def _pulled_back(layout: Layout, total: ElasticSum, w_e_t: Any) -> Any:
    """Adjoint of :func:`_mapped`: gradient in the trial frame, less that of e, and the gradient of ln z."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    flowed = _flowed(layout)
    near = real(0.25 if real is wp.float32 else 0.02)  # the next term of the series in pair, l⁶/30000, is below one ulp

    @wp.func(module="unique")
    def pair(s_i: real, s_j: real, z_i: real, z_j: real, l: real, k: real, d: real, G: real, H_ij: real, H_ji: real):
        """Off-diagonal entries X_ij − H_ij and X_ji − H_ji; l = e_i − e_j; G is twice that of the text."""
        sum = s_i + s_j
        p = real(1.0)
        if wp.abs(l) < near:  # √(z z/(s s)) sinh(k l/2)/sinh(l/2), series in l
            l2 = l * l
            k2 = k * k
            c_2 = (k2 - real(1.0)) / real(24.0)
            c_4 = (k2 * (real(3.0) * k2 - real(10.0)) + real(7.0)) / real(5760.0)
            p = k * wp.sqrt(z_i * z_j / (s_i * s_j)) * (real(1.0) + l2 * (c_2 + l2 * c_4))
        else:
            p = (z_i - z_j) / (s_i - s_j)
        q = p * d * G / sum
        sym = (p - real(1.0)) * real(0.5) * (H_ij + H_ji)
        skew = ((z_i + z_j) / sum - real(1.0)) * real(0.5) * (H_ij - H_ji)
        return sym + skew + q * s_j, sym - skew + q * s_i

    @wp.func(module="unique")
    def pulled_back(
        B: mat33, V: mat33, s: vec3, d: vec3, e: vec3, dev: vec3, a: real, b: real, w_e: w_e_t, theta: theta_t,
        tau_bar: mat33, Fe_bar: mat33,
    ):  # fmt: skip
        h = e
        g = d
        z = s
        if a != real(0.0) or b != real(0.0):
            x = vec3(b, b, b) - a * dev
            h = e + x
            _r, z, g = flowed(s, d, x)
        U = B * wp.diag(vec3(real(1.0) / s[0], real(1.0) / s[1], real(1.0) / s[2]))
        G = wp.transpose(U) * (tau_bar + wp.transpose(tau_bar)) * U  # twice the symmetric part
        H = wp.transpose(U) * Fe_bar * V
        h_bar, w_e_bar, theta_bar = total.stress_adjoint(z, g, h, w_e, theta, real(0.5) * wp.get_diag(G))
        h_bar += wp.cw_mul(wp.get_diag(H), z)
        k = real(1.0) - a
        c = total.slope(z, g, h, w_e, theta)
        x01, x10 = pair(s[0], s[1], z[0], z[1], e[0] - e[1], k, c[2], G[0, 1], H[0, 1], H[1, 0])
        x02, x20 = pair(s[0], s[2], z[0], z[2], e[0] - e[2], k, c[1], G[0, 2], H[0, 2], H[2, 0])
        x12, x21 = pair(s[1], s[2], z[1], z[2], e[1] - e[2], k, c[0], G[1, 2], H[1, 2], H[2, 1])
        X = mat33(-H[0, 0], x01, x02, x10, -H[1, 1], x12, x20, x21, -H[2, 2])
        return X, h_bar, w_e_bar, theta_bar, U

    return pulled_back
