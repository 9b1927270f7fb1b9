"""Weighted sums of laws in the principal frame; a single law ignores its weight.

A sum of K laws is the sum of the first K − 1 plus the last, function within function: so the laws of a kernel are part
of its identity, and no list of functions is looked up while it is compiled.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import warp as wp

from .expert import ElasticFunctions, Layout, PlasticFunctions

Sum = TypeVar("Sum")


@dataclass(frozen=True)
class ElasticSum:
    """Σ_c w_c of the principal functions; the adjoint also gives w̄."""

    energy: Any
    """(s, d, e, w, θ) → ψ."""
    stress: Any
    """(s, d, e, w, θ) → T."""
    stress_adjoint: Any
    """(s, d, e, w, θ, T̄) → (ē, w̄, θ̄)."""
    slope: Any
    """(s, d, e, w, θ) → (d_12, d_20, d_01)."""


@dataclass(frozen=True)
class PlasticSum:
    """Σ_c w_c (a_c, b_c); h is what is remembered, empty and free of cost where nothing is."""

    flow: Any
    """(n, tr, w, θ, dt, h) → (a, b)."""
    flow_adjoint: Any
    """(n, tr, w, θ, dt, ā, b̄, h) → (n̄, t̄r, w̄, θ̄, h̄)."""


def add_up(laws: Sequence[Any], alone: Callable[[Any], Sum], none: Callable[[], Sum], plus: Callable[..., Sum]) -> Sum:
    """``alone(law)`` of one law, else ``plus(… plus(plus(none(), law, 0), law, 1) …)``."""
    if len(laws) == 1:
        return alone(laws[0])
    total = none()
    for c, law in enumerate(laws):
        total = plus(total, law, c)
    return total


def sum_elastic(layout: Layout, laws: tuple[ElasticFunctions, ...], w_t: Any) -> ElasticSum:
    """The elastic laws of a mixture as one; w_t: vector type of the weights."""
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t

    def alone(law: ElasticFunctions) -> ElasticSum:
        @wp.func(module="unique")
        def energy(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> real:
            return law.energy(s, d, e, theta)

        @wp.func(module="unique")
        def stress(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
            return law.stress(s, d, e, theta)

        @wp.func(module="unique")
        def stress_adjoint(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t, T_bar: vec3):
            e_bar, theta_bar = law.stress_adjoint(s, d, e, theta, T_bar)
            return e_bar, w_t(), theta_bar

        @wp.func(module="unique")
        def slope(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
            return law.slope(s, d, e, theta)

        return ElasticSum(energy, stress, stress_adjoint, slope)

    return add_up(laws, alone, lambda: _nothing(layout, w_t), lambda *terms: _plus(layout, w_t, *terms))


def _nothing(layout: Layout, w_t: Any) -> ElasticSum:
    """The sum of no laws."""
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> real:
        return real(0.0)

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
        return vec3()

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t, T_bar: vec3):
        return vec3(), w_t(), theta_t()

    return ElasticSum(energy, stress, stress_adjoint, stress)


def _plus(layout: Layout, w_t: Any, before: ElasticSum, law: ElasticFunctions, c: int) -> ElasticSum:
    """The laws before c, and law c with its weight."""
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> real:
        return before.energy(s, d, e, w, theta) + w[c] * law.energy(s, d, e, theta)

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
        return before.stress(s, d, e, w, theta) + w[c] * law.stress(s, d, e, theta)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t, T_bar: vec3):
        e_bar, w_bar, theta_bar = before.stress_adjoint(s, d, e, w, theta, T_bar)
        w_bar[c] = wp.dot(T_bar, law.stress(s, d, e, theta))
        e_c, theta_c = law.stress_adjoint(s, d, e, theta, T_bar)
        return e_bar + w[c] * e_c, w_bar, theta_bar + w[c] * theta_c

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, w: w_t, theta: theta_t) -> vec3:
        return before.slope(s, d, e, w, theta) + w[c] * law.slope(s, d, e, theta)

    return ElasticSum(energy, stress, stress_adjoint, slope)


def sum_direct(layout: Layout, laws: tuple[ElasticFunctions, ...], w_t: Any) -> tuple[Any, Any]:
    """(F, H, w, θ) → Σ_c w_c τ_c and (F, H, w, θ, τ̄) → (F̄, w̄, θ̄), of laws that need no principal frame."""
    mat33, theta_t = layout.mat33, layout.theta_t

    def alone(law: ElasticFunctions) -> tuple[Any, Any]:
        @wp.func(module="unique")
        def stress(F: mat33, H: mat33, w: w_t, theta: theta_t) -> mat33:
            return law.direct(F, H, theta)

        @wp.func(module="unique")
        def stress_adjoint(F: mat33, H: mat33, w: w_t, theta: theta_t, tau_bar: mat33):
            F_bar, theta_bar = law.direct_adjoint(F, H, theta, tau_bar)
            return F_bar, w_t(), theta_bar

        return stress, stress_adjoint

    def none() -> tuple[Any, Any]:
        @wp.func(module="unique")
        def stress(F: mat33, H: mat33, w: w_t, theta: theta_t) -> mat33:
            return mat33()

        @wp.func(module="unique")
        def stress_adjoint(F: mat33, H: mat33, w: w_t, theta: theta_t, tau_bar: mat33):
            return mat33(), w_t(), theta_t()

        return stress, stress_adjoint

    def plus(before: tuple[Any, Any], law: ElasticFunctions, c: int) -> tuple[Any, Any]:
        stress_before, adjoint_before = before

        @wp.func(module="unique")
        def stress(F: mat33, H: mat33, w: w_t, theta: theta_t) -> mat33:
            return stress_before(F, H, w, theta) + w[c] * law.direct(F, H, theta)

        @wp.func(module="unique")
        def stress_adjoint(F: mat33, H: mat33, w: w_t, theta: theta_t, tau_bar: mat33):
            F_bar, w_bar, theta_bar = adjoint_before(F, H, w, theta, tau_bar)
            w_bar[c] = wp.ddot(tau_bar, law.direct(F, H, theta))
            F_c, theta_c = law.direct_adjoint(F, H, theta, tau_bar)
            return F_bar + w[c] * F_c, w_bar, theta_bar + w[c] * theta_c

        return stress, stress_adjoint

    return add_up(laws, alone, none, plus)


def sum_plastic(layout: Layout, laws: Sequence[tuple[PlasticFunctions, bool]], w_t: Any) -> PlasticSum:
    """The plastic laws of a mixture as one.

    Args:
        laws: each with whether it reads the memory.
        w_t: vector type of the weights.
    """
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t

    def alone(law: PlasticFunctions) -> PlasticSum:
        @wp.func(module="unique")
        def flow(n: real, tr: real, w: w_t, theta: theta_t, dt: real, h: memory_t):
            a, b = law.flow(n, tr, theta, dt, h)
            return a, b

        @wp.func(module="unique")
        def flow_adjoint(n: real, tr: real, w: w_t, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
            n_bar, tr_bar, theta_bar, h_bar = law.flow_adjoint(n, tr, theta, dt, a_bar, b_bar, h)
            return n_bar, tr_bar, w_t(), theta_bar, h_bar

        return PlasticSum(flow, flow_adjoint)

    told = tuple(law if reads else _told(layout, law) for law, reads in laws)
    return add_up(told, alone, lambda: _rest(layout, w_t), lambda *terms: _flow_plus(layout, w_t, *terms))


def _told(layout: Layout, law: PlasticFunctions) -> PlasticFunctions:
    """A law without memory in the form of one that has it."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real, h: memory_t):
        a, b = law.flow(n, tr, theta, dt)
        return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        n_bar, tr_bar, theta_bar = law.flow_adjoint(n, tr, theta, dt, a_bar, b_bar)
        return n_bar, tr_bar, theta_bar, memory_t()

    return PlasticFunctions(flow, flow_adjoint)


