"""The shape prior: which points it judges, how strongly, how long, and what it does to a fit."""

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parent))
from beach_ball import BeachBall

from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.schedules import cosine, variance_preserving
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.densify import AdaptiveSplitting
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.init import Ball, PointECloud
from diffuphy.text2gs.params import NAMES
from diffuphy.text2gs.shape_prior import ShapePrior, farthest_points, four_sides
from diffuphy.types import Look
from diffuphy.workspace import Workspace

LOOK = Look("ball", "a ball")


@dataclass(frozen=True)
class Shell:
    """A prior that is certain: every point belongs on a sphere. ε̂ = (z_t − α x₀)/σ, x₀ the nearest point of it."""

    layout: ClassVar[str] = "points"
    radius: float = 0.8

    def condition(self, words, camera, background, *, generator=None):
        assert len(camera) == 4
        return torch.randint(100, (1,), generator=generator)

    def encode(self, sample):
        return sample

    def schedule(self, t):
        return variance_preserving(t, cosine())

    def predict_noise(self, z_t, t, cond):
        alpha, sigma = (a.view(-1, 1, 1) for a in self.schedule(t))
        x = z_t[..., :3] / alpha
        clean = torch.cat([self.radius * x / x.norm(dim=-1, keepdim=True), z_t[..., 3:] / alpha], -1)
        return (z_t - alpha * clean) / sigma


@dataclass(frozen=True)
class Box:
    """A sampler of clouds: a box of sides 1, 2, 4 somewhere, red."""

    count: int = 50

    def sample(self, words, camera, generator, device="cpu"):
        x = torch.rand(self.count, 3, generator=generator) * torch.tensor([1.0, 2.0, 4.0]) + 5
        return x, torch.tensor([1.0, 0.0, 0.0]).expand(self.count, 3)


def fit(steps=20, **settings):
    defaults = {
        "guidance": Analytic(BeachBall(), s=0.05),
        "cameras": Orbits(bank=12, size=32),
        "init": Ball(count=200),
        "densify": AdaptiveSplitting(start=5, every=5, stop=15, max_count=400),
        "shape": ShapePrior(Shell(), points=64, stop=0.7),
    }
    return FitGaussians(**{**defaults, **settings}, steps=steps)


def same(a, b):
    return all(torch.equal(getattr(a, n), getattr(b, n)) for n in NAMES)


def gaussians(n=200):
    return Ball(count=n)(LOOK, None, torch.Generator().manual_seed(0))


# ---------------------------------------------------------------------- which points
def test_each_point_is_the_farthest_from_all_before_it():
    x = torch.randn(60, 3, generator=torch.Generator().manual_seed(0))
    index = farthest_points(x, 20, torch.tensor([3, 40]))
    for row, first in zip(index, (3, 40), strict=True):
        assert row[0] == first and len(row.unique()) == 20
        for i in range(1, 20):
            distance = torch.cdist(x, x[row[:i]]).amin(1)
            assert distance[row[i]] == pytest.approx(distance.max().item(), rel=1e-5)  # two float32 ways of a distance


def test_no_more_points_than_there_are():
    with pytest.raises(ValueError, match="5 points cannot be chosen from 4"):
        farthest_points(torch.zeros(4, 3), 5, torch.zeros(1, dtype=torch.int64))
    g = replace(gaussians(), means=gaussians().means.requires_grad_())
    ShapePrior(Shell(), points=1024).loss(g, LOOK, torch.Generator().manual_seed(0)).backward()
    assert (g.means.grad != 0).any(1).all()  # all of them


def test_four_sides_surround_the_object():
    """Front (+x), left (+y), back, right; level with it but for 15°; all look at the origin."""
    camera = four_sides()
    R, T = camera.viewmats[:, :3, :3], camera.viewmats[:, :3, 3]
    where = -torch.einsum("cji,cj->ci", R, T)
    azimuth = torch.atan2(where[:, 1], where[:, 0]).rad2deg() % 360
    torch.testing.assert_close(azimuth, torch.tensor([0.0, 90.0, 180.0, 270.0]), rtol=0, atol=1e-3)
    torch.testing.assert_close(where[:, 2] / where.norm(dim=1), torch.full((4,), math.sin(math.radians(15))))


