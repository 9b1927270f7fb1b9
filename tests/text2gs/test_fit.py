"""Text to Gaussians, end to end on a ball whose pictures have a closed form."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parent))
from beach_ball import BeachBall

from diffuphy.artifact import describe
from diffuphy.losses import Linear
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.render import render_gaussians
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.densify import AdaptiveSplitting
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.init import Ball, SurfaceCloud
from diffuphy.text2gs.params import NAMES
from diffuphy.types import Look
from diffuphy.workspace import Workspace

LOOK = Look("ball", "a ball")


def fit(steps=40, **settings):
    defaults = {
        "guidance": Analytic(BeachBall(variants=2), s=0.05),
        "cameras": Orbits(bank=12, size=32),
        "init": SurfaceCloud(count=300),
        "densify": AdaptiveSplitting(start=10, every=10, stop=30, max_count=500),
    }
    return FitGaussians(**{**defaults, **settings}, steps=steps)


def same(a, b):
    return all(torch.equal(getattr(a, n), getattr(b, n)) for n in NAMES)


def score(gaussians, ball, orbits):
    """Mean PSNR over the cameras of ``orbits`` [dB] against the nearest variant."""
    camera, white = orbits(), torch.ones(3)
    picture = render_gaussians(gaussians, camera, background=white).rgb.clamp(0, 1)
    references, _ = ball(None, camera, white)
    errors = (picture[:, None] - references).square().flatten(2).mean(2)
    return (-10 * torch.log10(errors)).mean(0).max().item()


def test_a_ball_is_recovered_from_cameras_never_seen():
    """300 steps from a grey cloud reach 29 dB on held-out cameras; the cloud itself is below 20 dB.

    29 dB is what the issue of the project asks of its objects. The references themselves allow more: pixels on the
    rim, 8 % of the picture, average 3×3 rays and err by an rms of 0.03, which alone leaves 41 dB.
    """
    ball = BeachBall(radius=0.8)
    start = SurfaceCloud(count=1000, noise=0.02)
    component = fit(300, guidance=Analytic(ball), cameras=Orbits(bank=48, size=48), init=start, densify=None)
    held_out = Orbits(bank=12, size=48, seed=77)
    assert score(start(LOOK, component.guidance, torch.Generator().manual_seed(0)), ball, held_out) < 20
    assert score(component(LOOK), ball, held_out) > 29


def test_a_kill_and_a_second_run_give_the_same_bits(tmp_path):
    """Interrupted after every kind of step (before, between and after densification events) and resumed: equal
    tensors, no tolerance."""
    component = fit(40, guidance=Analytic(BeachBall(variants=2), s=0.05, mode="patch"))
    whole = component(LOOK)
    assert len(whole) > 310  # densification did happen

    class Killed(Exception):
        pass

    class Mortal(Analytic):
        """Dies at the prediction number ``life[0]``."""

        def predict_noise(self, z_t, t, cond):
            life[0] -= 1
            if life[0] == 0:
                raise Killed
            return super().predict_noise(z_t, t, cond)

    mortal = replace(component, guidance=Mortal(BeachBall(variants=2), s=0.05, mode="patch"))
    for first, second in ((5, 11), (25, 12)):
        folder = tmp_path / f"{first}"
        for steps in (first, second):
            life = [steps]
            with pytest.raises(Killed):
                mortal(LOOK, work=Workspace(folder, interval=0.0))
        life = [1000]
        resumed = mortal(LOOK, work=Workspace(folder, interval=0.0))
        assert 1000 - life[0] == 40 - (first - 1) - (second - 1)  # every step was done once
        assert same(whole, resumed)


def test_the_seed_decides_everything_and_settings_of_display_nothing(tmp_path):
    whole = fit(12)(LOOK)
    assert same(whole, fit(12, preview_every=5)(LOOK, work=Workspace(tmp_path)))
    assert not same(whole, fit(12, seed=1)(LOOK))
    a, b = describe(fit()), describe(fit(preview_every=7))
    assert a == b and describe(fit(seed=1)) != a


def test_global_random_state_is_not_touched():
    state = torch.random.get_rng_state()
    fit(3)(LOOK)
    assert torch.equal(state, torch.random.get_rng_state())


def test_first_preview_comes_before_the_first_step(tmp_path):
    """A picture of the start is on disk when the guidance is asked for the first time; metrics follow."""
    seen = []

    class Watching(Analytic):
        def predict_noise(self, z_t, t, cond):
            seen.append(sorted(p.name for p in (tmp_path / "previews").glob("*.png")))
            return super().predict_noise(z_t, t, cond)

    fit(6, guidance=Watching(BeachBall()), preview_every=3)(LOOK, work=Workspace(tmp_path))
    assert seen[0] == ["gaussians-00000.png"]
    assert [p.name for p in sorted((tmp_path / "previews").glob("*.png"))] == [
        f"gaussians-{k:05d}.png" for k in (0, 3, 6)
    ]
    assert '"sds"' in (tmp_path / "metrics.jsonl").read_text()


def test_gaussians_are_matter():
    """What is handed on is opaque, bounded in size and shape, inside the ball, finite and without a graph."""
    component = fit(80, guidance=Analytic(BeachBall()))
    g = component(LOOK)
    s = g.log_scales.exp()
    assert s.max() <= component.max_scale * (1 + 1e-5)
    assert (s.amax(1) / s.amin(1)).max() <= component.max_ratio * (1 + 1e-5)
    assert torch.sigmoid(g.logit_opacities).min() >= component.min_opacity
    assert all(getattr(g, n).isfinite().all() and not getattr(g, n).requires_grad for n in NAMES)


@pytest.mark.parametrize("degree", [1, 3])
def test_higher_harmonics_are_trained(degree):
    g = fit(5, sh_degree=degree)(LOOK)
    assert g.sh.shape[1:] == ((degree + 1) ** 2, 3) and g.sh[:, 1:].abs().max() > 0


def test_priors_without_geometry_start_from_a_ball():
    """No ``object`` in the references (or no references): Gaussians fill a ball; their count and radius are the
    settings'."""
    start = SurfaceCloud(count=500)(LOOK, Analytic(lambda *_: None), torch.Generator().manual_seed(0))
    assert len(start) == 500 and start.means.norm(dim=1).max() <= Ball.radius
    # mean radius of a uniform ball is ¾ R with deviation √(3/80) R; 5 standard errors of 500
    assert abs(start.means.norm(dim=1).mean() / Ball.radius - 0.75) < 5 * math.sqrt(3 / 80 / 500)


def test_views_judged_together_share_a_diffusion_time():
    times = []

    class Watching(Analytic):
        def predict_noise(self, z_t, t, cond):
            times.append(t)
            return super().predict_noise(z_t, t, cond)

    fit(4, guidance=Watching(BeachBall()), views=3)(LOOK)
    assert all(len(t.unique()) == 1 for t in times) and len(torch.cat(times).unique()) == 4
    times.clear()
    fit(4, guidance=Watching(BeachBall(), layout="image"), views=3, t_max=Linear(0.5, 0.3, 2))(LOOK)
    assert all(len(t.unique()) == 3 for t in times)
    assert torch.cat(times[2:]).max() <= 0.3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"guidance": Analytic(layout="clip")}, "clip"),
        ({"sh_degree": 4}, "0, 1, 2 or 3"),
        ({"views": 13}, r"\[1, 12\]"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        fit(**wrong)
