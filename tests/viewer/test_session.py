"""What a page can do with a run, without a page."""

import time

import pytest
import torch

from diffuphy.geometry import covariances
from diffuphy.render.scenes.ply import read
from diffuphy.viewer.change import Change
from diffuphy.viewer.session import Session
from diffuphy.viewer.shot import VIEWS, still
from tests.viewer.runs import FRAMES, run


def wait(session: Session) -> str:
    end = time.monotonic() + 60
    while session.job.running:
        assert time.monotonic() < end
        time.sleep(0.01)
    return session.job.message


@pytest.fixture
def session(tmp_path):
    made = Session(run(tmp_path))
    yield made
    made.close()


def test_a_frame_shows_the_gaussians_where_the_particles_are(session):
    """x_g = x_p(t) for a Gaussian on its particle; Σ = R S² Rᵀ while F = I."""
    session.player.playing = False
    session.player.seek(3)
    s, g = session.splats(), session.film.figure.skin.gaussians
    torch.testing.assert_close(torch.from_numpy(s.centers), session.film.trajectory.x[3], rtol=0, atol=1e-6)
    torch.testing.assert_close(torch.from_numpy(s.covariances), covariances(g.quats, g.log_scales.exp()))


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_has_colours_and_all_but_its_own_a_legend(session, view):
    assert session.paint(view) == ""
    rgb, card = session.splats().rgbs, session.legend(320)
    assert rgb.shape == (len(session.run.gaussians), 3) and rgb.min() >= 0 and rgb.max() <= 1
    assert (card is None) == (view == "colour")


def test_a_view_that_cannot_be_painted_is_refused_in_a_line_and_the_old_one_stays(tmp_path):
    """Stress of what flows needs the elastic part of the motion, which this film has not kept."""
    session = Session(run(tmp_path, "sand"))
    assert "simulate again" in session.paint("stress") and session.view == "colour"


def test_the_picture_has_a_name_that_changes_with_it(session):
    session.player.playing = False
    still = session.tick(1.0)
    assert session.tick(1.0) == still
    session.paint("J")
    assert session.tick(1.0) != still
    session.player.playing = True
    assert session.tick(2 / 30)[2] == 2


def test_simulating_again_plays_the_new_motion(session):
    """A thrown ball without gravity: x = x₀ + V t, exactly, until it meets something."""
    assert session.simulate(Change(gravity=0.0, velocity=(0.3, 0.0, 0.0), height=1.0, particles=None))
    assert "of motion in" in wait(session)
    x = session.shot.trajectory.x
    assert session.shot is not session.film and len(x) == FRAMES + 1
    # float32 positions of 1 m, some twenty substeps a frame
    torch.testing.assert_close(
        x[-1, :, 0] - x[0, :, 0], torch.full((x.shape[1],), 0.3 * FRAMES / 30), rtol=0, atol=1e-4
    )
    assert session.title == "from 1 m, at (0.3, 0, 0) m/s, gravity 0 m/s²"
    session.show(session.film)
    assert session.title == "as in the film"


def test_a_scene_that_is_impossible_is_a_line_and_the_film_stays(session):
    session.simulate(Change(stiffness=1e30, particles=None))
    said = wait(session)
    assert said.startswith("simulation failed: ") and "substeps" in said and "\n" not in said
    assert session.shot is session.film


def test_a_live_simulation_goes_on_and_answers_the_hand(session):
    """Held high up, the ball rises; let go of, it falls: the sign of v_z."""
    session.hold(Change(particles=100, gravity=1.0))
    live = session.live

    def until(test, what):
        end = time.monotonic() + 60
        while not (live.latest is not None and test(live.latest)):
            assert time.monotonic() < end and not live.message, f"{what}: {live.message}"
            time.sleep(0.01)
        return live.latest

    start = until(lambda s: s.time > 0, "it runs")
    eye = tuple((start.x.mean(0) - start.x.new_tensor([0.0, 3.0, 0.0])).tolist())
    at = session.touch(eye, (0.0, 1.0, 0.0))
    assert at is not None
    live.hand.grab(at)
    live.hand.move((at[0], at[1], at[2] + 1.0))
    until(lambda s: float(s.v[:, 2].mean()) > 0.2, "it is pulled up")
    splats = session.splats()
    assert splats.centers.shape[0] == len(session.run.gaussians)
    session.paint("velocity")
    assert session.legend(320) is not None and session.splats().rgbs.std() > 0
    live.hand.release()
    until(lambda s: float(s.v[:, 2].mean()) < -0.2, "it falls")
    shown, simulated = live.rates
    assert 0 < shown < 40 and simulated > 0
    session.release()
    assert not live.running and session.live is None


def test_exports_go_into_a_folder_of_the_run_and_replace_nothing(session, tmp_path):
    session.export_film()
    first = wait(session)
    session.export_film()
    second = wait(session)
    assert first == f"wrote {tmp_path / 'viewer' / 'film_001.mp4'}" and second.endswith("film_002.mp4")
    assert (tmp_path / "viewer/film_001.mp4").stat().st_size > 500
    session.player.playing = False
    session.player.seek(2)
    assert session.export_ply() == f"wrote {tmp_path / 'viewer' / 'frame_001.ply'}"
    back = read(tmp_path / "viewer/frame_001.ply")
    # the file turns z up into y down and back: float32
    torch.testing.assert_close(back.means, torch.from_numpy(session.splats().centers), rtol=0, atol=1e-5)


def test_gaussians_of_a_frame_are_those_that_are_drawn(session):
    """R S² Rᵀ = Σ of the picture, for a sheared body painted by its speed."""
    figure, n = session.film.figure, len(session.run.particles)
    F = torch.tensor([[1.2, 0.5, 0.0], [0.0, 0.9, -0.3], [0.1, 0.0, 1.1]]).expand(n, 3, 3)
    seen = (session.run.particles.x, F, torch.rand(n, 3, generator=torch.Generator().manual_seed(0)))
    g, drawn = figure.gaussians(*seen), figure(*seen)
    sigma = covariances(g.quats, g.log_scales.exp())
    # float32 of what was squared
    torch.testing.assert_close(sigma, torch.from_numpy(drawn.covariances), rtol=1e-4, atol=1e-8)
    torch.testing.assert_close(torch.from_numpy(still(g).rgbs), torch.from_numpy(drawn.rgbs), rtol=0, atol=1e-6)


def test_simulations_end_when_a_session_is_closed(session):
    session.hold(Change(particles=100))
    session.simulate(Change(particles=None))
    live = session.live
    session.close()
    assert not session.job.running and not live.running
