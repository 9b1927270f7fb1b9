"""How threads wait for each other."""

import time

SPINS = 2000
"""How often a thread that waits asks again at once; about 2 ms, longer than any phase that is worth dividing."""

PAUSE = 5e-5
"""How long it sleeps between questions after that [s]: its core may be needed by the thread it waits for."""


class Halted(Exception):
    """Another thread has failed."""


class Step:
    """A barrier for threads that wait microseconds for each other: each counts its own arrivals and yields the
    interpreter until the others have as many. A lock would put a thread to sleep, and waking takes longer than a phase
    over the nodes of a small body."""

    def __init__(self, threads: int):
        self.halted = False
        """Whether to give up waiting."""
        self._arrived = [0] * threads

    def wait(self, t: int) -> None:
        """Return when every thread has called as often as thread ``t``.

        Raises:
            Halted: another thread has failed.
        """
        arrived = self._arrived
        arrived[t] += 1
        mine, spins = arrived[t], 0
        while min(arrived) < mine:
            if self.halted:
                raise Halted
            spins += 1
            time.sleep(0.0 if spins < SPINS else PAUSE)
