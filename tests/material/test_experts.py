"""What every law must obey, over the registries: a new law is tested by being listed.

Below the line: closed forms of single laws.
"""

import math

import numpy as np
import pytest

from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.material.moduli import lame
from diffuphy.material.plastic.drucker_prager import LATCH
from tests.material.evaluate import DEFAULTS, evaluate, generic, rotations, special, stretched

RNG = np.random.default_rng(0)
MU, LAM = (float(x) for x in lame(DEFAULTS))
LONG = 1e30
"""A time [s] over which anything that flows has flowed, by the power N = 0.6 of Herschel and Bulkley too."""


def close(a: np.ndarray, b: np.ndarray, *, scale: float, ulps: float = 200) -> bool:
    """Whether two arrays agree to some ulps of a scale: tens of rounded operations each."""
    return bool(np.abs(a - b).max() < ulps * np.finfo(np.float64).eps * scale)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum((1, 2))


# ---------------------------------------------------------------------------------------------------- elastic laws
@pytest.mark.parametrize("name", ELASTIC)
def test_stress_is_the_derivative_of_the_energy(name: str):
    """τ : dF F⁻¹ = dψ for every dF.

    Fourth-order differences with step 1e-3 leave h⁴ = 1e-12 and rounding 1e-13 of the modulus.
    """
    F = np.concatenate([generic(200, RNG), *special(RNG).values()])
    d = RNG.normal(size=F.shape) / 3

    def psi(h: float) -> np.ndarray:
        return evaluate((name,), (), F + h * d)["psi"]

    h = 1e-3
    numeric = (8 * (psi(h) - psi(-h)) - (psi(2 * h) - psi(-2 * h))) / (12 * h)
    exact = dot(evaluate((name,), (), F)["tau"], d @ np.linalg.inv(F))
    assert np.abs(numeric - exact).max() < 1e-9 * (LAM + 2 * MU)


@pytest.mark.parametrize("name", ELASTIC)
def test_stress_is_symmetric_objective_and_isotropic(name: str):
    """τ = τᵀ, τ(Q F) = Q τ(F) Qᵀ, τ(F Q) = τ(F)."""
    F = generic(200, RNG, spread=0.7)
    Q = rotations(200, RNG)
    tau = evaluate((name,), (), F)["tau"]
    scale = np.abs(tau).max()
    assert close(tau, tau.swapaxes(1, 2), scale=scale)
    assert close(evaluate((name,), (), Q @ F)["tau"], Q @ tau @ Q.swapaxes(1, 2), scale=scale)
    assert close(evaluate((name,), (), F @ Q)["tau"], tau, scale=scale)


@pytest.mark.parametrize("name", ELASTIC)
def test_rest_is_free_of_stress_and_energy(name: str):
    """τ(I) = 0 to the last bit; τ(Q) = 0 and ψ(Q) = 0 up to rounding of Q."""
    assert (evaluate((name,), (), np.eye(3)[None])["tau"] == 0.0).all()
    out = evaluate((name,), (), rotations(200, RNG))
    assert close(out["tau"], np.zeros(1), scale=LAM + 2 * MU)
    assert close(out["psi"], np.zeros(1), scale=LAM + 2 * MU)


@pytest.mark.parametrize("name", ELASTIC)
def test_energy_is_positive_away_from_rest(name: str):
    """ψ(F) > 0 for every F that is not a rotation."""
    assert (evaluate((name,), (), generic(500, RNG, spread=1.0))["psi"] > 0).all()


