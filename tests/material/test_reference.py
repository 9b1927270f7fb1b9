"""The Warp functions agree with the torch reference, law by law, and the reference refuses what cannot be."""

import numpy as np
import pytest
import torch

from diffuphy.material import ELASTIC, PLASTIC, reference
from tests.material.evaluate import DEFAULTS, evaluate, generic, special

RNG = np.random.default_rng(0)
F = np.concatenate([generic(300, RNG, spread=0.6), *special(RNG).values()])
# tens of rounded operations, amplified by the largest stretch squared (3.3) and by the stiffness in volume (M/E = 1.3)
TOLERANCE = 500 * np.finfo(np.float64).eps


@pytest.mark.parametrize("name", ELASTIC)
def test_stress_and_energy_agree_with_the_reference(name: str):
    out = evaluate((name,), (), F)
    tau = reference.kirchhoff(torch.from_numpy(F), name, DEFAULTS).numpy()
    psi = reference.energy(torch.from_numpy(F), name, DEFAULTS).numpy()
    scale = np.maximum(DEFAULTS["E"], np.abs(tau).max((1, 2)))
    assert (np.abs(out["tau"] - tau).max((1, 2)) < TOLERANCE * scale).all()
    assert np.abs(out["psi"] - psi).max() < TOLERANCE * DEFAULTS["E"]


@pytest.mark.parametrize("name", PLASTIC)
def test_return_map_agrees_with_the_reference(name: str):
    out = evaluate(("hencky",), (name,), F, dt=2e-3)
    Fe = reference.return_map(torch.from_numpy(F), name, DEFAULTS, dt=2e-3).numpy()
    assert np.abs(out["Fe"] - Fe).max() < TOLERANCE


@pytest.mark.parametrize("name", PLASTIC)
def test_return_map_of_matter_with_a_past_agrees_with_the_reference(name: str):
    log_J = RNG.uniform(-0.5, 0.5, len(F))
    out = evaluate(("hencky",), (name,), F, dt=2e-3, memory={"log_J": log_J})
    Fe = reference.return_map(
        torch.from_numpy(F), name, DEFAULTS, dt=2e-3, memory={"log_J": torch.from_numpy(log_J)}
    ).numpy()
    assert np.abs(out["Fe"] - Fe).max() < TOLERANCE


@pytest.mark.parametrize("name", ELASTIC)
def test_parameters_may_vary_over_a_batch(name: str):
    """Row by row the same as one call with tensors of parameters."""
    A = torch.from_numpy(generic(3, RNG))
    values = torch.tensor([1e4, 1e5, 1e6], dtype=torch.float64)
    stiff = ELASTIC[name].params[0].name
    batch = reference.kirchhoff(A, name, DEFAULTS | {stiff: values})
    for p in range(3):
        torch.testing.assert_close(batch[p], reference.kirchhoff(A[p], name, DEFAULTS | {stiff: float(values[p])}))


def test_impossible_states_and_parameters_are_refused():
    eye = torch.eye(3, dtype=torch.float64)
    with pytest.raises(ValueError, match="unknown law 'rubber'; known: fixed_corotated"):
        reference.kirchhoff(eye, "rubber", DEFAULTS)
    with pytest.raises(ValueError, match="'nu' is missing"):
        reference.kirchhoff(eye, "hencky", {"E": 1e5})
    with pytest.raises(ValueError, match="nu must be in"):
        reference.energy(eye, "hencky", {"E": 1e5, "nu": 0.5})
    with pytest.raises(ValueError, match="det F must be positive, got -1"):
        reference.return_map(-eye, "fluid", {})
