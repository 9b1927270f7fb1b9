"""The bound on the time step: the fastest wave of a deformed state, against the acoustic tensor by differences."""

import numpy as np
import pytest

from diffuphy.material import ELASTIC
from diffuphy.material.moduli import lame
from tests.material.evaluate import DEFAULTS, evaluate, generic, rotations, stretched

RNG = np.random.default_rng(0)
MU, LAM = (float(x) for x in lame(DEFAULTS))
SOLIDS = [name for name in ELASTIC if name != "fluid_eos"]
REST = {name: DEFAULTS["bulk_modulus"] if name == "fluid_eos" else LAM + 2 * MU for name in ELASTIC}


def elasticity(names: tuple[str, ...], F: np.ndarray, w: np.ndarray | None = None) -> np.ndarray:
    """a_ijkl = F_jJ F_lL ∂P_iJ/∂F_kL [Pa] by fourth-order differences: truncation 1e-12, rounding 1e-13."""
    h = 1e-3
    steps = h * np.array([1.0, -1.0, 2.0, -2.0])
    d = np.eye(9).reshape(9, 3, 3)
    A = F[:, None, None] + steps[:, None, None] * d[:, None]
    flat = A.reshape(-1, 3, 3)
    weights = None if w is None else np.repeat(w, 36, axis=0)
    P = evaluate(names, (), flat, w_e=weights)["tau"] @ np.linalg.inv(flat).swapaxes(1, 2)
    P = P.reshape(len(F), 9, 4, 3, 3)
    dP = (8 * (P[:, :, 0] - P[:, :, 1]) - (P[:, :, 2] - P[:, :, 3])) / (12 * h)
    return np.einsum("pkLiJ,pjJ,plL->pijkl", dP.reshape(-1, 3, 3, 3, 3), F, F)


def fastest(a: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Largest eigenvalue of Γ_ik = a_ijkl n_j n_l over the directions n (M, 3) [Pa]."""
    acoustic = np.einsum("pijkl,mj,ml->pmik", a, n, n)
    return np.linalg.eigvalsh((acoustic + acoustic.swapaxes(-1, -2)) / 2)[..., -1].max(-1)


DIRECTIONS = np.concatenate([np.eye(3), RNG.normal(size=(400, 3))])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


@pytest.mark.parametrize("name", [*ELASTIC, "mixture"])
def test_no_wave_is_faster_than_the_bound(name: str):
    """M̂ ≥ λ_max Γ(n) for every n, in any state; differences leave 1e-9 of the stiffness."""
    F = generic(60, RNG, spread=0.6)
    names = tuple(ELASTIC) if name == "mixture" else (name,)
    w = RNG.dirichlet(np.ones(len(names)), len(F))
    bound = evaluate(names, (), F, w_e=w)["wave"]
    true = fastest(elasticity(names, F, w), DIRECTIONS)
    assert (bound >= true - 1e-8 * np.abs(true).max()).all()
    assert (bound >= (w * [REST[n] for n in names]).sum(1) * (1 - 1e-12)).all()


@pytest.mark.parametrize("name", ELASTIC)
def test_bound_is_reached_at_equal_stretches(name: str):
    """Where s_1 = s_2 = s_3 all axes are alike and M̂ = λ_max Γ, or the stiffness at rest where the state is softer."""
    s = np.array([0.6, 0.8, 0.95, 1.0, 1.05, 1.3])
    F = rotations(6, RNG) * s[:, None, None]
    true = np.maximum(fastest(elasticity((name,), F), DIRECTIONS), REST[name])
    assert np.abs(evaluate((name,), (), F)["wave"] / true - 1).max() < 1e-8


@pytest.mark.parametrize("name", SOLIDS)
def test_bound_is_not_far_above_the_fastest_wave(name: str):
    """At strains of 0.2 the step 1/√M̂ is at most an eighth shorter than the fastest of 400 waves asks: the slack of the
    bound is how much shear and coupling differ between the axes."""
    F = generic(60, RNG, spread=0.2)
    true = np.maximum(fastest(elasticity((name,), F), DIRECTIONS), REST[name])
    assert (np.sqrt(true / evaluate((name,), (), F)["wave"]) > 7 / 8).all()


def test_bound_of_a_neo_hookean_solid_is_its_fastest_wave():
    """ρ_0 c² = μ s_max² + μ + λ (1 − ln J) along the longest axis, wherever λ(1 − ln J) + μ ≥ 0."""
    s = np.exp(RNG.uniform(-0.5, 0.5, (200, 3)))
    closed = MU * s.max(1) ** 2 + MU + LAM * (1 - np.log(s.prod(1)))
    wave = evaluate(("neo_hookean",), (), stretched(s, RNG))["wave"]
    assert np.abs(wave / np.maximum(closed, LAM + 2 * MU) - 1).max() < 1e-12


def test_waves_of_an_impossible_state_are_not_a_number():
    F = np.stack([np.diag([1.0, 1.0, -1.0]), np.eye(3)])
    wave = evaluate(("hencky",), (), F)["wave"]
    assert np.isnan(wave[0]) and wave[1] == pytest.approx(LAM + 2 * MU, rel=1e-14)
