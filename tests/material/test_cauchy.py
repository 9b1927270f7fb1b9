"""Stress of the matter of a film."""

import math

import pytest
import torch

from diffuphy.material import ELASTIC, kirchhoff
from diffuphy.material.cauchy import cauchy, von_mises
from diffuphy.types import MaterialField

N = 40


def field(elastic: tuple[str, ...], w: torch.Tensor) -> MaterialField:
    theta = {p.name: torch.full((N,), p.default, dtype=torch.float64) for name in elastic for p in ELASTIC[name].params}
    return MaterialField(elastic, ("identity",), w, torch.ones(N, 1), theta, torch.full((N,), 1e3))


def deformed() -> torch.Tensor:
    g = torch.Generator().manual_seed(0)
    return torch.linalg.matrix_exp(0.3 * torch.randn(N, 3, 3, dtype=torch.float64, generator=g))


@pytest.mark.parametrize("laws", [("neo_hookean",), ("hencky", "fixed_corotated"), tuple(ELASTIC)])
def test_stress_of_a_mixture_is_the_mean_of_its_laws(laws: tuple[str, ...]) -> None:
    """von Mises √(3/2) |dev σ| of σ = Σ w τ_k/J, from the full tensors of the Warp functions."""
    F, g = deformed(), torch.Generator().manual_seed(1)
    w = torch.rand(N, len(laws), generator=g, dtype=torch.float64)
    w = w / w.sum(1, keepdim=True)
    matter = field(laws, w)
    J = torch.linalg.det(F)
    params = matter.theta
    tau = sum(
        w[:, k, None, None] * kirchhoff(F, name, {p.name: params[p.name] for p in ELASTIC[name].params})
        for k, name in enumerate(laws)
    )
    sigma = tau / J[:, None, None]
    mean = sigma.diagonal(dim1=1, dim2=2).mean(1)
    dev = sigma - mean[:, None, None] * torch.eye(3).double()
    expected = math.sqrt(1.5) * torch.linalg.matrix_norm(dev)
    found = cauchy(F, J, matter)
    # two decompositions of condition ten at float64's rounding
    torch.testing.assert_close(von_mises(found), expected, rtol=1e-9, atol=1e-6)
    torch.testing.assert_close(found.mean(1), mean, rtol=1e-9, atol=1e-6)


def test_uniaxial_tension_is_its_own_equivalent_stress() -> None:
    """von Mises of diag(σ, 0, 0) is |σ|; of a pressure 0."""
    sigma = torch.tensor([[-5.0, 0.0, 0.0], [2.0, 2.0, 2.0]])
    torch.testing.assert_close(von_mises(sigma), torch.tensor([5.0, 0.0]))


def test_another_count_of_particles_is_refused() -> None:
    with pytest.raises(ValueError, match="that of 3 particles, the material that of 40"):
        cauchy(deformed()[:3], torch.ones(3), field(("hencky",), torch.ones(N, 1)))
