"""Laws with a past: hardening, softening, snow and melting; and what the mixture keeps for them."""

import math

import numpy as np
import pytest
import warp as wp

from diffuphy.material import PLASTIC
from diffuphy.material.expert import MEMORY, Plastic
from diffuphy.material.moduli import lame
from tests.material.evaluate import DEFAULTS, evaluate, generic, rotations, stretched

RNG = np.random.default_rng(0)
MU, LAM = (float(x) for x in lame(DEFAULTS))
KAPPA = LAM + 2 * MU / 3
ROOT = math.sqrt(2 / 3)
SHEAR = np.array([1.0, -1.0, 0.0]) / math.sqrt(2)


def sheared(amount: float, steps: int, name: str, **params: float) -> tuple[np.ndarray, np.ndarray]:
    """|dev τ| and slip along a pure shear in equal steps; |ê| grows by amount/steps in each."""
    step, F, slip = np.diag(np.exp(amount / steps * SHEAR))[None], np.eye(3)[None], np.zeros(1)
    stress, slips = [], []
    for _ in range(steps):
        out = evaluate(("hencky",), (name,), step @ F, params=params, memory={"slip": slip})
        F, slip = out["Fe"], out["slip"]
        stress.append(np.linalg.norm(out["tau"][0]))
        slips.append(slip[0])
    return np.array(stress), np.array(slips)


def test_hardening_follows_its_line():
    """|dev τ| = √(2/3)(σ_Y + H ε) on the surface, and all strain is elastic or slip: |ê| = |dev τ|/2μ + ε/√(2/3)."""
    stress, slip = sheared(0.5, 50, "von_mises_hardening", hardening=3e4)
    flowing = slip > 0
    assert flowing.sum() > 30
    surface = ROOT * (DEFAULTS["yield_stress"] + 3e4 * slip[flowing])
    assert np.abs(stress[flowing] / surface - 1).max() < 1e-12
    total = np.linspace(0.5 / 50, 0.5, 50)
    assert np.abs(stress / (2 * MU) + slip / ROOT - total).max() < 1e-13


def test_hardening_does_not_depend_on_the_number_of_steps():
    """Radial loading is integrated exactly: ten steps end where one does."""
    one, ten = (sheared(0.5, n, "von_mises_hardening", hardening=3e4) for n in (1, 10))
    assert abs(one[0][-1] / ten[0][-1] - 1) < 1e-12 and abs(one[1][-1] - ten[1][-1]) < 1e-13


def test_softening_ends_at_the_residual_strength():
    """H < 0: down the same line, then |dev τ| = √(2/3) r σ_Y; with H < −3μ at once."""
    H, sigma, r = -2e4, DEFAULTS["yield_stress"], 0.4
    stress, slip = sheared(1.0, 100, "von_mises_hardening", hardening=H, residual=r)
    flowing = slip > 0
    assert np.abs(stress[flowing] / (ROOT * np.maximum(sigma + H * slip[flowing], r * sigma)) - 1).max() < 1e-12
    assert (slip > sigma * (1 - r) / -H).sum() > 30
    brittle, slip = sheared(1.0, 100, "von_mises_hardening", hardening=-3.1 * MU, residual=r)
    assert np.abs(brittle[slip > 0] / (ROOT * r * sigma) - 1).max() < 1e-12


def test_without_hardening_it_is_von_mises():
    """H = 0 to a few ulp, whatever has slipped."""
    F = generic(200, RNG)
    hard = evaluate(("hencky",), ("von_mises_hardening",), F, params={"hardening": 0.0}, memory={"slip": np.ones(200)})
    plain = evaluate(("hencky",), ("von_mises",), F)
    assert np.abs(hard["Fe"] - plain["Fe"]).max() < 1e-14


@pytest.mark.parametrize(
    "name", [n for n in PLASTIC if n not in ("fluid", "drucker_prager", "drucker_prager_plane_strain")]
)
def test_what_does_not_flow_keeps_everything_to_the_last_bit(name: str):
    """Fe = F, slip' = slip, log_J' = log_J inside the yield surface."""
    F = rotations(100, RNG) @ stretched(np.exp(-1e-3 + 1e-4 * RNG.normal(size=(100, 3))), RNG)
    slip = RNG.uniform(0, 0.02, 100)
    out = evaluate(("hencky",), (name,), F, memory={"slip": slip})
    assert (out["Fe"] == F).all()
    remembered = PLASTIC[name].memory
    assert "slip" not in remembered or (out["slip"] == slip).all()
    assert "log_J" not in remembered or (out["log_J"] == np.log(np.linalg.det(F))).all()


