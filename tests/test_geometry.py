"""Rotations and covariances of Gaussians."""

import torch
from scipy.spatial.transform import Rotation

from diffuphy.geometry import covariances, rotations

ROUNDING = {"rtol": 0.0, "atol": 1e-14}
"""A few dozen products of numbers of size 1 in float64."""


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_rotations_are_those_of_the_normalised_quaternions():
    quats = 3 * normal(2, 50, 4)
    expected = Rotation.from_quat(quats.reshape(-1, 4).numpy(), scalar_first=True).as_matrix()
    torch.testing.assert_close(rotations(quats), torch.from_numpy(expected).reshape(2, 50, 3, 3), **ROUNDING)


def test_rotations_follow_the_hand():
    """A quarter turn about z takes x to y."""
    R = rotations(torch.tensor([0.5**0.5, 0.0, 0.0, 0.5**0.5], dtype=torch.float64))
    turned = R @ torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(turned, torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), **ROUNDING)


def test_covariances_have_the_scales_as_principal_deviations():
    """Σ R = R S²: the columns of R are the principal axes."""
    quats, scales = normal(20, 4), normal(20, 3, seed=1).exp()
    R = rotations(quats)
    torch.testing.assert_close(covariances(quats, scales) @ R, R * scales[:, None, :] ** 2, rtol=1e-12, atol=1e-12)


def test_covariances_deform_as_vectors_do():
    """x → F x takes Σ to F Σ Fᵀ."""
    quats, scales, F = normal(20, 4), normal(20, 3, seed=1).exp(), normal(20, 3, 3, seed=2)
    # condition: products of up to seven factors of size 1 to 30
    expected = F @ covariances(quats, scales) @ F.mT
    torch.testing.assert_close(covariances(quats, scales, F), expected, rtol=1e-11, atol=1e-11)
