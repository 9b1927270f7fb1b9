"""One kernel for all functions of a mixture, and states of strain at which derivatives are easy to get wrong."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from diffuphy.material.mixture import Mixture, make_mixture

DEFAULTS = {
    "E": 1e5, "nu": 0.3, "yield_stress": 1e4, "friction_angle": 25.0, "cohesion": 0.02, "viscosity": 50.0,
    "bulk_modulus": 8e4, "gamma": 5.0, "hardening": 3e4, "residual": 0.4, "consistency": 60.0, "flow_index": 0.6,
    "preconsolidation": 6e3, "compaction": 8.0, "tension_ratio": 0.3, "melt_time": 0.05,
}  # fmt: skip
"""Parameters of the tests: a strain of 0.1 is well beyond yield."""

OUTPUTS = ("tau", "Fe", "flow", "psi", "wave", "valid", "F_bar", "w_e_bar", "w_p_bar", "theta_bar", "h_out", "h_in_bar")


@cache
def kernel(mixture: Mixture) -> Any:
    """A kernel that evaluates every function of the mixture."""
    memory = len(mixture.memory) > 0
    memory_t = mixture.memory_t
    real, mat33, w_e_t, w_p_t, theta_t = mixture.real, mixture.mat33, mixture.w_e_t, mixture.w_p_t, mixture.theta_t

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(
        F: wp.array(dtype=mat33), H: wp.array(dtype=mat33), w_e: wp.array(dtype=w_e_t), w_p: wp.array(dtype=w_p_t),
        theta: wp.array(dtype=theta_t), dt: real, tau_bar: wp.array(dtype=mat33), Fe_bar: wp.array(dtype=mat33),
        h: wp.array(dtype=memory_t), h_bar: wp.array(dtype=memory_t),
        tau: wp.array(dtype=mat33), Fe: wp.array(dtype=mat33), flow: wp.array(dtype=mat33),
        psi: wp.array(dtype=real), wave: wp.array(dtype=real),
        valid: wp.array(dtype=int),
        F_bar: wp.array(dtype=mat33), w_e_bar: wp.array(dtype=w_e_t), w_p_bar: wp.array(dtype=w_p_t),
        theta_bar: wp.array(dtype=theta_t),
        h_out: wp.array(dtype=memory_t), h_in_bar: wp.array(dtype=memory_t),
    ):  # fmt: skip
        p = wp.tid()
        if wp.static(memory):
            tau_p, flow_p, h_p = mixture.stress(F[p], H[p], w_e[p], w_p[p], theta[p], dt, h[p])
            a, b, c, d, e = mixture.stress_adjoint(
                F[p], H[p], w_e[p], w_p[p], theta[p], dt, tau_bar[p], Fe_bar[p], h[p], h_bar[p]
            )
            h_out[p] = h_p
            h_in_bar[p] = e
        else:
            tau_p, flow_p = mixture.stress(F[p], H[p], w_e[p], w_p[p], theta[p], dt)
            a, b, c, d = mixture.stress_adjoint(F[p], H[p], w_e[p], w_p[p], theta[p], dt, tau_bar[p], Fe_bar[p])
        tau[p] = tau_p
        Fe[p] = F[p] + flow_p
        flow[p] = flow_p
        psi[p] = mixture.energy(F[p] + flow_p, H[p] + flow_p, w_e[p], theta[p])
        wave[p] = mixture.wave(F[p], H[p], w_e[p], theta[p])
        valid[p] = int(mixture.valid(F[p]))
        F_bar[p] = a
        w_e_bar[p] = b
        w_p_bar[p] = c
        theta_bar[p] = d

    return evaluate


def evaluate(
    elastic: tuple[str, ...],
    plastic: tuple[str, ...],
    F: np.ndarray,
    *,
    H: np.ndarray | None = None,
    w_e: np.ndarray | None = None,
    w_p: np.ndarray | None = None,
    theta: np.ndarray | None = None,
    params: dict[str, float] | None = None,
    dt: float = 1e-3,
    tau_bar: np.ndarray | None = None,
    Fe_bar: np.ndarray | None = None,
    memory: dict[str, np.ndarray] | None = None,
    memory_bar: dict[str, np.ndarray] | None = None,
    real: Any = wp.float64,
) -> dict[str, np.ndarray]:
    """All outputs of the mixture at states F (N, 3, 3), with H = F − I, uniform weights, ``DEFAULTS`` and new matter
    (ln J = ln det F, no slip, no heat) unless given. Also ``log_J``, ``slip``, ``heat`` afterwards, and gradients."""
    m = make_mixture(elastic, plastic, real)
    n, dtype = len(F), np.float32 if real is wp.float32 else np.float64
    if theta is None:
        theta = np.tile([(DEFAULTS | (params or {}))[p] for p in m.params], (n, 1))
    w_e = np.full((n, max(1, m.Ke)), 1 / max(1, m.Ke)) if w_e is None else w_e
    w_p = np.full((n, max(1, m.Kp)), 1 / max(1, m.Kp)) if w_p is None else w_p

    def array(value: np.ndarray | None, kind: Any) -> wp.array:
        value = np.zeros((n, 3, 3)) if value is None else value
        return wp.array(np.ascontiguousarray(value, dtype=dtype), dtype=kind, device="cpu")

    H = np.asarray(F, dtype=dtype) - np.eye(3, dtype=dtype) if H is None else H
    inputs = [
        array(F, m.mat33),
        array(H, m.mat33),
        array(w_e, m.w_e_t),
        array(w_p, m.w_p_t),
        array(theta, m.theta_t),
        dt,
    ]
    with np.errstate(invalid="ignore"):
        past = {"log_J": np.log(np.linalg.det(F)), "slip": np.zeros(n), "heat": np.zeros(n), **(memory or {})}
    bars = {k: np.zeros(n) for k in past} | (memory_bar or {})
    h, h_bar = (np.stack([x[k] for k in m.memory or ("log_J",)], 1) for x in (past, bars))
    inputs += [array(tau_bar, m.mat33), array(Fe_bar, m.mat33), array(h, m.memory_t), array(h_bar, m.memory_t)]
    kinds = (m.mat33, m.mat33, m.mat33, real, real, int, m.mat33, m.w_e_t, m.w_p_t, m.theta_t, m.memory_t, m.memory_t)
    outputs = [wp.zeros(n, dtype=k, device="cpu") for k in kinds]
    wp.launch(kernel(m), dim=n, inputs=inputs, outputs=outputs, device="cpu")
    out = {name: o.numpy() for name, o in zip(OUTPUTS, outputs, strict=True)}
    out |= {k: np.zeros(n) for k in past} | {f"{k}_bar": np.zeros(n) for k in past}
    for i, k in enumerate(m.memory):
        out[k], out[f"{k}_bar"] = out["h_out"][:, i], out["h_in_bar"][:, i]
    return out


def rotations(n: int, rng: np.random.Generator) -> np.ndarray:
    """Random rotations, shape (n, 3, 3)."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    return Q * np.sign(np.linalg.det(Q))[:, None, None]


