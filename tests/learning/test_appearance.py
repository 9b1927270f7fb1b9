"""What the material network sees of a particle: nothing of where the body lies and how it is turned."""

import math

import pytest
import torch
from numpy.polynomial.legendre import leggauss

from diffuphy.geometry import log_covariances, rotations
from diffuphy.learning.appearance import appearance
from diffuphy.render.sh import basis
from diffuphy.types import Gaussians, Particles


def body(degree=0, n=20):
    """Thin Gaussians of all orientations, each on a particle of its own."""
    g = torch.Generator().manual_seed(0)
    x = torch.rand(n, 3, generator=g) - 0.5
    sh = 0.3 * torch.randn(n, (degree + 1) ** 2, 3, generator=g)
    thin = torch.tensor([-1.0, -2.0, -6.0]).expand(n, 3)
    gaussians = Gaussians(x, torch.randn(n, 4, generator=g), thin, torch.zeros(n), sh)
    return gaussians, Particles(x / 2, torch.ones(n), torch.arange(n), 0.5, (0.0, 0.0, 0.0), 0.1)


def product(p, q):
    """Quaternion p q, wxyz."""
    w = p[0] * q[:, 0] - (p[1:] * q[:, 1:]).sum(1)
    v = p[0] * q[:, 1:] + q[:, :1] * p[1:] + torch.linalg.cross(p[1:].expand_as(q[:, 1:]), q[:, 1:])
    return torch.cat([w[:, None], v], 1)


def test_log_covariances_are_the_logarithm_of_the_covariance():
    """exp(ln Σ) = R diag(s²) Rᵀ in float64, where the exponential of −12 still has all its digits."""
    gaussians, _ = body()
    quats, log_scales = gaussians.quats.double(), gaussians.log_scales.double()
    R = rotations(quats)
    want = (R * (2 * log_scales).exp()[:, None, :]) @ R.mT
    torch.testing.assert_close(
        torch.linalg.matrix_exp(log_covariances(quats, log_scales)), want, rtol=1e-10, atol=1e-14
    )
    disc = log_covariances(torch.tensor([1.0, 0, 0, 0]), torch.tensor([0.0, 0.0, -math.inf]), thinnest=1e-3)
    assert float(disc[2, 2]) == pytest.approx(2 * math.log(1e-3))


def test_turned_gaussians_look_the_same_from_their_body():
    """x' = R x, q' = r q: seen from the turned frame nothing has changed, for Gaussians 150 times thinner than long.

    Rounding of a quaternion, 1e-7, over logarithms of at most 14.
    """
    gaussians, particles = body()
    r = torch.tensor([0.4, -0.5, 0.7, 0.2])
    R = rotations(r)
    turned = Gaussians(
        gaussians.means @ R.T, product(r / r.norm(), gaussians.quats), gaussians.log_scales,
        gaussians.logit_opacities, gaussians.sh,
    )  # fmt: skip
    there = Particles(particles.x @ R.T, particles.vol, particles.gaussian, 0.5, (0.0, 0.0, 0.0), 0.1)
    here, seen = appearance(gaussians, particles), appearance(turned, there).seen_from(torch.zeros(3), R)
    torch.testing.assert_close(seen.x, here.x, rtol=0, atol=1e-6)
    torch.testing.assert_close(seen.f, here.f, rtol=0, atol=2e-5)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_sheen_is_the_standard_deviation_of_the_colour_over_directions(degree):
    """sheen² = Σ_rgb Var of Σ c Y over the sphere, by a quadrature exact to degree 6 (8 × 16 points)."""
    gaussians, particles = body(degree)
    z, w = (torch.tensor(a) for a in leggauss(8))
    phi = torch.arange(16, dtype=torch.float64) / 16 * 2 * math.pi
    z, phi, w = (a.reshape(-1) for a in (*torch.meshgrid(z, phi, indexing="ij"), (w[:, None] / 32).expand(8, 16)))
    d = torch.stack([(1 - z**2).sqrt() * phi.cos(), (1 - z**2).sqrt() * phi.sin(), z], 1)
    colour = torch.einsum("db,nbc->dnc", basis(d, degree), gaussians.sh.double())
    mean = (w[:, None, None] * colour).sum(0)
    variance = (w[:, None, None] * (colour - mean) ** 2).sum((0, 2))
    torch.testing.assert_close(appearance(gaussians, particles).f[:, 10], variance.sqrt().float(), rtol=1e-5, atol=1e-6)
