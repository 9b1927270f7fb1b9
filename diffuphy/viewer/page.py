"""The viewer's page: a scene that is sent frame by frame, and the panel beside it."""

import math
import time
from typing import Any

import numpy as np

from diffuphy.viewer.hand import slide
from diffuphy.viewer.panel import Panel
from diffuphy.viewer.session import Session
from diffuphy.viewer.shot import Splats

UNITS = 32.0
"""Units of the browser in the longest side of the body: it keeps covariances as half-precision numbers, whose digits
end at 6e-8, and a Gaussian may be a thousandth of the body thick."""

TICK = 1 / 60
"""Time between two looks at what is to be shown [s]."""

AZIMUTH, ELEVATION, DISTANCE = math.radians(-60.0), math.radians(14.0), 3.2
"""Where the camera begins: as in the film; its distance over the size of the scene."""


class Splatting:
    """Gaussians in a browser's scene."""

    def __init__(self, server: Any, splats: Splats, size: float):
        self.scale = UNITS / size
        self._handle = server.scene.add_gaussian_splats("/body", *self._sent(splats), scale=1.0 / self.scale)

    def _sent(self, s: Splats) -> tuple[np.ndarray, ...]:
        return self.scale * s.centers, self.scale**2 * s.covariances, s.rgbs, s.opacities

    def show(self, splats: Splats) -> None:
        """Draw these instead."""
        self._handle.set_gaussians(*self._sent(splats))


class Page:
    """Shows a session.

    Args:
        session: what is shown.
        server: where (a ``viser.ViserServer``).
    """

    def __init__(self, session: Session, server: Any):
        self.session, self.server = session, server
        self.size = session.run.motion.size
        splats = session.splats()
        self.splatting = Splatting(server, splats, self.size)
        self.panel = Panel(session, server)
        self._look(session)
        # what takes the pointer; its faces are drawn into the depths, so only those behind the body may be there
        self.body = server.scene.add_box("/hold", dimensions=(1.0, 1.0, 1.0), opacity=0.0, side="back",
                                         cast_shadow=False, receive_shadow=False, visible=False)  # fmt: skip
        self._held: tuple[float, float, float] | None = None
        self.body.on_drag("left")(self._drag)
        self.body.on_click(self._click)
        self._shown: tuple[object, ...] = ()
        self._last = time.perf_counter()

    def _look(self, session: Session) -> None:
        """Floor and first camera."""
        x = session.film.trajectory.x
        low, high = x.amin((0, 1)), x.amax((0, 1))
        middle = ((low + high) / 2).numpy()
        away = DISTANCE * float((high - low).max())
        out = np.array([math.cos(AZIMUTH), math.sin(AZIMUTH), math.tan(ELEVATION)])
        camera = self.server.initial_camera
        camera.look_at, camera.position, camera.up = tuple(middle), tuple(middle + away * out), (0.0, 0.0, 1.0)
        camera.fov = math.radians(32.0)
        side = 8.0 * self.size
        self.server.scene.add_grid(
            "/floor", width=side, height=side, cell_size=self.size / 5, section_size=self.size, plane_opacity=0.35
        )

    # ------------------------------------------------------------------ the hand
    async def _drag(self, event: Any) -> None:
        live = self.session.live
        if live is None:
            return
        eye = tuple(event.client.camera.position)
        if event.phase == "start":
            toward = tuple(b - a for a, b in zip(eye, event.start_position, strict=True))
            self._held = self.session.touch(eye, toward)
            if self._held is not None:
                live.hand.grab(self._held)
        elif event.phase == "end" or self._held is None:
            self._held = None
            live.hand.release()
        if self._held is not None:
            live.hand.move(slide(eye, event.end_position, self._held))

    async def _click(self, event: Any) -> None:
        live, at = self.session.live, self.session.touch(event.ray_origin, event.ray_direction)
        if live is not None and at is not None:
            live.hand.poke(at, event.ray_direction)

    # ------------------------------------------------------------------ in time
    def update(self) -> None:
        """Send what has changed since the last call."""
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        name = self.session.tick(min(seconds, 1.0))
        if name != self._shown:
            splats = self.session.splats()
            with self.server.atomic():
                self.splatting.show(splats)
                self._follow(splats)
            self._shown = name
        self.panel.update()

    def _follow(self, splats: Splats) -> None:
        """Put the box that takes the pointer around the body."""
        self.body.visible = self.session.live is not None
        if self.body.visible:
            low, high = splats.centers.min(0), splats.centers.max(0)
            self.body.position = tuple((low + high) / 2)
            self.body.scale = tuple(high - low + 0.1 * self.size)

    def run(self) -> None:
        """Until Ctrl-C."""
        try:
            while True:
                began = time.perf_counter()
                self.update()
                time.sleep(max(0.0, TICK - (time.perf_counter() - began)))
        except KeyboardInterrupt:
            pass
        finally:
            self.session.close()
            self.server.stop()
