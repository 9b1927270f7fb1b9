"""SSIM and PSNR against closed forms."""

import math

import pytest
import torch

from diffuphy.metrics.structure import C1, C2, psnr, ssim, ssim_map, ssim_object


def frames(n=2, side=32, seed=0):
    return torch.rand(n, side, side, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_a_picture_is_like_itself():
    """Numerator and denominator are the same sums; σ² is a difference of moments near 1/3, so 10⁻¹⁵/C₂ at most."""
    a = frames()
    assert torch.allclose(ssim(a, a), torch.ones(2, dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("p", "q"), [(0.2, 0.7), (0.0, 1.0), (0.5, 0.5)])
def test_flat_pictures_have_the_luminance_term_alone(p, q):
    """σ = 0 inside: SSIM = (2pq + C₁)/(p² + q² + C₁), Wang et al. 2004 eq. 6; the border sees zeros beyond."""
    a, b = (torch.full((1, 32, 32, 3), v, dtype=torch.float64) for v in (p, q))
    inside = ssim_map(a, b)[0, 5:-5, 5:-5]
    assert torch.allclose(inside, torch.full_like(inside, (2 * p * q + C1) / (p * p + q * q + C1)), rtol=0, atol=1e-10)


def test_scaled_contrast_has_the_closed_form():
    """b = μ + k (a − μ) with the window's own μ, σ: SSIM = (2μ² + C₁)/(2μ² + C₁) · (2kσ² + C₂)/((1 + k²)σ² + C₂).

    The window's moments are taken by a direct sum over 11 × 11 weights at one pixel.
    """
    a, k = frames(1)[..., :1].expand(-1, -1, -1, 3).contiguous(), 0.5
    at = torch.arange(11, dtype=torch.float64) - 5
    g = torch.exp(-(at**2) / 4.5)
    w = (g[:, None] * g) / g.sum() ** 2
    patch = a[0, 11:22, 11:22, 0]
    mu = float((w * patch).sum())
    var = float((w * (patch - mu) ** 2).sum())
    b = mu + k * (a - mu)
    expected = (2 * k * var + C2) / ((1 + k * k) * var + C2)
    assert float(ssim_map(a, b)[0, 16, 16]) == pytest.approx(expected, abs=1e-12)


def test_ssim_agrees_with_scikit_image():
    metrics = pytest.importorskip("skimage.metrics")
    a, b = frames(1), frames(1, seed=1)
    _, full = metrics.structural_similarity(
        a[0].numpy(), b[0].numpy(), data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    assert torch.allclose(ssim_map(a, b)[0, 5:-5, 5:-5], torch.from_numpy(full).mean(-1)[5:-5, 5:-5], atol=1e-10)


def test_background_hides_the_object_from_plain_ssim():
    """Two unrelated textures on 5 % of a white frame: alike as a whole, unlike where they are."""
    a, b = torch.ones(1, 64, 64, 3, dtype=torch.float64), torch.ones(1, 64, 64, 3, dtype=torch.float64)
    a[:, 20:34, 20:34], b[:, 20:34, 20:34] = frames(1, 14, 2), frames(1, 14, 3)
    cover = torch.zeros(1, 64, 64)
    cover[:, 20:34, 20:34] = 1
    assert float(ssim(a, b)) > 0.8 and float(ssim_object(a, b, cover, 0 * cover)) < 0.3


def test_object_ssim_of_no_object_is_not_a_number():
    a = frames(1)
    assert math.isnan(float(ssim_object(a, a, torch.zeros(1, 32, 32), torch.zeros(1, 32, 32))))


def test_psnr_of_an_offset():
    """Every value off by 0.1: −20 log₁₀ 0.1 = 20 dB."""
    a = 0.9 * frames()
    assert torch.allclose(psnr(a, a + 0.1), torch.full((2,), 20.0, dtype=torch.float64), atol=1e-9)
    assert math.isinf(float(psnr(a, a)[0]))


def test_clips_of_other_sizes_are_refused():
    with pytest.raises(ValueError, match="SSIM compares"):
        ssim_map(frames(2), frames(3))
    with pytest.raises(ValueError, match="PSNR compares"):
        psnr(frames(2), frames(3))