# ------------------------------------------------------------------------------------------------------------- snow
def cam_clay(
    e: np.ndarray, log_J: np.ndarray, **params: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(p, q, p_c of the step, ln J_p after it) at trial strains e (N, 3)."""
    x = DEFAULTS | params
    out = evaluate(("hencky",), ("cam_clay",), stretched(np.exp(e), RNG), params=params, memory={"log_J": log_J})
    p = -np.trace(out["tau"], axis1=1, axis2=2) / 3
    q = math.sqrt(1.5) * np.linalg.norm(out["tau"] + p[:, None, None] * np.eye(3), axis=(1, 2))
    p_c = x["preconsolidation"] * np.exp(-x["compaction"] * (log_J - e.sum(1)))
    return p, q, p_c, log_J + p / KAPPA


def test_cam_clay_ends_on_its_ellipse():
    """q² (1 + 2β)/M² + (p + β p_c)(p − p_c) = 0 after flow and < 0 before it, for p_c of the beginning of the step."""
    beta, s = DEFAULTS["tension_ratio"], math.sin(math.radians(DEFAULTS["friction_angle"]))
    M = 6 * s / (3 - s)
    e = RNG.uniform(-0.1, 0.1, (500, 3))
    log_J = e.sum(1) + RNG.uniform(-0.15, 0.15, 500)
    p, q, p_c, _ = cam_clay(e, log_J)
    tr = e.sum(1)
    trial_p, trial_q = -KAPPA * tr, math.sqrt(6) * MU * np.linalg.norm(e - tr[:, None] / 3, axis=1)
    y, before = ((b**2) * (1 + 2 * beta) / M**2 + (a + beta * p_c) * (a - p_c) for a, b in ((p, q), (trial_p, trial_q)))
    flows = before > 0
    assert 0.2 < flows.mean() < 0.999
    assert (np.abs(y[flows]) < 1e-9 * p_c[flows] ** 2).all()
    assert np.abs(p[~flows] - trial_p[~flows]).max() < 1e-9 * DEFAULTS["E"]


def test_cam_clay_cap_and_tension_limit():
    """Pressed without shear p = p_c, pulled without shear p = −β p_c."""
    e = np.full((2, 3), [[-0.2], [0.2]])
    p, q, p_c, _ = cam_clay(e, e.sum(1))
    assert np.abs(p / p_c - [1.0, -DEFAULTS["tension_ratio"]]).max() < 1e-10
    assert np.abs(q).max() < 1e-9 * DEFAULTS["E"]


def test_cam_clay_compacts_under_the_cap_and_loosens_in_shear():
    """Associated flow: on the wet side (p > p_c (1 − β)/2) ln J_p falls and p_c grows, on the dry side the reverse."""
    shear = 0.1 * SHEAR
    wet, dry = -0.08 / 3 + shear, -0.001 / 3 + shear
    e = np.stack([wet, dry])
    *_, after = cam_clay(e, e.sum(1), compaction=1.0)
    assert after[0] < 0 < after[1]


def test_torn_snow_bears_nothing_until_it_is_pressed_together_again():
    """ln J_p = 0.5, ξ = 50: p_c = p_Y e^(−25); pressed back to ln J_p = 0 the strength is p_Y again."""
    e = np.full((1, 3), -0.05)
    p, *_ = cam_clay(e, e.sum(1) + 0.5, compaction=50.0)
    assert 0 <= p[0] < DEFAULTS["preconsolidation"] * math.exp(-20)
    p, *_ = cam_clay(e, e.sum(1), compaction=50.0)
    assert abs(p[0] / DEFAULTS["preconsolidation"] - 1) < 1e-10


@pytest.mark.parametrize("opening", [1.0, 5.0, 50.0])
def test_snow_that_has_flown_apart_stays_finite(opening: float):
    """Any opening ln J_p: p_c underflows, the stress goes to 0 and every gradient is finite."""
    F, ones = generic(100, RNG), np.ones((100, 3, 3))
    out = evaluate(
        ("hencky",), ("cam_clay",), F, memory={"log_J": np.log(np.linalg.det(F)) + opening},
        params={"compaction": 30.0},
        tau_bar=ones, Fe_bar=ones,
    )  # fmt: skip
    assert np.abs(out["tau"]).max() < 1e-3 * DEFAULTS["preconsolidation"]
    assert all(np.isfinite(out[k]).all() for k in ("Fe", "F_bar", "theta_bar", "log_J_bar"))


# ---------------------------------------------------------------------------------------------------------- melting
def test_melting_is_bingham_with_a_strength_that_fades():
    """σ_Y e^(−h), η e^(−h), and h' = h + Δt/t_melt."""
    F, heat, dt = generic(50, RNG), 0.7, 2e-3
    melting = evaluate(("hencky",), ("melting",), F, dt=dt, memory={"heat": np.full(50, heat)})
    soft = {k: DEFAULTS[k] * math.exp(-heat) for k in ("yield_stress", "viscosity")}
    solid = evaluate(("hencky",), ("viscoplastic",), F, dt=dt, params=soft)
    assert np.abs(melting["Fe"] - solid["Fe"]).max() < 1e-14
    assert np.abs(melting["heat"] - (heat + dt / DEFAULTS["melt_time"])).max() < 1e-15


@pytest.mark.parametrize("dt", [0.0, 2e-3])
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_what_has_melted_through_flows_in_no_time(dt: float, real: type):
    """e^(−h) is zero at last: σ_Y = η = 0 is von Mises of no strength, dev e = 0, in a step of none as well; values and
    gradients are finite."""
    F, bar = generic(50, RNG), RNG.normal(size=(50, 3, 3))
    out = evaluate(
        ("hencky",), ("melting",), F, dt=dt, memory={"heat": np.full(50, 1e4)}, tau_bar=bar, Fe_bar=bar, real=real
    )
    s = np.linalg.svd(out["Fe"], compute_uv=False)
    assert (s.max(1) / s.min(1) - 1).max() < 64 * np.finfo(np.float32 if real is wp.float32 else np.float64).eps
    assert all(np.isfinite(v).all() for v in out.values())


def test_memory_is_kept_in_one_order_whatever_the_laws():
    from diffuphy.material import make_mixture

    assert make_mixture(("hencky",), ("melting", "von_mises_hardening", "cam_clay")).memory == MEMORY
    assert make_mixture(("hencky",), ("melting", "identity")).memory == ("heat",)
    with pytest.raises(ValueError, match="unknown memory 'age'; known: log_J, slip, heat"):
        Plastic("x", (), PLASTIC["fluid"].build, PLASTIC["fluid"].flow, memory=("age",))
