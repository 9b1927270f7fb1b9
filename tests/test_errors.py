"""The error of a film, estimated from coarse drafts of it."""

import dataclasses

import pytest
import torch

from diffuphy.errors import Estimate, envelope, project, rms, split
from diffuphy.material import presets
from diffuphy.mpm.trajectory import Simulate
from diffuphy.render import look_at
from diffuphy.render.film.clip import Film
from diffuphy.types import Camera, Errors, Motion, Trajectory
from diffuphy.workspace import Workspace
from tests.learning.test_fit_material import ball

_, PARTICLES = ball(14)
FALL = Motion("falling", "a ball falling", {"": "jelly"}, 0.4)
FIELD = presets.field(presets.lookup("jelly"), len(PARTICLES))


def filmed(seconds=0.4, motion=FALL):
    scene = Simulate(seconds=seconds, fps=30.0)
    return scene, scene(motion, PARTICLES, FIELD, work=Workspace())


SCENE, TRAJECTORY = filmed()


def estimate(trajectory=TRAJECTORY, work=None, **settings) -> Errors:
    component = Estimate(scene=SCENE, film=Film(width=64, height=64), **settings)
    return component(FALL, PARTICLES, FIELD, trajectory, work=work or Workspace())


@pytest.fixture(scope="module")
def whole() -> Errors:
    return estimate()


def test_free_fall_has_no_error(whole):
    """x = x₀ + g t²/2 for every grid (half kick): before contact the two differ by rounding, 10⁻⁶ of 0.4 m."""
    lowest = TRAJECTORY.x[..., 2].amin(1)
    free = int((lowest > 0.1).nonzero().max()) - round(0.1 * 30)  # a window before the first touch of the draft
    assert free >= 3
    assert float(whole.total[:free].max()) < 1e-5 * 0.4


def test_contact_has_one(whole):
    """After it the two touch the floor at other times: a part of Δx, which is 0.06 m, far from rounding."""
    assert float(whole.total[-1]) > 1e-3 * 0.4
    assert float(whole.pixels[-1]) > 0.0


def test_a_false_film_is_found_out(whole):
    """A film that is shifted by s after its first frame is wrong by s, and its centre of mass says so."""
    s = 0.05
    moved = TRAJECTORY.x.clone()
    moved[1:, :, 0] += s
    wrong = estimate(dataclasses.replace(TRAJECTORY, x=moved), time=False)
    assert float(wrong.com[1]) == pytest.approx(s, rel=1e-3)
    assert float(wrong.shape[1]) == pytest.approx(float(whole.shape[1]), abs=1e-5)


def test_parts_are_those_asked_for(whole):
    assert list(whole.parts) == ["grid", "time"]
    assert list(estimate(time=False).parts) == ["grid"]
    assert all(len(t) == len(TRAJECTORY.x) for t in (whole.com, whole.shape, whole.pixels, *whole.parts.values()))


def test_a_finished_draft_is_not_made_again(tmp_path, whole, monkeypatch):
    """Killed in the second draft, the stage goes on there, to the same bits."""
    import diffuphy.errors as module

    true, runs = module.simulate, []

    def dies(*args, **options):
        runs.append(args)
        if len(runs) == 2:
            raise KeyboardInterrupt
        return true(*args, **options)

    monkeypatch.setattr(module, "simulate", dies)
    with pytest.raises(KeyboardInterrupt):
        estimate(work=Workspace(tmp_path))
    again = estimate(work=Workspace(tmp_path))
    assert len(runs) == 3, "first draft, second that died, second again"
    for name in ("com", "shape", "pixels"):
        assert torch.equal(getattr(again, name), getattr(whole, name))


def test_no_draft_no_numbers_but_the_reason(caplog):
    """A body of 2½ cells of the draft is told, not filmed: every number is NaN, and the log warns."""
    _, few = ball(10)
    field = presets.field(presets.lookup("jelly"), len(few))
    trajectory = SCENE(FALL, few, field, work=Workspace())
    errors = Estimate(scene=SCENE, film=Film())(FALL, few, field, trajectory, work=Workspace())
    assert "must span at least 3 cells" in errors.why and bool(errors.com.isnan().all())
    assert "no error estimate" in caplog.text and "report.error=off" in caplog.text


def test_result_comes_back_as_it_was(tmp_path, whole):
    whole.save(tmp_path)
    back = Errors.load(tmp_path)
    assert torch.equal(back.com, whole.com) and torch.equal(back.parts["time"], whole.parts["time"])
    assert (back.size, back.fps, back.order, back.why) == (0.4, 30.0, 1.0, "")


def test_open_fields_are_refused():
    with pytest.raises(ValueError, match="left open"):
        Estimate()(FALL, PARTICLES, FIELD, TRAJECTORY, work=Workspace())


# ---------------------------------------------------------------------- what is measured
def test_centre_and_shape_share_the_whole():
    """rms² = |ē|² + shape² (variance decomposition)."""
    e = torch.randn(5, 40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    w = torch.softmax(torch.linspace(0, 1, 40, dtype=torch.float64), 0)
    com, shape = split(e, w)
    torch.testing.assert_close(torch.hypot(com, shape), rms(e, w), rtol=1e-13, atol=0)


def test_envelope_is_the_largest_within_reach():
    values = torch.tensor([0.0, 3.0, 1.0, 0.0, 0.0, 2.0])
    assert envelope(values, 1).tolist() == [3.0, 3.0, 3.0, 1.0, 2.0, 2.0]
    assert torch.equal(envelope(values, 0), values)


def test_projection_is_that_of_the_pinhole():
    """u = f X/Z + c: a point half a metre right of the axis, 2 m away, f = 100 px."""
    K = torch.tensor([[100.0, 0, 32], [0, 100.0, 32], [0, 0, 1]])
    camera = Camera(look_at((0.0, -2.0, 0.0), (0.0, 0.0, 0.0))[None], K[None], 64, 64)
    torch.testing.assert_close(project(torch.tensor([[[0.5, 0.0, 0.0]]]), camera), torch.tensor([[[57.0, 32.0]]]))


def test_motion_of_the_draft_is_that_of_the_film_at_the_start():
    """Spin and throw: coarse particles start at the means of the film and move as rigidly as it does, in flight for
    two frames; what is left is rounding and the stretch of a spinning body, ρ ω² R²/E ~ 1e-3 of 0.4 m."""
    motion = Motion("thrown", "a ball thrown", {"": "jelly"}, 0.4)
    scene = Simulate(seconds=0.07, fps=30.0)
    trajectory: Trajectory = scene(motion, PARTICLES, FIELD, work=Workspace())
    component = Estimate(scene=scene, film=Film(width=64, height=64), time=False)
    errors = component(motion, PARTICLES, FIELD, trajectory, work=Workspace())
    assert float(errors.com.max()) < 1e-5 * 0.4
    assert float(errors.shape.max()) < 2e-3 * 0.4


def test_pixels_are_those_of_the_film_whatever_is_sampled(whole):
    """Two samples a side of a pixel see twice as many; the error is told in pixels of the film."""
    film = Film(width=64, height=64, supersample=2)
    finer = Estimate(scene=SCENE, film=film)(FALL, PARTICLES, FIELD, TRAJECTORY, work=Workspace())
    torch.testing.assert_close(finer.pixels, whole.pixels, rtol=1e-4, atol=1e-5)  # rounding of a projection
