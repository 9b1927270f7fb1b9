"""Looking at a run that trains costs it next to nothing, and cannot end it."""

import logging

import pytest
import torch

from diffuphy.mpm import coarsen
from diffuphy.render import Skin
from diffuphy.types import Trajectory
from diffuphy.viewer import training
from diffuphy.viewer.training import Pace, Training
from diffuphy.workspace import Workspace
from tests.viewer.runs import ball


class Server:
    """Stands for a viser server; remembers what was sent."""

    def __init__(self, clients: int = 1):
        self.clients, self.sent = clients, []
        self.gui = self.scene = self.initial_camera = self

    def get_clients(self):
        return dict.fromkeys(range(self.clients))

    def add_gaussian_splats(self, name, *splats, **how):
        self.sent.append(splats)
        return self

    def set_gaussians(self, *splats):
        self.sent.append(splats)

    def __getattr__(self, name):
        return lambda *a, **k: type("Widget", (), {})()


@pytest.fixture
def opened():
    made = []

    def start(server):
        made.append(Training(server))
        return made[-1]

    yield start
    for t in made:
        t.close()


def test_no_picture_is_made_while_nobody_looks(opened):
    watch = opened(Server(clients=0))
    watch("gaussians", 1, 10, lambda: pytest.fail("made for nobody"))


def test_a_stage_that_nobody_watches_makes_nothing():
    Workspace().show("gaussians", 1, 10, lambda: pytest.fail("made for nobody"))


def test_gaussians_are_shown_where_they_are(opened):
    server, (gaussians, _) = Server(), ball(4)
    opened(server)("gaussians", 3, 10, lambda: gaussians)
    centers = torch.from_numpy(server.sent[0][0])
    # one scale for all, float32
    torch.testing.assert_close(centers / centers.abs().max(), gaussians.means / gaussians.means.abs().max())


def test_a_clip_is_shown_frame_by_frame_and_as_large_as_the_object(opened):
    gaussians, particles = ball(6)
    draft, _ = coarsen(particles, n=100)
    x = torch.stack([draft.x, draft.x + 0.1]).requires_grad_()
    film = Trajectory(x, torch.zeros_like(x), torch.eye(3).expand(2, len(draft), 3, 3), 30.0)
    first, second = training._pictures((Skin.bind(gaussians, draft, 4), film))
    spread = first.centers.max(0) - first.centers.min(0)
    assert spread.max() == pytest.approx(training.SIZE, rel=1e-5)
    moved = torch.from_numpy(second.centers - first.centers)
    grown = training.SIZE / (particles.scale * float((gaussians.means.amax(0) - gaussians.means.amin(0)).max()))
    torch.testing.assert_close(moved, torch.full_like(moved, 0.1 * grown), rtol=1e-4, atol=1e-4)


def test_what_goes_wrong_is_told_once_and_the_stage_goes_on(opened, caplog):
    server = Server()
    watch = opened(server)

    def broken():
        raise RuntimeError("no picture")

    with caplog.at_level(logging.WARNING):
        for step in range(3):
            watch._told = watch._pace = Pace(0.0, 1.0)
            Workspace(watch=watch).show("gaussians", step, 3, broken)
    assert [r.message for r in caplog.records] == ["viewer: RuntimeError: no picture; the run goes on without it"]


def test_pictures_take_no_more_than_their_share():
    """Work of c seconds is done again after c/share at the earliest: share = c / (c/share)."""
    pace = Pace(every=0.1, share=0.01)
    now, busy = 0.0, 0.0
    while now < 100.0:
        if pace.due(now):
            pace.took(now, now + 0.05)
            busy, now = busy + 0.05, now + 0.05
        now += 0.001
    # the last one may have just begun
    assert 0.009 * now < busy <= 0.01 * now + 0.05


def test_pictures_come_no_faster_than_asked():
    pace = Pace(every=2.0, share=0.5)
    pace.took(1.0, 1.001)
    assert not pace.due(2.999) and pace.due(3.001)
