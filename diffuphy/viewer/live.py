"""A simulation that runs on and on, as fast as it can and no faster than real time, with a hand in it."""

import threading
import time
from collections import deque

from diffuphy.mpm import State, simulate
from diffuphy.viewer.change import Setup
from diffuphy.viewer.hand import Hand
from diffuphy.viewer.job import line_of

ENDLESS = 10**9
"""Frames: a year at 30 frames a second."""

WINDOW = 30
"""Frames over which rates are measured."""


class Live:
    """States of a scene one after the other, in a thread of its own.

    Args:
        setup: what it begins with.
        hand: what pulls at it.
    """

    def __init__(self, setup: Setup, hand: Hand):
        self.setup, self.hand = setup, hand
        self.latest: State | None = None
        """The last frame."""
        self.number = -1
        """Its number."""
        self.message = ""
        """Why it ended."""
        self._stop = threading.Event()
        self._times: deque[float] = deque(maxlen=WINDOW + 1)
        self._busy: deque[float] = deque(maxlen=WINDOW)
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float = 10.0) -> None:
        """End it with the present frame."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    @property
    def rates(self) -> tuple[float, float] | None:
        """Frames shown in a second of the clock, and seconds simulated in a second of work: above 1 it waits for the
        clock. None before there are two frames."""
        times, busy = list(self._times), list(self._busy)
        if len(times) < 2:
            return None
        shown = (len(times) - 1) / max(times[-1] - times[0], 1e-9)
        return shown, len(busy) / self.setup.scene.fps / max(sum(busy), 1e-9)

    def _run(self) -> None:
        s = self.setup
        real = s.particles.x.double() if s.double else s.particles.x
        frame = 1.0 / s.scene.fps
        try:
            states = simulate(s.scene, real, s.particles.vol.to(real), s.field, frames=ENDLESS, steer=self.hand.steer)
            due = time.perf_counter()
            for number in range(ENDLESS):
                began = time.perf_counter()
                state = next(states)
                now = time.perf_counter()
                self.latest, self.number = state, number
                if number > 1:  # the first frame compiles
                    self._busy.append(now - began)
                    self._times.append(now)
                due = max(due + frame, now)
                if self._stop.wait(due - now):
                    return
        except Exception as error:
            self.message = f"live simulation ended: {line_of(error)}"
