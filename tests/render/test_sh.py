"""Spherical harmonics in the 3DGS basis."""

import math

import pytest
import torch

from diffuphy.geometry import rotations
from diffuphy.render import orbit, rasterize, render_gaussians, sh
from diffuphy.types import Camera, Gaussians


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def unit(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.nn.functional.normalize(normal(*shape, seed=seed), dim=-1)


def one_camera() -> Camera:
    camera = orbit([30.0], [20.0], 3.0, width=32, height=32)
    return Camera(camera.viewmats.double(), camera.Ks.double(), 32, 32)


def test_basis_is_orthonormal() -> None:
    """∫ Y_i Y_j dω = δ_ij, by Gauss-Legendre in z and equal steps in φ, exact to degree 15."""
    import numpy as np

    z, w = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(8))
    phi = torch.arange(16, dtype=torch.float64) * (2 * math.pi / 16)
    r = torch.sqrt(1 - z**2)[:, None]
    d = torch.stack([r * torch.cos(phi), r * torch.sin(phi), z[:, None].expand(8, 16)], dim=-1).reshape(-1, 3)
    Y = sh.basis(d, 3)
    gram = Y.T @ (Y * (w[:, None].expand(8, 16).reshape(-1, 1) * 2 * math.pi / 16))
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), rtol=0, atol=1e-13)


def test_degree_one_is_the_published_one() -> None:
    """rgb = ½ + C0 sh_0 - C1 y sh_1 + C1 z sh_2 - C1 x sh_3 (Kerbl et al. 2023, ``computeColorFromSH``)."""
    d = unit(1, 3)
    x, y, z = d[0]
    expected = torch.stack(
        [torch.tensor(0.28209479177387814, dtype=torch.float64), *(0.4886025119029199 * v for v in (-y, z, -x))]
    )
    torch.testing.assert_close(sh.basis(d, 1)[0], expected)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_rotated_coefficients_give_the_rotated_function(degree: int) -> None:
    """f'(R d) = f(d) for f' = rotate(f, R)."""
    coefficients, d = normal(5, (degree + 1) ** 2, 3), unit(50, 3, seed=1)
    R = rotations(normal(5, 4, seed=2))
    turned = sh.rotate(coefficients, R)
    before = torch.einsum("nk,gkc->gnc", sh.basis(d, degree), coefficients)
    after = torch.einsum("gnk,gkc->gnc", sh.basis(d @ R.mT, degree), turned)
    torch.testing.assert_close(after, before, rtol=1e-12, atol=1e-12)


def test_rotations_compose_and_keep_length() -> None:
    """rotate(rotate(f, A), B) = rotate(f, B A), and each band keeps its norm."""
    f = normal(4, 16, 3)
    A, B = rotations(normal(4, 4, seed=1)), rotations(normal(4, 4, seed=2))
    torch.testing.assert_close(sh.rotate(sh.rotate(f, A), B), sh.rotate(f, B @ A), rtol=1e-12, atol=1e-12)
    for b in range(4):
        band = slice(b * b, (b + 1) ** 2)
        torch.testing.assert_close(sh.rotate(f, A)[:, band].norm(dim=1), f[:, band].norm(dim=1))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_polar_is_the_rotation_of_the_svd(dtype: torch.dtype) -> None:
    """polar(F) = U Vᵀ for F = U S Vᵀ with stretches from 1/30 to 30, and exactly 1 for F = 1."""
    U, V = rotations(normal(200, 4)), rotations(normal(200, 4, seed=1))
    S = 30.0 ** torch.empty(200, 3, dtype=torch.float64).uniform_(-1, 1, generator=torch.Generator().manual_seed(2))
    F = ((U * S[:, None]) @ V.mT).to(dtype)
    # the inverse by cofactors in Newton's step is exact to eps times the condition number σ₁ / σ₃
    condition = S.amax(1) / S.amin(1)
    error = torch.linalg.matrix_norm(sh.polar(F).double() - U @ V.mT)
    assert (error <= 4 * torch.finfo(dtype).eps * (1 + condition)).all()
    assert torch.equal(sh.polar(torch.eye(3, dtype=dtype)[None])[0], torch.eye(3, dtype=dtype))


def test_polar_gradient_is_right_at_the_identity() -> None:
    """d polar(1)·H = skew(H): there the derivative of an SVD divides by zero."""
    F = torch.eye(3, dtype=torch.float64)[None].requires_grad_()
    assert torch.autograd.gradcheck(sh.polar, (F,), atol=1e-7)
    assert torch.autograd.gradcheck(sh.polar, (normal(2, 3, 3).matrix_exp().requires_grad_(),), atol=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_rotating_body_carries_its_colours(degree: int) -> None:
    """Deforming by F = R looks like rotating centres, orientations and coefficients by R; so does turning the camera
    by Rᵀ."""
    R = rotations(normal(1, 4, seed=5))[0]
    stretch = torch.diag(torch.tensor([1.3, 0.8, 1.0], dtype=torch.float64))
    means, coefficients, camera = 0.5 * normal(20, 3), normal(20, (degree + 1) ** 2, 3), one_camera()
    moved = means @ R.mT
    by_F = sh.colors(coefficients, moved, camera, (R @ stretch).expand(20, 3, 3))
    by_coefficients = sh.colors(sh.rotate(coefficients, R), moved, camera)
    torch.testing.assert_close(by_F, by_coefficients, rtol=1e-12, atol=1e-12)
    turn = torch.eye(4, dtype=torch.float64)
    turn[:3, :3] = R
    by_camera = sh.colors(coefficients, means, Camera(camera.viewmats @ turn, camera.Ks, 32, 32))
    torch.testing.assert_close(by_F, by_camera, rtol=1e-12, atol=1e-12)


def test_degree_zero_looks_at_nothing_else() -> None:
    """At degree 0 colours come from the coefficients alone: no camera, no F, no copy a view."""
    coefficients = normal(7, 1, 3)
    camera = orbit([0.0, 90.0], [0.0, 0.0], 3.0, width=8, height=8)
    broken = torch.full((7, 3), math.nan, dtype=torch.float64)
    colors = sh.colors(coefficients, broken, camera, torch.full((7, 3, 3), math.nan, dtype=torch.float64))
    assert colors.shape == (2, 7, 3) and colors.stride(0) == 0
    torch.testing.assert_close(colors[0], (0.5 + 0.28209479177387814 * coefficients[:, 0]).clamp_min(0))
    torch.testing.assert_close(sh.colors(sh.from_rgb(colors[0]), broken, camera)[0], colors[0])


def test_render_gaussians_is_rasterize_of_its_parts() -> None:
    g = Gaussians(0.3 * normal(9, 3), normal(9, 4), normal(9, 3) - 3, normal(9), normal(9, 4, 3))
    camera = one_camera()
    F = normal(9, 3, 3, seed=4).mul(0.2).matrix_exp()
    image = render_gaussians(g, camera, F=F, background=torch.ones(3, dtype=torch.float64))
    colors = sh.colors(g.sh, g.means, camera, F)
    expected = rasterize(g.means, g.quats, g.log_scales.exp(), g.logit_opacities.sigmoid(), colors, camera, F=F)
    torch.testing.assert_close(image.rgb, expected.over(torch.ones(3, dtype=torch.float64)))


def test_a_wrong_number_of_coefficients_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"1, 4, 9 or 16 coefficients .* got 5"):
        sh.degree_of(torch.zeros(2, 5, 3))
