"""The drop test: one body, whichever of its particles the coarse copy keeps."""

import dataclasses
import math

import pytest
import torch

from diffuphy.learning.case import Conditions
from diffuphy.learning.probe import Probe, TableClips, table_field
from diffuphy.losses import sds
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Take
from diffuphy.mpm import Scheme
from diffuphy.types import Look, Motion
from tests.learning.test_fit_material import ball

BALL = ball()
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
            table = table_field(None, Look("ball", "a ball"), field, bench.draft)
            clips.append(bench.film(bench.simulate(table, 1))[0])
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


def test_a_wide_view_keeps_a_heap_that_runs_out_of_a_narrow_one():
    """A cone at the angle of repose of 20° with the volume of a ball of diameter 1: r³ tan φ = ½, radius 1.11."""
    gaussians, particles = BALL
    radius = 0.4 * (0.5 / math.tan(math.radians(20))) ** (1 / 3)
    rim = torch.tensor([[s * radius, 0.0, 0.0, 1.0] for s in (1, -1)])

    def inside(view):
        camera = dataclasses.replace(PROBE, view=view).bench(gaussians, particles, 0.4).camera
        seen = (rim @ camera.viewmats[0].T)[:, :3] @ camera.Ks[0].T
        return (((seen[:, :2] / seen[:, 2:]) - 16).abs() < 16).all(1).tolist()

    assert inside(60.0) == [True, True] and not any(inside(40.0))


def test_the_drop_is_simulated_with_the_scheme_of_the_probe():
    plain = Scheme(sharpen=False, retain=0.0)
    assert dataclasses.replace(PROBE, scheme=plain).bench(*BALL, 0.4).scene.scheme is plain


def test_reference_clips_have_one_row_a_frame_and_a_flat_prior():
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    motion = Motion("falling", "x", {"": "jelly"}, 0.4)
    clips = TableClips(bench, table_field(None, Look("ball", "a ball"), motion, bench.draft))
    images, logits = clips(motion, bench.camera[[0] * 3], torch.ones(3))
    assert images.shape == (1, 1, 3, 32, 32, 3) and logits.tolist() == [0.0]


def test_reference_clips_show_what_the_take_shows():
    """Same frames, same camera, same background: at the table's own material clip and reference are the same bits."""
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    motion = Motion("falling", "x", {"": "jelly"}, 0.4)
    table = table_field(None, Look("ball", "a ball"), motion, bench.draft)
    cond = Conditions(Analytic(references=TableClips(bench, table), layout="clip", s=0.0), motion, bench)
    with torch.no_grad():
        drop = bench.simulate(table)
        for take in (Take.whole(2), Take((2, 4), azimuth=90.0, background=(0.2, 0.9, 0.1))):
            assert torch.equal(cond.prepare(take).images[0, 0], bench.film(drop, take))


def test_a_take_shows_its_frames_on_its_background():
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    motion = Motion("falling", "x", {"": "jelly"}, 0.4)
    with torch.no_grad():
        drop = bench.simulate(table_field(None, Look("ball", "a ball"), motion, bench.draft))
        clip, some = bench.film(drop), bench.film(drop, Take((1, 3)))
        white = bench.film(drop, Take((1, 3), background=(1.0, 1.0, 1.0)))
    assert torch.equal(some, clip[[0, 2]])
    assert torch.equal(some[:, 0, 0], torch.tensor([PROBE.background] * 2)) and bool((white[:, 0, 0] == 1).all())


def test_a_turned_camera_sees_the_world_turned_back():
    """Camera about +z by φ, world still = camera still, world by −φ: x' = R x, F' = R F. Colours do not depend on the
    side; rounding of a rotation moves an edge by 1e-5 px, so pixels agree to 1e-4."""
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    x, F = (
        bench.draft.x * torch.tensor([1.0, 0.6, 0.8]),
        torch.diag(torch.tensor([1.0, 0.6, 0.8])).expand(len(bench.draft), 3, 3),
    )
    c, s = math.cos(math.radians(50)), math.sin(math.radians(50))
    back = torch.tensor([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    turned = bench.drawing(Take((1,), azimuth=50.0))(x, F)
    assert float((turned - bench.drawing(Take((1,)))(x @ back.mT, back @ F)).abs().max()) < 1e-4
    assert float((turned - bench.drawing(Take((1,)))(x, F)).abs().max()) > 0.1


def test_gradient_of_a_film_drawn_frame_by_frame_is_that_of_one_graph_to_the_bit():
    """∂/∂(x, F) of all frames, through skin and rasteriser, from a camera drawn at random."""
    gaussians, particles = BALL
    bench = PROBE.bench(gaussians, particles, 0.4)
    motion = Motion("falling", "x", {"": "jelly"}, 0.4)
    table = table_field(None, Look("ball", "a ball"), motion, bench.draft)
    cond = Conditions(Analytic(references=TableClips(bench, table), layout="clip", s=0.0), motion, bench)
    take = Take((1, 2, 4), azimuth=120.0)
    with torch.no_grad():
        drop = bench.simulate(dataclasses.replace(table, theta=table.theta | {"E": 3 * table.theta["E"]}))
    leaves = [t.clone().requires_grad_() for t in (drop.x, drop.F)]
    moved = dataclasses.replace(drop, x=leaves[0], F=leaves[1])
    noise = torch.randn(1, 3, 32, 32, 3, generator=torch.Generator().manual_seed(0))
    ours = torch.autograd.grad(cond.distil(moved, take, t=0.5, noise=noise, weight="x0"), leaves)
    film = bench.film(moved, take)
    value = sds(cond.guidance, film[None], cond.prepare(take), t=torch.tensor([0.5]), noise=noise, weight="x0")
    for a, b in zip(ours, torch.autograd.grad(value / film.numel(), leaves), strict=True):
        assert torch.equal(a, b) and [bool(f.any()) for f in a] == [False, True, True, False, True]


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="frames ≥ 2"):
        Probe(frames=1)
    with pytest.raises(ValueError, match="angle in"):
        Probe(view=180.0)