# ---------------------------------------------------------------------- how strongly
@pytest.mark.parametrize("copies", [1, 4])
def test_gradient_is_that_of_equation_two(copies):
    """∂L/∂x_i = λ mean_copies w(t) (ε̂ − ε). A prior that knows every point to be at 0 answers ε̂ = z_t/σ: the noise
    cancels, and at a given t what is left is λ σ² α/σ x at the points that were chosen, nothing elsewhere."""
    count = 40 if copies == 1 else 200  # of 200: all copies hold all points, and their mean is that of each
    shape = ShapePrior(Shell(0.0), points=count, copies=copies, weight=0.3, t_min=0.4, t_max=0.4)
    g = replace(gaussians(), means=gaussians().means.requires_grad_())
    shape.loss(g, LOOK, torch.Generator().manual_seed(3)).backward()
    chosen = (g.means.grad != 0).any(1)
    assert chosen.sum() == count
    alpha, sigma = Shell().schedule(torch.tensor([0.4]))
    # float32: ε of order 1 is added and taken away again
    torch.testing.assert_close(g.means.grad[chosen], 0.3 * sigma * alpha * g.means.detach()[chosen], rtol=0, atol=1e-6)


@pytest.mark.parametrize("colours", [False, True])
def test_colours_follow_only_when_asked(colours):
    g = gaussians()
    g = replace(g, means=g.means.requires_grad_(), sh=(g.sh + 0.1).requires_grad_())
    shape = ShapePrior(Shell(), points=64, colours=colours)
    shape.loss(g, LOOK, torch.Generator().manual_seed(0)).backward()
    assert g.means.grad.abs().max() > 0 and (g.sh.grad is not None) == colours


