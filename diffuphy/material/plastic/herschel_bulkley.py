"""Herschel–Bulkley fluid: yield stress, and a viscosity that thins or thickens with the rate; ketchup, paint, mud.

    dev τ = (√(2/3) σ_Y + √2 K γ̇^N) dev τ/|dev τ| in flow,   γ̇ = √2 |D_p|;   simple shear: τ_xy = σ_Y/√3 + K γ̇^N
    implicit step, overstress y = s − √(2/3) σ_Y > 0, s = 2μ |ê|, x = y'/y:
        x + c x^m = 1,   m = 1/N,   c = √2 μ Δt/y (y/(√2 K))^m;         a = (1 − x) y/s,  b = 0

K is the true consistency [Pa s^N] and N the flow index: 1 is ``viscoplastic`` with η = K, below it thins, above it
thickens. Newton's method solves for whichever of x and x^m makes the equation convex, P u^p + L u = 1 with p ≥ 1 and
max(P, L) = 1: the root lies in [½, 1], and from 1 the iteration descends to it monotonically. The logarithm of c is
used, never c, so that decades of rate at N = 0.1 do not overflow. The derivative is that of the implicit function.
Herschel & Bulkley, Kolloid-Zeitschrift 39 (1926); Yue et al., ACM TOG 34 (2015), §3, with η there 2K.
"""

import math

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions
from .von_mises import YIELD_STRESS

CONSISTENCY = Param("consistency", "Pa sⁿ", 1e-1, 1e4, log=True, default=1e1)
FLOW_INDEX = Param("flow_index", "-", 0.1, 3.0, log=False, default=0.5)

STEPS = 12
"""Most Newton steps: from twice the root at most, p ≤ 10, the error halves twice and is then squared by each."""


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t = layout.real, layout.theta_t
    at, at_K, at_N = layout.at("yield_stress"), layout.at("consistency"), layout.at("flow_index")
    m = moduli.build(layout)
    root = real((2.0 / 3.0) ** 0.5)
    root2 = real(math.sqrt(2.0))
    nil, one, two = real(0.0), real(1.0), real(2.0)
    ulp = real(2**-23 if real is wp.float32 else 2**-52)

    @wp.func(module="unique")
    def descend(P: real, L: real, p: real) -> real:
        """Root u ∈ [½, 1] of P u^p + L u = 1."""
        u = one
        for _i in range(wp.static(STEPS)):
            power = P * wp.pow(u, p - one)
            step = (power * u + L * u - one) / (p * power + L)
            u = u - step
            if step <= ulp:
                break
        return u

    @wp.func(module="unique")
    def solve(y: real, mu: real, theta: theta_t, dt: real):
        """x, 1 − x and ln x."""
        N = theta[at_N]
        log_c = wp.log(root2 * mu * dt / y) + wp.log(y / (root2 * theta[at_K])) / N
        down = wp.max(log_c, nil)
        up = wp.exp(wp.min(log_c, nil))
        if N <= one:  # in x = z_0 u,  z_0 = min(1, c^(−N))
            log_z = -down * N
            u = descend(up, wp.exp(log_z), one / N)
            log_x = log_z + wp.log(u)
            return wp.exp(log_x), up * wp.pow(u, one / N), log_x
        # in x^m = z_0 u,  z_0 = min(1, 1/c)
        v = descend(wp.exp(-down * N), up, N)
        log_y = N * (wp.log(v) - down)
        return wp.exp(log_y), up * v, log_y

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real):
        mu, _lam = m.lame(theta)
        s = two * mu * n
        y = s - root * theta[at]
        a = nil
        if y > nil:
            _x, rest, _log_x = solve(y, mu, theta, dt)
            a = rest * y / s
        return a, nil

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        mu, _lam = m.lame(theta)
        s = two * mu * n
        y = s - root * theta[at]
        n_bar = nil
        theta_bar = theta_t()
        if y > nil:
            # da = a (dy/y − ds/s) + g (d ln c + ln x dm),  g = (y/s) x r/(x + m r),  r = 1 − x
            # d ln c = dμ/μ + (m − 1) dy/y − m dK/K + ln(y/(√2 K)) dm
            x, r, log_x = solve(y, mu, theta, dt)
            k = one / theta[at_N]
            a = r * y / s
            g = a_bar * x / (x + k * r) * a
            y_bar = (a_bar * a + (k - one) * g) / y
            s_bar = y_bar - a_bar * a / s
            n_bar = two * mu * s_bar
            theta_bar = m.adjoint(theta, two * n * s_bar + g / mu, nil)
            theta_bar[at] = -root * y_bar
            theta_bar[at_K] = -k * g / theta[at_K]
            theta_bar[at_N] = -k * k * g * (wp.log(y / (root2 * theta[at_K])) + log_x)
        return n_bar, nil, theta_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow(n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n after a step of dt [s]; by bisection in ln x, to the last bit."""
    mu, _ = moduli.lame(params)
    N = params["flow_index"]
    s = 2 * mu * n
    flows = s > (2 / 3) ** 0.5 * params["yield_stress"]
    y = torch.where(flows, s - (2 / 3) ** 0.5 * params["yield_stress"], torch.ones_like(s))
    log_c = torch.log(2**0.5 * mu * dt / y) + torch.log(y / (2**0.5 * params["consistency"])) / N
    hi = torch.zeros_like(log_c)
    lo = -N * log_c.clamp_min(0) - (N + 1) * math.log(2)  # at least one of the two terms is ≥ ½ at the root
    for _ in range(80):
        mid = (lo + hi) / 2
        above = torch.exp(mid) + torch.exp(log_c + mid / N) > 1
        lo, hi = torch.where(above, lo, mid), torch.where(above, mid, hi)
    a = torch.exp(log_c + hi / N) * y / torch.where(flows, s, torch.ones_like(s))
    return torch.where(flows, a, torch.zeros_like(n)), torch.zeros_like(n)


LAW = Plastic(
    name="herschel_bulkley",
    params=(moduli.E, moduli.NU, YIELD_STRESS, CONSISTENCY, FLOW_INDEX),
    build=build,
    flow=flow,
)
