"""Fréchet distance and KVD against closed forms."""

import pytest
import scipy.linalg
import torch

from diffuphy.metrics.frechet import frechet, kernel, windows


def exact(mean, covariance):
    """Rows whose sample mean and covariance are these: ± columns of a root, scaled for n − 1."""
    d = len(mean)
    root = torch.linalg.cholesky(covariance)
    rows = torch.cat([root.T, -root.T]) * ((2 * d - 1) / 2) ** 0.5
    return mean + rows


def spd(d, seed):
    a = torch.randn(d, d, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return a @ a.T + 0.1 * torch.eye(d, dtype=torch.float64)


@pytest.mark.parametrize("d", [1, 3, 8])
def test_distance_of_gaussians(d):
    """|Δμ|² + tr(Σ₁ + Σ₂ − 2 (Σ₁Σ₂)^½), with scipy's matrix root; rows made to have these moments exactly."""
    mu, nu = torch.zeros(d, dtype=torch.float64), torch.linspace(-1, 2, d, dtype=torch.float64)
    S, T = spd(d, 0), spd(d, 1)
    root = torch.from_numpy(scipy.linalg.sqrtm((S @ T).numpy()).real)
    expected = float((mu - nu).square().sum() + (S + T - 2 * root).trace())
    assert frechet(exact(mu, S), exact(nu, T)) == pytest.approx(expected, rel=1e-9)


def test_distance_of_commuting_gaussians():
    """Diagonal Σ: |Δμ|² + Σ (σ₁ − σ₂)²."""
    s, t = torch.tensor([1.0, 2.0, 0.5]).double(), torch.tensor([3.0, 0.1, 0.5]).double()
    mu = torch.zeros(3, dtype=torch.float64)
    found = frechet(exact(mu, torch.diag(s**2)), exact(mu + 1, torch.diag(t**2)))
    assert found == pytest.approx(3 + float((s - t).square().sum()), rel=1e-12)


def test_fewer_clips_than_features_are_exact_too():
    """Features in a plane of a large space: the distance is that of the plane, Σ of rank 2 of 400."""
    g = torch.Generator().manual_seed(0)
    a, b = (torch.randn(20, 2, generator=g, dtype=torch.float64) for _ in range(2))
    plane = torch.linalg.qr(torch.randn(400, 2, generator=g, dtype=torch.float64))[0].T
    assert frechet(a @ plane, b @ plane) == pytest.approx(frechet(a, b), rel=1e-10)


def test_a_set_is_at_no_distance_from_itself():
    """Traces of order D cancel to rounding, 400 · 10⁻¹⁶ · a few; also in float32 input and without full rank."""
    a = torch.randn(10, 400, generator=torch.Generator().manual_seed(0))
    assert frechet(a, a) == pytest.approx(0, abs=1e-10)


def test_kernel_distance_by_hand():
    """D = 1, sets {0, 1} and {0, 2}: k(x, y) = (xy + 1)³; k(0,1) = 1, k(0,2) = 1; mean of 1, 1, 1, 27 is 7.5."""
    a, b = torch.tensor([[0.0], [1.0]]), torch.tensor([[0.0], [2.0]])
    assert kernel(a, b) == pytest.approx(1 + 1 - 2 * 7.5, rel=1e-14)


def test_kernel_distance_has_no_bias_where_the_frechet_distance_has():
    """Two draws of 16 from one distribution, 200 times: the mean KVD is 0 within 4 standard errors; FVD is far off."""
    g = torch.Generator().manual_seed(0)
    draws = [torch.randn(2, 16, 8, generator=g) for _ in range(200)]
    kvd = torch.tensor([kernel(*d) for d in draws])
    assert abs(float(kvd.mean())) < 4 * float(kvd.std()) / len(draws) ** 0.5
    fvd = torch.tensor([frechet(*d) for d in draws])
    assert float(fvd.mean()) > 20 * float(fvd.std()) / len(draws) ** 0.5


def test_windows_are_all_stretches():
    clip = torch.arange(5.0)[:, None]
    assert windows(clip, 3)[..., 0].tolist() == [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
    assert windows(clip, 3, 2)[..., 0].tolist() == [[0, 1, 2], [2, 3, 4]]
    assert windows(torch.rand(6, 4, 5, 3), 4).shape == (3, 4, 4, 5, 3)
    with pytest.raises(ValueError, match="no stretch of 6"):
        windows(clip, 6)


def test_what_has_no_moments_is_refused():
    with pytest.raises(ValueError, match="at least two feature vectors"):
        frechet(torch.rand(1, 3), torch.rand(4, 3))
    with pytest.raises(ValueError, match="not finite"):
        kernel(torch.full((2, 3), torch.nan), torch.rand(4, 3))
