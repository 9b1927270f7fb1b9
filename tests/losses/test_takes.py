"""Which frames, camera and background a step of video score distillation looks at."""

import itertools

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffuphy.losses.takes import Take, Takes, low_pass

FRAMES = ("all", "consecutive", "strided", "window")


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@given(
    frames=st.sampled_from(FRAMES),
    count=st.integers(1, 20),
    stride=st.integers(1, 20),
    total=st.integers(1, 40),
    step=st.integers(0, 200),
)
def test_every_take_shows_frames_of_the_motion_in_order(frames, count, stride, total, step):
    """1 ≤ f_1 < f_2 < … ≤ total, at most as many as asked for and as announced."""
    takes = Takes(frames, count=count, stride=stride)
    shown = takes(step, total, generator(step)).frames
    assert 1 <= len(shown) <= takes.shown(total) <= (total if frames == "all" else min(count, total))
    assert shown[0] >= 1 and shown[-1] <= total
    steps = {b - a for a, b in itertools.pairwise(shown)}
    assert steps <= {stride if frames == "strided" else 1}


@given(total=st.integers(1, 40), count=st.integers(1, 20))
def test_blocks_in_turn_show_every_frame_with_the_fewest_steps(total, count):
    """⌈total/count⌉ blocks, all equally long."""
    takes, steps = Takes("consecutive", count=count), -(-total // min(count, total))
    blocks = [takes(k, total, generator()).frames for k in range(steps)]
    assert {f for block in blocks for f in block} == set(range(1, total + 1))
    assert {len(block) for block in blocks} == {min(count, total)}
    assert takes(steps, total, generator()).frames == blocks[0]


def test_strided_takes_of_dream_physics():
    """16 frames of every 9th, starting one frame later each iteration, round after 9."""
    takes = Takes("strided", count=16, stride=9)
    assert takes(0, 150, generator()).frames == tuple(range(1, 145, 9))[:16]
    assert takes(4, 150, generator()).frames == tuple(range(5, 150, 9))[:16]
    assert takes(9, 150, generator()).frames == takes(0, 150, generator()).frames


def test_windows_start_anywhere_equally_often():
    """Starts 1 … 5 of a window of 4 in 8 frames, 5000 draws: each 1000 ± 5 σ, σ² = 5000 · 0.2 · 0.8."""
    takes, g = Takes("window", count=4), generator()
    starts = torch.tensor([takes(k, 8, g).frames[0] for k in range(5000)])
    counts = torch.bincount(starts, minlength=6)
    assert counts[0] == 0 and len(counts) == 6
    assert bool(((counts[1:] - 1000).abs() < 5 * (5000 * 0.2 * 0.8) ** 0.5).all())


def test_cameras_stand_evenly_round_and_each_is_drawn():
    takes, g = Takes(views=6), generator()
    assert {takes(k, 3, g).azimuth for k in range(200)} == {0.0, 60.0, 120.0, 180.0, 240.0, 300.0}


def test_backgrounds():
    g = generator()
    assert Takes()(0, 3, g).background is None
    assert Takes(background="white")(0, 3, g).background == (1.0, 1.0, 1.0)
    a, b = (Takes(background="random")(0, 3, g).background for _ in range(2))
    assert a is not None and a != b and all(0 <= c < 1 for c in a)


def test_defaults_show_the_whole_clip_as_it_is_and_draw_nothing():
    """What is drawn for time and noise does not depend on there being takes."""
    g = generator(7)
    before = g.get_state()
    assert Takes()(3, 12, g) == Take.whole(12) == Take(tuple(range(1, 13)))
    assert torch.equal(before, g.get_state())


@pytest.mark.parametrize("frames", FRAMES)
def test_same_generator_same_takes(frames):
    takes = Takes(frames, count=3, views=5, background="random")
    a, b = ([takes(k, 9, g) for k in range(10)] for g in (generator(3), generator(3)))
    assert a == b and len({t.azimuth for t in a}) > 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frames": "some"}, "all, consecutive, strided or window"),
        ({"background": "black"}, "own, white or random"),
        ({"count": 0}, "at least 1, got 0, 2 and 1"),
        ({"stride": 0}, "at least 1"),
        ({"views": 0}, "at least 1"),
    ],
)
def test_impossible_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Takes(**settings)


def blob(row, sigma=1.0, size=48):
    """A red Gaussian on blue."""
    q = torch.arange(size, dtype=torch.float64) + 0.5
    a = torch.exp(-((q[:, None] - row) ** 2 + (q[None] - 24) ** 2) / (2 * sigma**2))[..., None]
    red, blue = torch.tensor([0.9, 0.2, 0.1], dtype=torch.float64), torch.tensor([0.2, 0.3, 0.8], dtype=torch.float64)
    return blue + a * (red - blue), blue


def test_a_low_pass_widens_a_gaussian_by_its_variance_and_leaves_the_background():
    """g_σ ∗ g_s = g_√(σ² + s²), of the same sum; s = 1.5 and σ = 3 px are sampled finely: sums err by 1e-4."""
    picture, b = blob(24.0, 1.5)
    seen = low_pass(picture, b, 3.0)
    a, sharp = ((p - b)[..., 0] for p in (seen, picture))
    q = torch.arange(48, dtype=torch.float64) + 0.5 - 24
    torch.testing.assert_close(a.sum(), sharp.sum(), rtol=1e-4, atol=0)
    # cut at c = 3 σ + ½ px = 3.167 σ a Gaussian keeps 1 − 2 c φ(c) / (2 Φ(c) − 1) = 0.983 of its variance
    assert float((a.sum(1) * q**2).sum() / a.sum()) == pytest.approx(1.5**2 + 0.983 * 9, rel=2e-3)
    assert torch.allclose(seen[0, 0], b, rtol=0, atol=1e-12)


def test_blurred_pictures_of_bodies_far_apart_pull_together_and_sharp_ones_do_not():
    """½ |g_a − g_b|² of two Gaussians d apart has the slope ∝ d exp(−d²/4s²): e^−36 at d = 12 s, and a third of its
    greatest with a low-pass of half the distance."""
    goal, b = blob(12.0)

    def slope(row, blur):
        at = torch.tensor(row, dtype=torch.float64, requires_grad=True)
        mine, theirs = (low_pass(p, b, blur) if blur else p for p in (blob(at)[0], goal))
        return float(torch.autograd.grad(0.5 * (mine - theirs).square().sum(), at)[0])

    assert abs(slope(24.0, 0.0)) < 1e-9 * slope(13.4, 0.0)
    assert slope(24.0, 6.0) > 0.3 * slope(12.0 + 2**0.5 * (6**2 + 1) ** 0.5, 6.0)
