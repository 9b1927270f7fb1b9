"""Steady simple shear of the laws that flow: their stress against the closed curve, its gradient, and small yields."""

import math

import numpy as np
import pytest

from diffuphy.material.moduli import lame
from tests.material.evaluate import evaluate, generic

RNG = np.random.default_rng(0)


def steady_shear(name: str, rate: float, dt: float, strain: float, **params: float) -> tuple[float, np.ndarray]:
    """τ_xy [Pa] and Fe after simple shear at this rate [1/s]."""
    step, F = np.eye(3)[None].copy(), np.eye(3)[None]
    step[:, 0, 1] = rate * dt
    for _ in range(round(strain / (rate * dt))):
        out = evaluate(("hencky",), (name,), step @ F, params=params, dt=dt)
        F = out["Fe"]
    return float(out["tau"][0, 0, 1]), F


@pytest.mark.parametrize("index", [0.5, 1.0, 2.0])
def test_herschel_bulkley_flow_curve_over_four_decades(index: float):
    """τ_xy = σ_Y/√3 + K γ̇^N at γ̇ = 0.01 … 100 1/s, one K.

    The stiffness is 3e4 times the stress, so that elastic strains are 1e-4, and their frame turns by as much; a strain
    of 0.01 is 50 relaxations; the implicit step is exact in the steady state up to the strain of one step, 2.5e-5.
    """
    for rate in (1e-2, 1e-1, 1e0, 1e1, 1e2):
        expected = 500.0 / math.sqrt(3) + 300.0 * rate**index
        params = {"E": 3e4 * expected, "yield_stress": 500.0, "consistency": 300.0, "flow_index": index}
        tau, F = steady_shear("herschel_bulkley", rate, 2.5e-5 / rate, 0.01, **params)
        assert abs(tau / expected - 1) < 1e-3
        assert abs(np.linalg.det(F[0]) - 1) < 1e-12


def test_herschel_bulkley_of_index_one_is_bingham():
    """N = 1 is ``viscoplastic`` with η = K: value and gradient to hundreds of ulp."""
    F = generic(300, RNG)
    bars = {"tau_bar": RNG.normal(size=F.shape) / 1e5, "Fe_bar": RNG.normal(size=F.shape), "dt": 2e-3}
    general = evaluate(("hencky",), ("herschel_bulkley",), F, params={"flow_index": 1.0, "consistency": 50.0}, **bars)
    bingham = evaluate(("hencky",), ("viscoplastic",), F, params={"viscosity": 50.0}, **bars)
    for key in ("Fe", "F_bar"):
        assert np.abs(general[key] - bingham[key]).max() < 1e-13
    assert np.abs(general["theta_bar"][:, 3] - bingham["theta_bar"][:, 3]).max() < 1e-13  # η and K


@pytest.mark.parametrize("index", [0.1, 0.3, 0.9, 1.1, 3.0])
def test_herschel_bulkley_solves_its_implicit_equation(index: float):
    """s − s' = √2 μ Δt (y'/(√2 K))^(1/N) over twelve decades of Δt, also where the power alone would overflow.

    Read from 1 − a = s'/s: relative to s, some ulp and the condition 1/N of the power.
    """
    mu, K, sigma = float(lame({"E": 1e5, "nu": 0.3})[0]), 60.0, 1e4
    e = np.diag(np.exp(0.3 * np.array([1.0, -1.0, 0.0]) / math.sqrt(2)))[None]
    s = 2 * mu * 0.3
    for dt in 10.0 ** np.arange(-9, 4):
        params = {"flow_index": index, "consistency": K, "yield_stress": sigma}
        tau = evaluate(("hencky",), ("herschel_bulkley",), e, params=params, dt=dt)["tau"][0]
        y = np.linalg.norm(tau) - math.sqrt(2 / 3) * sigma
        # ln of both sides: s − s' and the power, each relative to its own size
        flowed = s - np.linalg.norm(tau)
        expected = math.sqrt(2) * mu * dt * (max(y, 0.0) / (math.sqrt(2) * K)) ** (1 / index)
        rounding = 1e-12 * s * (1 + expected / (index * max(y, 1e-12 * s)))
        assert abs(flowed - expected) < rounding


def test_tiny_yield_is_not_smoothed_away():
    """σ_Y/2μ = 1e-6: |dev τ| = √(2/3) σ_Y exactly; a norm √(x² + 1e-8) would never yield."""
    sigma = 2e-6 * float(lame({"E": 1e5, "nu": 0.3})[0])
    F = np.diag(np.exp(1e-5 * np.array([1.0, -1.0, 0.0])))[None]
    tau = evaluate(("hencky",), ("von_mises",), F, params={"yield_stress": sigma})["tau"][0]
    # strains of 1e-5 are known to 1e-16: 1e-11 of them
    assert abs(np.linalg.norm(tau - np.trace(tau) / 3 * np.eye(3)) / (math.sqrt(2 / 3) * sigma) - 1) < 1e-9


@pytest.mark.parametrize(
    ("name", "params", "key", "slope"),
    [
        ("von_mises", {"yield_stress": 1e3}, "yield_stress", lambda rate: 1 / math.sqrt(3)),
        ("viscoplastic", {"yield_stress": 1e3, "viscosity": 50.0}, "viscosity", lambda rate: rate),
        ("herschel_bulkley", {"yield_stress": 1e3, "consistency": 50.0, "flow_index": 0.5}, "consistency", math.sqrt),
    ],
)
def test_gradient_of_steady_shear_is_that_of_the_flow_curve(name: str, params: dict, key: str, slope):
    """dτ_xy/dσ_Y = 1/√3, dτ_xy/dη = γ̇, dτ_xy/dK = γ̇^N, by the adjoint through every step; E = 1e6, elastic strains
    of 2e-3 turn the frame by 0.1 %, squared in the stress."""
    from diffuphy.material import make_mixture

    rate, dt = 2.0, 5e-5
    step, F, states = np.eye(3)[None].copy(), np.eye(3)[None], []
    step[:, 0, 1] = rate * dt
    params = params | {"E": 1e6}
    for _ in range(300):
        states.append(step @ F)
        F = evaluate(("hencky",), (name,), states[-1], params=params, dt=dt)["Fe"]
    tau_bar, Fe_bar, total = np.zeros((1, 3, 3)), np.zeros((1, 3, 3)), 0.0
    tau_bar[0, 0, 1] = 1.0
    at = make_mixture(("hencky",), (name,)).params.index(key)
    for A in reversed(states):
        out = evaluate(("hencky",), (name,), A, params=params, dt=dt, tau_bar=tau_bar, Fe_bar=Fe_bar)
        total += out["theta_bar"][0, at]
        tau_bar, Fe_bar = np.zeros((1, 3, 3)), step.swapaxes(1, 2) @ out["F_bar"]
    assert abs(total / slope(rate) - 1) < 5e-3
