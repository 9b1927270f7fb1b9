"""Rotations and covariances of Gaussians, volumes of matter."""

import torch
from scipy.spatial.transform import Rotation

from diffuphy.geometry import covariances, rotations, volume_ratio

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


def test_volume_is_det_F_while_it_has_digits_and_det_Fe_when_shear_has_taken_them():
    """F = S^n Fe with det S = 1, a shear, in float32: J = det Fe whatever n; det F alone is off by ε |F| |cof F|."""
    Fe = torch.diag(torch.tensor([0.9, 1.0, 1.0])).expand(64, 3, 3)
    shear = torch.eye(3).repeat(64, 1, 1)
    shear[:, 0, 1] = 0.3
    shear[:, 1, 2] = torch.linspace(0.2, 0.4, 64)
    shear[:, 2, 0] = 0.1
    shear /= torch.linalg.det(shear)[:, None, None] ** (1 / 3)
    F = Fe.clone()
    for n in range(60):
        if n == 3:
            J = volume_ratio(F, Fe)  # products of a few roundings of 6e-8
            torch.testing.assert_close(J, torch.full((64,), 0.9, dtype=torch.float64), rtol=1e-5, atol=0)
            assert not torch.equal(J, torch.linalg.det(Fe.double()))
        F = shear @ F
    assert bool((torch.linalg.det(F.double()) < 0).any())  # by det F some are inside out
    torch.testing.assert_close(volume_ratio(F, Fe), torch.linalg.det(Fe.double()), rtol=0, atol=0)


def test_volume_of_what_does_not_flow_is_det_F():
    """Inside out is told: J < 0."""
    F = normal(20, 3, 3)
    torch.testing.assert_close(volume_ratio(F), torch.linalg.det(F), rtol=1e-12, atol=1e-14)
    mirror = torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    assert float(volume_ratio(mirror)) == -1.0
    assert float(volume_ratio(mirror, torch.eye(3))) == -1.0