@pytest.mark.parametrize("name", ELASTIC)
def test_wave_speed_is_the_stiffness_at_rest(name: str):
    """ρ c² = ∂τ_xx/∂F_xx at F = I, the largest of all directions; fourth-order differences, step 1e-3."""
    import torch

    h, rho = 1e-3, 1000.0
    steps = np.array([1.0, -1.0, 2.0, -2.0]) * h
    F = np.tile(np.eye(3), (4, 1, 1))
    F[:, 0, 0] += steps
    t = evaluate((name,), (), F)["tau"][:, 0, 0]
    stiffness = (8 * (t[0] - t[1]) - (t[2] - t[3])) / (12 * h)
    theta = {p.name: torch.tensor(DEFAULTS[p.name], dtype=torch.float64) for p in ELASTIC[name].params}
    c = float(ELASTIC[name].wave_speed(theta, torch.tensor(rho, dtype=torch.float64)))
    assert abs(rho * c**2 / stiffness - 1) < 1e-9


# ---------------------------------------------------------------------------------------------------- plastic laws
@pytest.mark.parametrize("name", PLASTIC)
def test_return_map_is_a_projection(name: str):
    """R(R(F)) = R(F) once all that flows has flowed, whatever the total volume was, with the slip of the first map and
    no more heat; the second map starts on the yield surface."""
    F, t = generic(500, RNG), RNG.uniform(-0.5, 0.5, 500)
    first = evaluate(("hencky",), (name,), F, dt=LONG, memory={"log_J": t})
    once = first["Fe"]
    if name == "cam_clay":  # its strength is that of the plastic volume J/Je before the step: keep that
        t = t + np.log(np.linalg.det(once) / np.linalg.det(F))
    twice = evaluate(("hencky",), (name,), once, dt=LONG, memory={"log_J": t, "slip": first["slip"]})["Fe"]
    # LONG leaves η/(μ dt) = 1e-33 of an overstress; at the surface one ulp of the strain flows or not
    assert close(twice, once, scale=1.0)


@pytest.mark.parametrize("name", PLASTIC)
def test_return_map_is_objective_and_isotropic(name: str):
    """R(Q F) = Q R(F) and R(F Q) = R(F) Q."""
    F = generic(500, RNG)
    Q = rotations(500, RNG)
    Fe = evaluate(("hencky",), (name,), F)["Fe"]
    assert close(evaluate(("hencky",), (name,), Q @ F)["Fe"], Q @ Fe, scale=1.0)
    assert close(evaluate(("hencky",), (name,), F @ Q)["Fe"], Fe @ Q, scale=1.0)


@pytest.mark.parametrize(
    ("name", "elastic"),
    # associated flow trades shape for volume, which is a bargain in the energy it is associated with: Hencky's
    [(p, e) for p in PLASTIC for e in ELASTIC if p != "cam_clay" or e == "hencky"],
)
def test_plastic_flow_never_creates_energy(name: str, elastic: str):
    """ψ(R(F)) ≤ ψ(F) whatever the total volume was (stretches above ½: below, |F − R|² is not convex in the
    logarithm)."""
    F = generic(500, RNG, spread=0.5)
    before = evaluate((elastic,), (), F)["psi"]
    Fe = evaluate(("hencky",), (name,), F, memory={"log_J": RNG.uniform(-0.5, 0.5, 500)})["Fe"]
    after = evaluate((elastic,), (), Fe)["psi"]
    assert (after <= before + 1e-12 * (LAM + 2 * MU)).all()


@pytest.mark.parametrize("name", PLASTIC)
def test_return_map_keeps_the_orientation(name: str):
    """det R(F) > 0 and the polar rotation of R(F) is that of F."""
    F = generic(500, RNG, spread=1.0)
    Fe = evaluate(("hencky",), (name,), F)["Fe"]
    assert (np.linalg.det(Fe) > 0).all()

    def polar(A: np.ndarray) -> np.ndarray:
        U, _, Vh = np.linalg.svd(A)
        return U @ Vh

    assert close(polar(Fe), polar(F), scale=1.0)


