"""Modified Cam-clay with cohesion and exponential hardening: snow, and whatever is crushed, torn and pressed together.

    yield   q² (1 + 2β)/M² + (p + β p_c)(p − p_c) ≤ 0,   p = −κ tr e,  q = √(3/2) 2μ |ê|,  M = 6 sin φ/(3 − sin φ)
    hardens p_c = p_Y exp(−ξ ln J_p),   ln J_p = ln J − tr e, the plastic volume at the beginning of the step

J is the total volume. An ellipse from the tension limit −β p_c to the cap p_c: pressed beyond the cap the pores
collapse and p_c grows, torn or sheared on the loose side they open and p_c falls, and what lies open bears nothing
until it is pressed together again. The flow is associated: the elastic strain goes to the nearest point of the ellipse
in the norm of the elastic energy μ |ê|² + κ/2 (tr e)², so no step creates energy. With P = p_c/κ, x = tr e − t_c and

    t_c = −(1 − β) P/2,  A = (1 + β) P/2 in tr e,   B = g A in |ê|,  g = κ M/(√6 μ √(1 + 2β)),  w = κ/(2μ)

it is x' = x w A²/(w A² + t), |ê|' = |ê| B²/(B² + t) with the root t > 0 of

    f(t) = w² x² A²/(w A² + t)² + |ê|² B²/(B² + t)² − 1        (convex and falling: Newton's method from below)
    a = t/(B² + t),   b = −(x/3) t/(w A² + t)

The ellipse with cohesion and the use for snow: Gaume et al., Nat. Commun. 9 (2018); Wolper et al., CD-MPM, ACM TOG 38
(2019), §5. The exponential law ξ = 1/(λ* − κ*): Schofield & Wroth, Critical State Soil Mechanics (1968), §6.
"""

import math

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions
from .drucker_prager import FRICTION_ANGLE

PRECONSOLIDATION = Param("preconsolidation", "Pa", 1e2, 1e6, log=True, default=1e4)
COMPACTION = Param("compaction", "-", 1.0, 50.0, log=True, default=10.0)
TENSION = Param("tension_ratio", "-", 0.0, 1.0, log=False, default=0.3)

