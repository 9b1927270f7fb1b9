"""Sums over particles."""

import pytest
import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import Scene, Scheme
from diffuphy.mpm.diagnostics import diagnose
from diffuphy.mpm.state import initial_state, make_matter
from tests.mpm.bodies import block, field


@pytest.mark.parametrize(("order", "D"), [(2, 1 / 4), (3, 1 / 3)])
def test_a_spinning_body_has_the_momentum_and_energy_of_its_affine_field_too(order, D):
    """L_z = ω Σ m (x² + y² + 2 D Δx²), K = ω² Σ m (x² + y² + 2 D Δx²)/2, with D of the spline."""
    dx, omega = 0.1, 3.0
    x, vol = block((2, 2, 2), dx, (-0.1, -0.1, -0.1))
    scheme = Scheme(order=order)
    mixture = make_mixture(("neo_hookean",), ("identity",), wp.float64)
    matter = make_matter(field(len(x)), vol, mixture.params, torch.float64)
    state = initial_state(Scene(dx=dx, spin=(0.0, 0.0, omega), lift=None), x, matter, mixture)
    sums = diagnose(mixture, state, matter, dx, scheme)
    inertia = float((matter.m * (x[:, :2].square().sum(1) + 2 * D * dx**2)).sum())
    assert sums.angular_momentum.tolist() == pytest.approx([0.0, 0.0, omega * inertia], rel=1e-12, abs=1e-14)
    assert sums.kinetic == pytest.approx(0.5 * omega**2 * inertia, rel=1e-12)
    assert sums.momentum.tolist() == pytest.approx([0.0, 0.0, 0.0], abs=1e-14)
    assert sums.elastic == 0.0 and sums.J == (1.0, 1.0)