# ------------------------------------------------------------------------------------- closed forms of single laws
def principal_stress(F: np.ndarray, plastic: str, **kw) -> tuple[np.ndarray, np.ndarray]:
    """|dev τ| and p = −tr τ/3."""
    tau = evaluate(("hencky",), (plastic,), F, **kw)["tau"]
    p = -np.trace(tau, axis1=1, axis2=2) / 3
    dev = tau + p[:, None, None] * np.eye(3)
    return np.linalg.norm(dev, axis=(1, 2)), p


def test_von_mises_yields_at_the_uniaxial_stress():
    """In uniaxial tension beyond yield the only stress is τ_xx = σ_Y."""
    e = 0.5
    F = np.diag(np.exp([e, -e * DEFAULTS["nu"], -e * DEFAULTS["nu"]]))[None]
    dev, p = principal_stress(F, "von_mises")
    # the pressure is that of the trial state, E e/3 at these strains
    assert abs(dev[0] / (math.sqrt(2 / 3) * DEFAULTS["yield_stress"]) - 1) < 1e-12
    assert abs(-p[0] / (DEFAULTS["E"] * e / 3) - 1) < 1e-12


def test_von_mises_below_yield_is_elastic_to_the_last_bit():
    """Fe = F where nothing flows: no drift over any number of substeps."""
    F = rotations(200, RNG) @ (np.eye(3) + 1e-3 * RNG.normal(size=(200, 3, 3)))
    assert (evaluate(("hencky",), ("von_mises",), F)["Fe"] == F).all()


@pytest.mark.parametrize(
    ("name", "alpha"),
    [
        ("drucker_prager", lambda s, t: math.sqrt(2 / 3) * 2 * s / (3 - s)),
        ("drucker_prager_plane_strain", lambda s, t: math.sqrt(2) * t / math.sqrt(9 + 12 * t * t)),
    ],
)
def test_drucker_prager_ends_on_its_cone(name: str, alpha):
    """After the map |dev τ| = 3 α (p + κ tr c), with cohesion; on the tip τ = 3 κ c I."""
    kappa, c = LAM + 2 * MU / 3, DEFAULTS["cohesion"]
    phi = math.radians(DEFAULTS["friction_angle"])
    a = alpha(math.sin(phi), math.tan(phi))
    e = RNG.uniform(-0.3, 0.3, (500, 3))
    e -= (e.mean(1) + 0.03)[:, None]
    dev, p = principal_stress(stretched(np.exp(e), RNG), name)
    bound = 3 * a * (p + 3 * kappa * c)
    elastic = 2 * MU * np.linalg.norm(e - e.mean(1, keepdims=True), axis=1)
    assert close(dev, np.minimum(bound, elastic), scale=LAM + 2 * MU)
    assert (elastic > bound).mean() > 0.5
    tau = evaluate(("hencky",), (name,), stretched(np.full((20, 3), 1.3), RNG))["tau"]
    assert close(tau, 3 * kappa * c * np.eye(3), scale=LAM + 2 * MU)


@pytest.mark.parametrize("name", ["drucker_prager", "drucker_prager_plane_strain"])
def test_grains_bear_nothing_until_the_pores_have_closed(name: str):
    """Opened by 10 % and pressed again, 1 % of volume a step: p = 0 while J > 1, then p = −χ κ ln J; let go,
    dp = −κ d ln J. A cone that forgets would resist from the first step of the way back."""
    kappa, step = LAM + 2 * MU / 3, math.log(1.1) / 10
    path = np.cumsum([step] * 10 + [-step] * 15 + [step] * 2)
    Fe, seen, before = np.eye(3)[None], [], 0.0
    for t in path:
        out = evaluate(
            ("hencky",),
            (name,),
            math.exp((t - before) / 3) * Fe,
            memory={"log_J": np.array([t])},
            params={"cohesion": 0.0},
        )
        Fe, before = out["Fe"], t
        assert close(out["tau"], out["tau"][:, :1, :1] * np.eye(3), scale=kappa)
        seen.append(-out["tau"][0, 0, 0])
    assert close(np.array(seen[:20]), np.zeros(1), scale=kappa)
    assert close(np.array(seen[20:25]), LATCH * kappa * step * np.arange(1, 6), scale=kappa)
    left = LATCH * kappa * step * 5 - kappa * step * np.arange(1, 3)  # as the spring goes back, till it is loose
    assert close(np.array(seen[25:]), np.maximum(left, 0.0), scale=kappa)


