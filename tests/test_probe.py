"""The drop test: one body, whichever of its particles the coarse copy keeps."""

import dataclasses
import importlib.util
from pathlib import Path

import pytest
import torch

from diffuphy.probe import Probe, TableClips, table_field
from diffuphy.types import Look, Motion

spec = importlib.util.spec_from_file_location("ball_of_stage", Path(__file__).parent / "test_fit_material.py")
assert spec is not None and spec.loader is not None
stage_tests = importlib.util.module_from_spec(spec)
spec.loader.exec_module(stage_tests)
BALL = stage_tests.ball()
PROBE = Probe(particles=200, frames=4, image=32)


def test_every_draw_of_particles_hangs_at_the_same_height():
    """Shift of the rest positions = gap − lowest of *all* particles, not of the few that were kept."""
    gaussians, particles = BALL
    shifts = []
    for seed in range(4):
        bench = dataclasses.replace(PROBE, seed=seed).bench(gaussians, particles, 0.4)
        shifts.append(bench.scene.lift - float(bench.draft.x[:, 2].min()))
    assert shifts == pytest.approx([PROBE.gap * 0.4 - float(particles.x[:, 2].min())] * 4, abs=1e-6)


def test_first_frames_of_two_draws_differ_by_less_than_the_motion():
    """In free fall the clip of another draw is the same clip up to the grain of the skin."""
    gaussians, particles = BALL
    field = Motion("falling", "x", {"": "rubber"}, 0.4)
    clips = []
    for seed in (0, 1):
        bench = dataclasses.replace(PROBE, seed=seed).bench(gaussians, particles, 0.4)
        with torch.no_grad():
            clips.append(bench.clip(table_field(None, Look("ball", "a ball"), field, bench.draft), 1)[0])
    still = PROBE.bench(gaussians, particles, 0.4)
    with torch.no_grad():
        x = still.simulate(table_field(None, Look("ball", "a ball"), field, still.draft), 1).x
        moved = still.film(
            dataclasses.replace(
                still.simulate(table_field(None, Look("ball", "a ball"), field, still.draft), 1), x=x.flip(0)
            )
        )[0]
    assert float((clips[0] - clips[1]).square().mean()) < 0.1 * float((clips[0] - moved).square().mean())


def test_the_camera_sees_the_object_and_the_floor():
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    corners = torch.tensor([[x, y, z, 1.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2) for z in (0.0, 0.45)])
    camera = corners @ bench.camera.viewmats[0].T
    pixels = (camera[:, :3] @ bench.camera.Ks[0].T)[:, :2] / camera[:, 2:3]
    assert bool((camera[:, 2] > 0).all()) and bool(((pixels > 0) & (pixels < PROBE.image)).all())


def test_reference_clips_have_one_row_a_frame_and_a_flat_prior():
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    motion = Motion("falling", "x", {"": "jelly"}, 0.4)
    clips = TableClips(bench, table_field(None, Look("ball", "a ball"), motion, bench.draft))
    images, logits = clips(motion, bench.camera[[0] * 3], bench.background)
    assert images.shape == (1, 1, 3, 32, 32, 3) and logits.tolist() == [0.0]


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="frames ≥ 2"):
        Probe(frames=1)