STEPS = 30
"""Most Newton steps; six suffice but for matter that has lost nearly all its strength."""


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t
    at_E, at_nu, at_phi = layout.at("E"), layout.at("nu"), layout.at("friction_angle")
    at_p, at_xi, at_beta = layout.at("preconsolidation"), layout.at("compaction"), layout.at("tension_ratio")
    at_t = layout.remembers("log_J")
    degree = real(math.pi / 180.0)
    root6 = real(math.sqrt(6.0))
    nil, half, one, two, three = real(0.0), real(0.5), real(1.0), real(2.0), real(3.0)
    ulp = real(2**-23 if real is wp.float32 else 2**-52)

    @wp.func(module="unique")
    def ellipse(tr: real, theta: theta_t, t: real):
        """P, g and w."""
        nu = theta[at_nu]
        inverse = three * (one - two * nu) / theta[at_E]
        w = (one + nu) / (one - two * nu) / three
        P = theta[at_p] * inverse * wp.exp(-theta[at_xi] * (t - tr))
        s = wp.sin(degree * theta[at_phi])
        g = real(12.0) * s / (three - s) * w / (root6 * wp.sqrt(one + two * theta[at_beta]))
        return P, g, w

    @wp.func(module="unique")
    def nearest(n: real, x: real, A: real, B: real, w: real):
        """Root t of f and −½ f'(t)."""
        AA = w * A * A
        BB = B * B
        t = wp.max(nil, wp.max(wp.sqrt(w) * A * (wp.sqrt(w) * wp.abs(x) - wp.sqrt(w) * A), B * (n - B)))
        slope = one
        for _i in range(wp.static(STEPS)):
            u = w * x * A / (AA + t)
            v = n * B / (BB + t)
            slope = u * u / (AA + t) + v * v / (BB + t)
            step = half * (u * u + v * v - one) / slope
            t += step
            if step <= two * ulp * t:
                break
        return t, slope

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real, h: memory_t):
        P, g, w = ellipse(tr, theta, h[at_t])
        beta = theta[at_beta]
        A = half * (one + beta) * P
        B = g * A
        x = tr + half * (one - beta) * P
        a = nil
        b = nil
        if P < ulp * ulp:  # a strength below the rounding of any strain: loose
            a = one
            b = -tr / three
        elif g * g * x * x + n * n > B * B:
            t, _slope = nearest(n, x, A, B, w)
            a = t / (B * B + t)
            b = -x * t / (three * (w * A * A + t))
        return a, b

    @wp.func(module="unique")
    def pulled_back(n: real, x: real, A: real, B: real, w: real, a_bar: real, b_bar: real):
        """(ā, b̄) → (n̄, x̄, Ā, B̄, w̄) by the implicit function t."""
        t, slope = nearest(n, x, A, B, w)
        a = w * A * A + t
        b = B * B + t
        # t̄ over −f' = 2 slope
        l = half * (a_bar * B * B / (b * b) - b_bar * x * w * A * A / (three * a * a)) / slope
        u = w * x * A / a
        v = n * B / b
        n_bar = l * two * v * B / b
        x_bar = l * two * u * w * A / a - b_bar * t / (three * a)
        A_bar = l * two * u * w * x * (t - w * A * A) / (a * a) + two * b_bar * x * t * w * A / (three * a * a)
        B_bar = l * two * v * n * (t - B * B) / (b * b) - two * a_bar * t * B / (b * b)
        w_bar = l * two * u * x * A * t / (a * a) + b_bar * x * t * A * A / (three * a * a)
        return n_bar, x_bar, A_bar, B_bar, w_bar

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        P, g, w = ellipse(tr, theta, h[at_t])
        beta, nu, xi = theta[at_beta], theta[at_nu], theta[at_xi]
        A = half * (one + beta) * P
        B = g * A
        x = tr + half * (one - beta) * P
        n_bar = nil
        tr_bar = nil
        theta_bar = theta_t()
        h_bar = memory_t()
        if P < ulp * ulp:
            tr_bar = -b_bar / three
        elif g * g * x * x + n * n > B * B:
            n_1, x_bar, A_bar, B_bar, w_bar = pulled_back(n, x, A, B, w, a_bar, b_bar)
            n_bar = n_1
            g_bar = B_bar * A
            A_bar += B_bar * g
            P_bar = half * (A_bar * (one + beta) + x_bar * (one - beta))
            t_bar = -P_bar * P * xi
            tr_bar = x_bar - t_bar
            h_bar[at_t] = t_bar
            s = wp.sin(degree * theta[at_phi])
            w_bar += g_bar * g / w
            theta_bar[at_phi] = g_bar * g * three / (s * (three - s)) * degree * wp.cos(degree * theta[at_phi])
            theta_bar[at_p] = P_bar * P / theta[at_p]
            theta_bar[at_xi] = -P_bar * P * (h[at_t] - tr)
            theta_bar[at_beta] = half * P * (A_bar - x_bar) - g_bar * g / (one + two * beta)
            theta_bar[at_E] = -P_bar * P / theta[at_E]
            # P ∝ 1 − 2ν,  dw/dν = 1/(1 − 2ν)²
            u = one - two * nu
            theta_bar[at_nu] = w_bar / (u * u) - two * P_bar * P / u
        return n_bar, tr_bar, theta_bar, h_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow(
    n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float, memory: dict[str, Tensor]
) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n, tr e = tr and total volume e^memory["log_J"]; by bisection in ln t."""
    nu, beta = params["nu"], params["tension_ratio"]
    kappa, w = params["E"] / (3 * (1 - 2 * nu)), (1 + nu) / (1 - 2 * nu) / 3
    P = params["preconsolidation"] / kappa * torch.exp(-params["compaction"] * (memory["log_J"] - tr))
    s = torch.sin(torch.deg2rad(params["friction_angle"]))
    g = 2 * w * 6 * s / (3 - s) / (6 * (1 + 2 * beta)) ** 0.5
    A, x = (1 + beta) / 2 * P, tr + (1 - beta) / 2 * P
    B = g * A

    def f(t: Tensor) -> Tensor:
        return (w * x * A / (w * A**2 + t)) ** 2 + (n * B / (B**2 + t)) ** 2 - 1

    flows = (x / A) ** 2 + (n / B) ** 2 > 1
    lo, hi = torch.full_like(n, -80.0), torch.log(2 * (w.sqrt() * A * w.sqrt() * x.abs() + B * n))  # f(e^hi) < 0
    for _ in range(80):
        mid = (lo + hi) / 2
        above = f(mid.exp()) > 0
        lo, hi = torch.where(above, mid, lo), torch.where(above, hi, mid)
    t = torch.where(flows, hi.exp(), torch.zeros_like(n))
    return t / (B**2 + t), -x / 3 * t / (w * A**2 + t)


LAW = Plastic(
    name="cam_clay",
    params=(moduli.E, moduli.NU, FRICTION_ANGLE, PRECONSOLIDATION, COMPACTION, TENSION),
    build=build,
    flow=flow,
    memory=("log_J",),
)