def _rest(layout: Layout, w_t: Any) -> PlasticSum:
    """The sum of no plastic laws."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t

    @wp.func(module="unique")
    def flow(n: real, tr: real, w: w_t, theta: theta_t, dt: real, h: memory_t):
        return real(0.0), real(0.0)

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, w: w_t, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        return real(0.0), real(0.0), w_t(), theta_t(), memory_t()

    return PlasticSum(flow, flow_adjoint)


def _flow_plus(layout: Layout, w_t: Any, before: PlasticSum, law: PlasticFunctions, c: int) -> PlasticSum:
    """The laws before c, and law c with its weight."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t

    @wp.func(module="unique")
    def flow(n: real, tr: real, w: w_t, theta: theta_t, dt: real, h: memory_t):
        a, b = before.flow(n, tr, w, theta, dt, h)
        a_c, b_c = law.flow(n, tr, theta, dt, h)
        return a + w[c] * a_c, b + w[c] * b_c

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, w: w_t, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        n_bar, tr_bar, w_bar, theta_bar, h_bar = before.flow_adjoint(n, tr, w, theta, dt, a_bar, b_bar, h)
        a_c, b_c = law.flow(n, tr, theta, dt, h)
        w_bar[c] = a_bar * a_c + b_bar * b_c
        n_c, tr_c, theta_c, h_c = law.flow_adjoint(n, tr, theta, dt, w[c] * a_bar, w[c] * b_bar, h)
        return n_bar + n_c, tr_bar + tr_c, w_bar, theta_bar + theta_c, h_bar + h_c

    return PlasticSum(flow, flow_adjoint)
