"""Regularisers of a material field and of Gaussians, in closed form."""

import math

import pytest
import torch

from diffuphy.losses.regularize import anisotropy, gate_entropy, log_prior, spread, total_variation


def chain(n):
    """Neighbours left and right on a ring."""
    i = torch.arange(n)
    return torch.stack([(i - 1) % n, (i + 1) % n], 1)


def test_total_variation_is_the_length_of_the_border():
    """A step of height h on a ring of n, however wide: two borders, each seen twice, over 2n pairs: L = 4 h / 2n."""
    for width in (3, 9):
        y = torch.zeros(20, dtype=torch.float64)
        y[:width] = 0.7
        torch.testing.assert_close(total_variation(y, chain(20)).item(), 4 * 0.7 / 40, rtol=1e-14, atol=0)
    assert total_variation(torch.full((20, 3), 5.0), chain(20)) == 0


def test_total_variation_adds_channels_and_names_a_wrong_shape():
    y = torch.rand(8, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    both = total_variation(y, chain(8))
    torch.testing.assert_close(both, total_variation(y[:, 0], chain(8)) + total_variation(y[:, 1], chain(8)))
    with pytest.raises(ValueError, match=r"\(8, K\)"):
        total_variation(y, chain(7))


def test_gate_entropy_of_uniform_and_one_hot_rows():
    """ln K and 0; half of each: their mean."""
    uniform, hard = torch.full((2, 4), 0.25, dtype=torch.float64), torch.eye(4, dtype=torch.float64)[:2]
    torch.testing.assert_close(gate_entropy(uniform).item(), math.log(4), rtol=1e-14, atol=0)
    assert gate_entropy(hard) == 0
    torch.testing.assert_close(gate_entropy(torch.cat([uniform, hard])).item(), math.log(4) / 2, rtol=1e-14, atol=0)


def test_gate_entropy_has_its_exact_gradient_and_a_finite_one_at_exact_zeros():
    """−(ln w + 1)/N inside; exact zeros get none."""
    w = torch.tensor([[0.2, 0.8, 0.0]], dtype=torch.float64, requires_grad=True)
    gate_entropy(w).backward()
    want = torch.tensor([[-math.log(0.2) - 1, -math.log(0.8) - 1, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(w.grad, want, rtol=1e-14, atol=0)


def test_log_prior_counts_decades():
    """½ (log10 ratio / s)², the same for ten times more and ten times less."""
    theta = torch.tensor([1e4, 1e6], dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(log_prior(theta, 1e5).item(), 0.5, rtol=1e-13, atol=0)
    torch.testing.assert_close(log_prior(theta, torch.tensor([1e5, 1e4]), decades=0.5).item(), 5.0, rtol=1e-6, atol=0)
    torch.testing.assert_close(log_prior(theta, theta.detach()).item(), 0.0)
    assert torch.autograd.gradcheck(lambda t: log_prior(t.exp(), 1e5), (theta.detach().log().requires_grad_(),))


def test_log_prior_refuses_what_has_no_logarithm():
    with pytest.raises(ValueError, match="positive"):
        log_prior(torch.tensor([0.0, 1.0]), 1.0)
    with pytest.raises(ValueError, match="positive"):
        log_prior(torch.tensor([1.0]), 1.0, decades=0.0)


def test_spread_is_the_mean_variance_inside_regions():
    """Regions {0, 2} and {5, 5}: variances 1 and 0."""
    values, labels = torch.tensor([0.0, 2.0, 5.0, 5.0]), torch.tensor([0, 0, 1, 1])
    assert float(spread(values, labels)) == pytest.approx(0.5)


def test_anisotropy_is_the_mean_excess_over_the_ratio():
    """Ratios 2, 6 and 10 over r = 4: (0 + 2 + 6)/3; a Gaussian below r gets no gradient, longer ones shrink along their
    longest axis and grow along their shortest by their ratio."""
    scales = torch.tensor([[1.0, 1.5, 2.0], [3.0, 6.0, 1.0], [1.0, 10.0, 5.0]], dtype=torch.float64)
    log_scales = scales.log().requires_grad_()
    loss = anisotropy(log_scales, 4.0)
    assert float(loss.detach()) == pytest.approx(8 / 3, rel=1e-12)
    loss.backward()
    expected = torch.tensor([[0.0, 0.0, 0.0], [0.0, 2.0, -2.0], [-10 / 3, 10 / 3, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(log_scales.grad, expected)
    with pytest.raises(ValueError, match="ratio must be at least 1"):
        anisotropy(log_scales, 0.5)
