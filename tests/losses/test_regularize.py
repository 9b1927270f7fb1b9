"""Regularisers of a material field and of Gaussians, in closed form."""

import pytest
import torch

from diffuphy.losses.regularize import anisotropy, spread


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