def stretched(s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Deformations with principal stretches s (N, 3) in random frames."""
    return (rotations(len(s), rng) * s[:, None, :]) @ rotations(len(s), rng)


def generic(n: int, rng: np.random.Generator, spread: float = 0.35) -> np.ndarray:
    """Deformations with log-stretches of this spread, shape (n, 3, 3)."""
    return stretched(np.exp(rng.uniform(-spread, spread, (n, 3))), rng)


def special(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Named states at which the singular value decomposition has no derivative, or nearly none."""
    Q = rotations(8, rng)
    noise = rng.normal(size=(8, 3, 3))
    equal = np.column_stack([np.full(8, 1.1), np.full(8, 1.1), rng.uniform(0.8, 1.0, 8)])
    return {
        "identity": np.tile(np.eye(3), (8, 1, 1)),
        "rotation": Q,
        "twice": 2.0 * Q,
        "half": 0.7 * Q,
        "two equal stretches": stretched(equal, rng),
        "nearly equal stretches": stretched(equal * (1 + 1e-7 * rng.normal(size=(8, 3))), rng),
        "nearly identity": np.eye(3) + 1e-6 * noise,
        "equal to 1 %": stretched(equal * (1 + 1e-2 * rng.normal(size=(8, 3))), rng),
    }