def test_compression_cone_at_30_degrees_acts_like_49_in_plane_strain():
    """α_compression(30°) = α_plane_strain(φ') at φ' = 49.1°, the reason why both cones are named."""
    import torch

    from diffuphy.material.plastic.drucker_prager import slope

    target = float(slope(torch.tensor(30.0, dtype=torch.float64), "compression"))
    angles = torch.linspace(30, 60, 30001, dtype=torch.float64)
    found = float(angles[(slope(angles, "plane_strain") - target).abs().argmin()])
    assert abs(found - 49.1) < 0.1


def test_fluid_keeps_volume_and_rotation():
    """Fe = J^⅓ R, τ a pressure."""
    F = generic(200, RNG)
    out = evaluate(("hencky",), ("fluid",), F)
    U, _, Vh = np.linalg.svd(F)
    J = np.linalg.det(F)[:, None, None]
    assert close(out["Fe"], J ** (1 / 3) * (U @ Vh), scale=1.0)
    p = np.trace(out["tau"], axis1=1, axis2=2)[:, None, None] / 3
    assert close(out["tau"], p * np.eye(3), scale=LAM + 2 * MU)


def test_bingham_step_solves_its_implicit_equation():
    """s − s' = μ dt (s' − √(2/3) σ_Y)/η: the residual vanishes."""
    dt, eta = 2e-3, DEFAULTS["viscosity"]
    e = RNG.uniform(-0.3, 0.3, (300, 3))
    s = 2 * MU * np.linalg.norm(e - e.mean(1, keepdims=True), axis=1)
    after, _ = principal_stress(stretched(np.exp(e), RNG), "viscoplastic", dt=dt)
    over = np.maximum(after - math.sqrt(2 / 3) * DEFAULTS["yield_stress"], 0.0)
    assert close(s - after, MU * dt * over / eta, scale=LAM + 2 * MU)
    assert (over > 0).mean() > 0.5


def test_bingham_limits_are_von_mises_and_elastic():
    """η → 0 gives von Mises, η → ∞ the elastic solid; both differ by O(η/(μ dt)), O(μ dt/η)."""
    F = generic(200, RNG)
    thin = evaluate(("hencky",), ("viscoplastic",), F, params={"viscosity": 1e-10})["Fe"]
    thick = evaluate(("hencky",), ("viscoplastic",), F, params={"viscosity": 1e16})["Fe"]
    assert np.abs(thin - evaluate(("hencky",), ("von_mises",), F)["Fe"]).max() < 1e-10
    assert np.abs(thick - F).max() < 1e-10


def test_viscosity_is_that_of_a_steady_shear():
    """In steady simple shear τ_xy = σ_Y/√3 + η γ̇ (Bingham).

    γ̇ dt = 1e-4 per substep: the elastic strain that carries the stress is below 0.05, so rotation of its frame changes
    τ_xy by its square, 0.3 %; the substep by 1e-4.
    """
    dt, rate, eta, sigma_y = 1e-4, 1.0, 500.0, 1e3
    step = np.eye(3)[None].copy()
    step[:, 0, 1] = rate * dt
    F = np.eye(3)[None]
    params = {"yield_stress": sigma_y, "viscosity": eta}
    for _ in range(1500):  # ten relaxation times η/μ = 13 ms
        out = evaluate(("hencky",), ("viscoplastic",), step @ F, params=params, dt=dt)
        F = out["Fe"]
    assert abs(out["tau"][0, 0, 1] / (sigma_y / math.sqrt(3) + eta * rate) - 1) < 5e-3
