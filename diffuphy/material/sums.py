"""Weighted sums of laws in the principal frame; a single law ignores its weight."""

from dataclasses import dataclass
from typing import Any

import warp as wp

from .expert import Layout, PlasticFunctions


@dataclass(frozen=True)
class ElasticSum:
    """Σ_c w_c of the principal functions; the adjoint also gives w̄."""

    energy: Any
    stress: Any
    stress_adjoint: Any
    slope: Any


def sum_elastic(layout: Layout, laws: tuple[Any, ...], w_t: Any) -> ElasticSum:
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t
    K = len(laws)

    @wp.func(module="unique")
    def energy(s: vec3, e: vec3, w: w_t, theta: theta_t) -> real:
        if wp.static(K == 1):
            return wp.static(laws[0].energy)(s, e, theta)
        else:
            psi = real(0.0)
            for c in range(wp.static(K)):
                psi += w[c] * wp.static(laws[c].energy)(s, e, theta)
            return psi

    @wp.func(module="unique")
    def stress(s: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
        if wp.static(K == 1):
            return wp.static(laws[0].stress)(s, e, theta)
        else:
            T = vec3()
            for c in range(wp.static(K)):
                T += w[c] * wp.static(laws[c].stress)(s, e, theta)
            return T

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, e: vec3, w: w_t, theta: theta_t, T_bar: vec3):
        w_bar = w_t()
        if wp.static(K == 1):
            e_1, theta_1 = wp.static(laws[0].stress_adjoint)(s, e, theta, T_bar)
            return e_1, w_bar, theta_1
        else:
            e_bar = vec3()
            theta_bar = theta_t()
            for c in range(wp.static(K)):
                w_bar[c] = wp.dot(T_bar, wp.static(laws[c].stress)(s, e, theta))
                e_c, theta_c = wp.static(laws[c].stress_adjoint)(s, e, theta, T_bar)
                e_bar += w[c] * e_c
                theta_bar += w[c] * theta_c
            return e_bar, w_bar, theta_bar

    @wp.func(module="unique")
    def slope(s: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
        if wp.static(K == 1):
            return wp.static(laws[0].slope)(s, e, theta)
        else:
            d = vec3()
            for c in range(wp.static(K)):
                d += w[c] * wp.static(laws[c].slope)(s, e, theta)
            return d

    return ElasticSum(energy, stress, stress_adjoint, slope)


def remembering(layout: Layout, law: PlasticFunctions) -> PlasticFunctions:
    """A law without volumetric memory in the form of one that has it."""
    real, theta_t = layout.real, layout.theta_t

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real, t: real):
        a, b = law.flow(n, tr, theta, dt)
        return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real, t: real):
        n_bar, tr_bar, theta_bar = law.flow_adjoint(n, tr, theta, dt, a_bar, b_bar)
        return n_bar, tr_bar, theta_bar, real(0.0)

    return PlasticFunctions(flow, flow_adjoint)


def sum_memory(layout: Layout, laws: tuple[Any, ...], w_t: Any) -> PlasticFunctions:
    """As :func:`sum_plastic`, of laws that all read ln J, and whose adjoints give its gradient."""
    real, theta_t = layout.real, layout.theta_t
    K = len(laws)

    @wp.func(module="unique")
    def flow(n: real, tr: real, w: w_t, theta: theta_t, dt: real, log_J: real):
        if wp.static(K == 1):
            a_1, b_1 = wp.static(laws[0].flow)(n, tr, theta, dt, log_J)
            return a_1, b_1
        else:
            a = real(0.0)
            b = real(0.0)
            for c in range(wp.static(K)):
                a_c, b_c = wp.static(laws[c].flow)(n, tr, theta, dt, log_J)
                a += w[c] * a_c
                b += w[c] * b_c
            return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, w: w_t, theta: theta_t, dt: real, a_bar: real, b_bar: real, log_J: real):
        w_bar = w_t()
        if wp.static(K == 1):
            n_1, tr_1, theta_1, log_J_1 = wp.static(laws[0].flow_adjoint)(n, tr, theta, dt, a_bar, b_bar, log_J)
            return n_1, tr_1, w_bar, theta_1, log_J_1
        else:
            n_bar = real(0.0)
            tr_bar = real(0.0)
            log_J_bar = real(0.0)
            theta_bar = theta_t()
            for c in range(wp.static(K)):
                a_c, b_c = wp.static(laws[c].flow)(n, tr, theta, dt, log_J)
                w_bar[c] = a_bar * a_c + b_bar * b_c
                n_c, tr_c, theta_c, log_J_c = wp.static(laws[c].flow_adjoint)(
                    n, tr, theta, dt, w[c] * a_bar, w[c] * b_bar, log_J
                )
                n_bar += n_c
                tr_bar += tr_c
                log_J_bar += log_J_c
                theta_bar += theta_c
            return n_bar, tr_bar, w_bar, theta_bar, log_J_bar

    return PlasticFunctions(flow, flow_adjoint)


def sum_plastic(layout: Layout, laws: tuple[Any, ...], w_t: Any) -> PlasticFunctions:
    real, theta_t = layout.real, layout.theta_t
    K = len(laws)

    @wp.func(module="unique")
    def flow(n: real, tr: real, w: w_t, theta: theta_t, dt: real):
        if wp.static(K == 1):
            a_1, b_1 = wp.static(laws[0].flow)(n, tr, theta, dt)
            return a_1, b_1
        else:
            a = real(0.0)
            b = real(0.0)
            for c in range(wp.static(K)):
                a_c, b_c = wp.static(laws[c].flow)(n, tr, theta, dt)
                a += w[c] * a_c
                b += w[c] * b_c
            return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, w: w_t, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        w_bar = w_t()
        if wp.static(K == 1):
            n_1, tr_1, theta_1 = wp.static(laws[0].flow_adjoint)(n, tr, theta, dt, a_bar, b_bar)
            return n_1, tr_1, w_bar, theta_1
        else:
            n_bar = real(0.0)
            tr_bar = real(0.0)
            theta_bar = theta_t()
            for c in range(wp.static(K)):
                a_c, b_c = wp.static(laws[c].flow)(n, tr, theta, dt)
                w_bar[c] = a_bar * a_c + b_bar * b_c
                n_c, tr_c, theta_c = wp.static(laws[c].flow_adjoint)(n, tr, theta, dt, w[c] * a_bar, w[c] * b_bar)
                n_bar += n_c
                tr_bar += tr_c
                theta_bar += theta_c
            return n_bar, tr_bar, w_bar, theta_bar

    return PlasticFunctions(flow, flow_adjoint)