@pytest.mark.parametrize(("stop", "acts"), [(3, [1, 1, 1, 0, 0]), (0.4, [1, 1, 0, 0, 0]), (1.0, [1] * 5)])
def test_it_acts_until_it_stops(stop, acts):
    shape = ShapePrior(Shell(), stop=stop)
    assert [shape.acts(k, 5) for k in range(5)] == acts


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"guidance": Analytic()}, "layout 'views'"),
        ({"weight": 0.0}, r"fit\.shape=null"),
        ({"points": 1}, "points"),
        ({"copies": 0}, "copies"),
        ({"t_min": 0.9, "t_max": 0.5}, "t_min"),
        ({"stop": 1.5}, "stop"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        ShapePrior(**{"guidance": Shell(), **wrong})


# ---------------------------------------------------------------------- in a fit
class Blind(Analytic):
    """Pictures that mean nothing: no gradient comes back from them."""

    def condition(self, words, camera, background, *, generator=None):
        return None

    def encode(self, sample):
        return 0 * sample

    def predict_noise(self, z_t, t, cond):
        return torch.zeros_like(z_t)


def test_a_fit_follows_the_shape():
    """Where pictures say nothing, a ball of points becomes the shell that the prior knows: what is left of the distance
    after 300 steps of 3e-3, falling to a thirtieth (0.26 in all), for points 0.15 away on average, is below half."""
    settings = {"guidance": Blind(), "densify": None, "min_opacity": 1e-3, "isolation": 100.0}
    shape = ShapePrior(Shell(), weight=1.0, points=200, stop=1.0, t_max=0.1)
    before, after = (fit(n, **settings, shape=shape)(LOOK).means.norm(dim=1) for n in (1, 300))
    assert (after - 0.8).abs().mean() < 0.5 * (before - 0.8).abs().mean()


def test_densification_looks_at_the_pictures_gradient_alone():
    """However strong the shape prior, the account of the first step is the same."""
    seen = []

    class Watching(AdaptiveSplitting):
        def __call__(self, params, g, generator):
            seen.append(g.clone())
            return {}

    for weight in (0.1, 100.0):
        fit(2, densify=Watching(start=1, every=2, stop=2), shape=ShapePrior(Shell(), weight=weight, points=64))(LOOK)
    assert torch.equal(*seen)


def test_it_is_ready_before_the_pictures_are_judged():
    """What it looks at is painted before the other prior's networks fill the memory, and no random number of the run
    is drawn for that."""
    asked = []

    class Seen(Shell):
        def condition(self, words, camera, background, *, generator=None):
            asked.append("shape")
            return super().condition(words, camera, background, generator=generator)

    class Judging(Analytic):
        def condition(self, words, camera, background, *, generator=None):
            asked.append("pictures")
            return super().condition(words, camera, background, generator=generator)

    made = fit(2, guidance=Judging(BeachBall(), s=0.05), shape=ShapePrior(Seen(), points=64, stop=1))(LOOK)
    assert asked == ["shape", "pictures", "shape", "pictures"]
    assert same(made, fit(2, shape=ShapePrior(Shell(), points=64, stop=1))(LOOK))


def test_without_it_nothing_changes():
    """shape=None draws no random number: the bits of a fit that never heard of it."""
    assert same(fit(8, shape=None)(LOOK), FitGaussians(
        Analytic(BeachBall(), s=0.05), cameras=Orbits(bank=12, size=32), init=Ball(count=200), steps=8,
        densify=AdaptiveSplitting(start=5, every=5, stop=15, max_count=400),
    )(LOOK))  # fmt: skip
    assert not same(fit(8)(LOOK), fit(8, shape=None)(LOOK))


def test_a_kill_and_a_second_run_give_the_same_bits(tmp_path):
    """Killed while the prior acts and after it has stopped: equal tensors, no tolerance."""
    whole, life = fit()(LOOK), [1000]

    class Killed(Exception):
        pass

    class Mortal(Analytic):
        def predict_noise(self, z_t, t, cond):
            life[0] -= 1
            if life[0] == 0:
                raise Killed
            return super().predict_noise(z_t, t, cond)

    mortal = replace(fit(), guidance=Mortal(BeachBall(), s=0.05))
    for steps in (8, 10):
        life[0] = steps
        with pytest.raises(Killed):
            mortal(LOOK, work=Workspace(tmp_path, interval=0.0))
    life[0] = 1000
    assert same(whole, mortal(LOOK, work=Workspace(tmp_path, interval=0.0)))
    assert '"shape"' in (tmp_path / "metrics.jsonl").read_text()


# ---------------------------------------------------------------------- the start
@pytest.mark.parametrize("coloured", [True, False])
def test_a_cloud_becomes_gaussians(coloured):
    """Centred, the longest side 2, in the cloud's colours or grey, opaque, round."""
    start = PointECloud(Box(), coloured=coloured)
    g = start(LOOK, None, torch.Generator().manual_seed(0))
    size = g.means.amax(0) - g.means.amin(0)
    assert len(g) == start.count == 50
    assert size.max() == pytest.approx(2) and (g.means.amax(0) + g.means.amin(0)).abs().max() < 1e-5
    assert size[0] < size[1] < size[2]
    rgb = 0.5 + 0.28209479177387814 * g.sh[:, 0]
    expected = torch.tensor([1.0, 0, 0] if coloured else [0.5, 0.5, 0.5])
    torch.testing.assert_close(rgb, expected.expand(50, 3), rtol=0, atol=1e-6)
    torch.testing.assert_close(torch.sigmoid(g.logit_opacities), torch.full((50,), 0.8))


def test_a_fit_starts_from_a_cloud():
    g = fit(2, init=PointECloud(Box(300)), densify=None, shape=None, min_opacity=0.01)(LOOK)
    assert len(g) > 250 and g.means.abs().amax(0)[2] > 1.5 * g.means.abs().amax(0)[1]
