"""Gaussians that follow particles."""

import math

import pytest
import torch

from diffuphy.render import Skin
from diffuphy.types import Gaussians, Particles


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def body(count: int = 40, extra: int = 10) -> tuple[Gaussians, Particles]:
    """Gaussians of which every second is carried by a particle, in shuffled order, and interior particles."""
    means = normal(count, 3)
    g = Gaussians(means, normal(count, 4), normal(count, 3), normal(count), normal(count, 1, 3))
    scale, offset = 0.25, (0.1, -0.2, 0.3)
    carried = torch.randperm(count, generator=torch.Generator().manual_seed(1))[: count // 2]
    x = scale * torch.cat([means[carried], normal(extra, 3, seed=2)]) + torch.tensor(offset, dtype=torch.float64)
    index = torch.cat([carried, torch.full((extra,), -1)])
    return g, Particles(x, torch.full((len(x),), 1e-4, dtype=torch.float64), index, scale, offset, 0.05)


@pytest.mark.parametrize("k", [1, 3, 8])
def test_an_affine_motion_is_followed_exactly(k: int) -> None:
    """x = A X + b moves every Gaussian to A X_g + b with F_g = A, whatever particles it follows: the weights sum to
    1."""
    g, particles = body()
    A, b = normal(3, 3, seed=3), normal(3, seed=4)
    means, F = Skin.bind(g, particles, k)(particles.x @ A.T + b, A.expand(len(particles), 3, 3))
    rest = 0.25 * g.means + torch.tensor(particles.offset, dtype=torch.float64)
    torch.testing.assert_close(means, rest @ A.T + b, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(F, A.expand(40, 3, 3), rtol=1e-12, atol=1e-12)


def test_a_carried_gaussian_follows_its_carrier() -> None:
    """With k = 1 a carried Gaussian sits on its particle, even where another particle is as near; others take the
    nearest."""
    g, particles = body()
    twin = Particles(
        torch.cat([particles.x, particles.x]),  # a second particle at every place, which carries nothing
        torch.cat([particles.vol, particles.vol]),
        torch.cat([torch.full_like(particles.gaussian, -1), particles.gaussian]),
        particles.scale,
        particles.offset,
        particles.spacing,
    )
    skin = Skin.bind(g, twin)
    carriers = (twin.gaussian >= 0).nonzero()[:, 0]
    assert torch.equal(skin.index[twin.gaussian[carriers], 0], carriers)
    free = torch.ones(len(g), dtype=torch.bool)
    free[twin.gaussian[carriers]] = False
    distance = torch.cdist(skin.gaussians.means[free], twin.x)
    chosen = distance.gather(1, skin.index[free])
    assert torch.equal(chosen[:, 0], distance.amin(1)) and free.sum() == 20


def test_gaussians_are_resized_to_metres() -> None:
    """x = scale · means + offset, log-scales shifted by ln(scale); the rest pose is reproduced at F = 1."""
    g, particles = body()
    skin = Skin.bind(g, particles, 4)
    torch.testing.assert_close(skin.gaussians.log_scales, g.log_scales + math.log(0.25))
    means, _ = skin(particles.x, torch.eye(3, dtype=torch.float64).expand(len(particles), 3, 3))
    torch.testing.assert_close(means, skin.gaussians.means, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("k", [1, 3])
def test_gradients_reach_the_particles(k: int) -> None:
    g, particles = body(6, 4)
    skin = Skin.bind(g, particles, k)
    x = particles.x.clone().requires_grad_()
    F = normal(len(particles), 3, 3, seed=5).requires_grad_()
    assert torch.autograd.gradcheck(skin, (x, F))


def test_shares_fall_off_with_distance_and_sum_to_one() -> None:
    g, particles = body()
    skin = Skin.bind(g, particles, 5)
    torch.testing.assert_close(skin.weight.sum(1), torch.ones(40, dtype=torch.float64))
    assert (skin.weight.diff(dim=1) <= 1e-15).all()


def test_errors_say_what_to_change() -> None:
    g, particles = body()
    with pytest.raises(ValueError, match="k must be between 1 and the number of particles, 30, got 31"):
        Skin.bind(g, particles, 31)
    few = Gaussians(g.means[:3], g.quats[:3], g.log_scales[:3], g.logit_opacities[:3], g.sh[:3])
    with pytest.raises(ValueError, match="there are only 3"):
        Skin.bind(few, particles)
