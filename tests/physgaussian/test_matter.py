"""The numbers of the six materials mean here what they meant there, except where that is said."""

import math

import pytest
import torch

from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.material.plastic.drucker_prager import slope
from diffuphy.physgaussian.matter import SUBSTANCES, matter
from diffuphy.physgaussian.scene_file import parse

E, NU = 2e5, 0.3
MU = E / (2 * (1 + NU))


def flowed(n, dt=0.0, slip=0.0, **values):
    """|ê| after a step of the law of a file, from the trial |ê| = n without change of volume."""
    (piece,) = matter(parse({"E": E, "nu": NU, **values})).pieces
    law = PLASTIC[piece.plastic]
    theta = {k: torch.tensor(v, dtype=torch.float64) for k, v in piece.theta.items()}
    n = torch.tensor(n, dtype=torch.float64)
    memory = [{m: torch.tensor({"slip": slip}.get(m, 0.0), dtype=torch.float64) for m in law.memory}]
    a, b = law.flow(n, torch.zeros_like(n), theta, dt, *(memory if law.memory else []))
    assert float(b) == 0.0
    return float(n * (1 - a))


@pytest.mark.parametrize("material", ["metal", "plasticine"])
def test_yield_stress_is_the_norm_of_the_deviator(material):
    """|dev τ|_F = 2μ |ê| = yield_stress in flow; nothing flows just below."""
    values = {"material": material, "yield_stress": 100.0, "softening": 0.0}
    assert 2 * MU * flowed(5e-3, **values) == pytest.approx(100.0, rel=1e-12)
    below = 0.999 * 100.0 / (2 * MU)
    assert flowed(below, **values) == below


def test_metal_hardens_with_the_norm_of_its_plastic_strain():
    """|dev τ| = yield_stress + 2μ xi δγ, δγ = |ê_trial| − |ê|."""
    n = 5e-3
    left = flowed(n, material="metal", yield_stress=100.0, hardening=1, xi=0.2)
    assert 2 * MU * left == pytest.approx(100.0 + 2 * MU * 0.2 * (n - left), rel=1e-12)


def test_hardening_off_ignores_xi():
    (piece,) = matter(parse({"material": "metal", "yield_stress": 100.0, "xi": 0.2})).pieces
    assert piece.plastic == "von_mises" and "hardening" not in piece.theta


def test_plasticine_softens_with_the_norm_of_its_plastic_strain():
    """|dev τ| = yield_stress − softening δγ, and what is lost stays lost: δγ = √(3/2) slip before the step."""
    n, soft = 5e-3, 1e4
    left = flowed(n, material="plasticine", yield_stress=100.0, softening=soft)
    assert 2 * MU * left == pytest.approx(100.0 - soft * (n - left), rel=1e-12)
    slip = 1e-3
    left = flowed(n, slip=slip, material="plasticine", yield_stress=100.0, softening=soft)
    assert 2 * MU * left == pytest.approx(100.0 - soft * (math.sqrt(1.5) * slip + n - left), rel=1e-12)


def test_foam_flows_as_fast():
    """|dev τ| = s − y/(1 + η/(2μ Δt)), y = s − √(2/3) yield_stress, with η = plastic_viscosity."""
    n, eta, dt, sigma = 5e-3, 30.0, 1e-4, 100.0
    s = 2 * MU * n
    there = s - (s - math.sqrt(2 / 3) * sigma) / (1 + eta / (2 * MU * dt))
    here = 2 * MU * flowed(n, dt, material="foam", yield_stress=sigma, plastic_viscosity=eta)
    assert here == pytest.approx(there, rel=1e-12)


def test_sand_has_the_same_cone():
    """α = √(2/3) 2 sin φ/(3 − sin φ), no cohesion."""
    (piece,) = matter(parse({"material": "sand", "friction_angle": 30})).pieces
    alpha = slope(torch.tensor(piece.theta["friction_angle"], dtype=torch.float64), "compression")
    assert piece.plastic == "drucker_prager" and piece.theta["cohesion"] == 0.0
    assert float(alpha) == pytest.approx(math.sqrt(2 / 3) * 2 * 0.5 / 2.5, rel=1e-12)


def test_snow_has_stress():
    """Pressed a little it is elastic, pressed hard its pores collapse; there τ = 0 whatever happens."""
    (piece,) = matter(parse({"material": "snow", "E": E, "nu": NU})).pieces
    theta = {k: torch.tensor(v, dtype=torch.float64) for k, v in piece.theta.items()}
    kappa = E / (3 * (1 - 2 * NU))
    for tr, flows in ((-0.5 * theta["preconsolidation"] / kappa, False), (torch.tensor(-0.2), True)):
        tr = tr.double()
        _a, b = PLASTIC["cam_clay"].flow(torch.zeros_like(tr), tr, theta, 0.0, {"log_J": tr})
        assert (float(b) != 0.0) == flows
        assert float(tr + 3 * b) < 0.0  # what is left is pressure


@pytest.mark.parametrize("material", list(SUBSTANCES))
def test_every_material_is_made_of_known_laws_with_all_they_read(material):
    (piece,) = matter(parse({"material": material})).pieces
    laws = (*ELASTIC[piece.elastic].params, *PLASTIC[piece.plastic].params)
    assert {p.name for p in laws} == set(piece.theta)
    assert (piece.theta["E"], piece.theta["nu"], piece.rho) == (1e5, 0.4, 200.0)


def test_hardening_follows_the_shear_modulus_of_the_region():
    """H = 3μ xi of each region, as μ is read per particle there."""
    region = {"point": [1, 1, 1.5], "size": [1, 1, 0.5], "E": 3 * E, "nu": NU, "density": 50}
    data = {"material": "metal", "E": E, "nu": NU, "hardening": 1, "xi": 0.2, "additional_material_params": [region]}
    body, top = matter(parse(data)).pieces
    assert top.theta["hardening"] == pytest.approx(3 * body.theta["hardening"], rel=1e-12)
    assert (top.rho, top.low, top.high) == (50.0, (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0))
