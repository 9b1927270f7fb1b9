"""What a training stage has so far, in a browser: ``viewer=on``.

Nothing is made while no browser looks. While one does, pictures are made and sent only as long as that takes no more
than ``SHARE`` of the time; and whatever goes wrong here is told once and ends the watching, never the run.
"""

import logging
import math
import threading
import time
from collections.abc import Callable
from typing import Any, Self

import numpy as np
import torch

from diffuphy.render.skin import Skin
from diffuphy.types import Gaussians
from diffuphy.viewer.page import Splatting
from diffuphy.viewer.server import PORT, directions, serve
from diffuphy.viewer.shot import Figure, Splats, still

log = logging.getLogger(__name__)

EVERY = 2.0
"""Shortest time between two pictures of a stage [s]."""

SHARE = 0.02
"""Largest part of the time that making pictures may take, and sending those of a clip as much again [-]."""

STRETCH = 3.0
"""Longest drawing of a Gaussian over that at rest, as in films [-]."""

SIZE = 2.0
"""Longest side of what is shown: that of the object's frame; clips are in metres and made as large."""


class Pace:
    """When to do again what takes time: neither more often than ``every``, nor for more than a share of the time.

    Args:
        every: shortest time between two beginnings [s].
        share: of the time, at most [-].
    """

    def __init__(self, every: float, share: float):
        self.every, self.share = every, share
        self._next = 0.0

    def due(self, now: float) -> bool:
        return now >= self._next

    def took(self, start: float, end: float) -> None:
        """It was done from ``start`` to ``end`` [s]."""
        self._next = max(start + self.every, end + (end - start) * (1.0 / self.share - 1.0))


class Training:
    """A ``workspace.Watch`` with a page.

    Args:
        server: the ``viser.ViserServer`` to show it with.
    """

    def __init__(self, server: Any):
        self.server = server
        self._text = server.gui.add_markdown("waiting for a stage that trains")
        self._bar = server.gui.add_progress_bar(0.0)
        side = 4 * SIZE
        self._floor = server.scene.add_grid(
            "/floor", width=side, height=side, cell_size=SIZE / 5, section_size=SIZE, plane_opacity=0.35
        )
        camera = server.initial_camera
        camera.position, camera.look_at, camera.fov = (3.6, -6.2, 1.8), (0.0, 0.0, 0.2), math.radians(32.0)
        self._splatting: Splatting | None = None
        self._broken = False
        self._pace, self._told = Pace(EVERY, SHARE), Pace(0.2, SHARE)
        self._clip: list[Splats] = []
        self._stop = threading.Event()
        self._player = threading.Thread(target=self._play, name="training viewer", daemon=True)
        self._player.start()

    @classmethod
    def start(cls, port: int = PORT) -> Self:
        """Open a page on this machine, and say where.

        Raises:
            ModuleNotFoundError: viser is not installed.
        """
        server = serve(port=port, title="training")
        made = cls(server)
        log.info("viewer: %s", directions("127.0.0.1", port, server.get_port()).replace("\n", "; "))
        return made

    def __call__(self, stage: str, step: int, total: int, seen: Callable[[], Any]) -> None:
        """Show step ``step`` of ``total``, if a browser looks and it is time."""
        if self._broken:
            return
        try:
            now = time.perf_counter()
            if not self._told.due(now) or not self.server.get_clients():
                return
            self._text.content = f"{stage}: step {step} of {total}"
            self._bar.value = 100.0 * step / max(total, 1)
            if self._pace.due(now):
                made = seen()
                self._clip = _pictures(made)
                low = float(self._clip[0].centers[:, 2].min()) if isinstance(made, Gaussians) else -SIZE / 2
                self._floor.position = (0.0, 0.0, low)
                self._send(self._clip[0])
                self._pace.took(now, time.perf_counter())
            self._told.took(now, now)
        except Exception as error:
            self._fail(error)

    def _send(self, splats: Splats) -> None:
        if self._splatting is None:
            self._splatting = Splatting(self.server, splats, SIZE)
        self._splatting.show(splats)

    def _play(self) -> None:
        """Show the frames of the last clip over and over."""
        frame, wait = 0, 1 / 15
        while not self._stop.wait(wait):
            clip, wait = self._clip, 1 / 15
            if len(clip) < 2 or not self.server.get_clients():
                continue
            frame = (frame + 1) % len(clip)
            start = time.thread_time()
            try:
                self._send(clip[frame])
            except Exception as error:
                return self._fail(error)
            wait = max(wait, (time.thread_time() - start) * (1.0 / SHARE - 1.0))
        return None

    def _fail(self, error: Exception) -> None:
        if not self._broken:
            self._broken = True
            log.warning("viewer: %s: %s; the run goes on without it", type(error).__name__, error)
        self._stop.set()

    def close(self) -> None:
        """Take the page down."""
        self._stop.set()
        self._player.join(5.0)
        self.server.stop()


@torch.no_grad()
def _pictures(seen: Any) -> list[Splats]:
    """One picture of Gaussians; of a skin and the trajectory that it follows, one a frame, as large and as low: clips
    are simulated above the origin, Gaussians are fitted about it."""
    if isinstance(seen, Gaussians):
        return [still(seen.to("cpu"))]
    skin, trajectory = seen
    figure = Figure(_on_cpu(skin), STRETCH)
    rest = figure.skin.gaussians.means
    grow = SIZE / float((rest.amax(0) - rest.amin(0)).max())
    frames = (figure(x.cpu().detach(), F.cpu().detach()) for x, F in zip(trajectory.x, trajectory.F, strict=True))
    down = np.array([0.0, 0.0, SIZE / 2], dtype=np.float32)
    return [s._replace(centers=grow * s.centers - down, covariances=grow**2 * s.covariances) for s in frames]


def _on_cpu(skin: Skin) -> Skin:
    return Skin(skin.gaussians.to("cpu"), skin.index.cpu(), skin.weight.cpu(), skin.arm.cpu())
