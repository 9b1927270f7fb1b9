"""Work in the background that tells how far it is, can be stopped, and never takes the page down with it."""

import logging
import threading
from collections.abc import Callable
from typing import Any, Self

from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


class Stopped(Exception):
    """Somebody pressed the button."""


Progress = Callable[[float], None]
"""Told the share that is done; raises ``Stopped`` when the work is to end."""


class Job:
    """One piece of work at a time, in a thread of its own."""

    def __init__(self) -> None:
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        self.share = 0.0
        """How much is done, 0 to 1."""
        self.message = ""
        """One line about the last work, or the present one."""

    @property
    def running(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def start(self, name: str, work: Callable[[Progress], str]) -> bool:
        """Begin ``work``, which returns the line to show when it is done; whether nothing else was running."""
        with self._lock:
            if self.running:
                return False
            self._stop.clear()
            self.share, self.message = 0.0, f"{name} ..."
            self._thread = threading.Thread(target=self._run, args=(name, work), name=name, daemon=True)
            self._thread.start()
            return True

    def stop(self, timeout: float | None = None) -> None:
        """Ask the work to end; wait for that, if given a time [s]."""
        self._stop.set()
        if timeout is not None and self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout)

    def _progress(self, share: float) -> None:
        self.share = share
        if self._stop.is_set():
            raise Stopped

    def _run(self, name: str, work: Callable[[Progress], str]) -> None:
        try:
            self.message = work(self._progress)
        except Stopped:
            self.message = f"{name}: stopped"
        except Exception as error:
            self.message = f"{name} failed: {line_of(error)}"


def line_of(error: BaseException) -> str:
    """One line about an error; what was not meant for the user goes to the log with its traceback."""
    import torch

    from diffuphy.types import SimulationDiverged

    text: Any = " ".join(str(error).split()) or type(error).__name__
    if not isinstance(error, ValueError | OSError | SimulationDiverged | torch.OutOfMemoryError):
        log.error("viewer", exc_info=error)
        return f"{type(error).__name__}: {text}"
    return text


class Bar:
    """Takes the place of a progress bar."""

    def __init__(self, total: int, progress: Progress):
        self.total, self.progress, self.done = total, progress, 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        return

    def update(self, n: int = 1) -> None:
        self.done += n
        self.progress(self.done / max(self.total, 1))


class Watched(Workspace):
    """The workspace of a stage that runs as a job: it keeps nothing and tells how far it is."""

    def __init__(self, progress: Progress):
        super().__init__(progress=False)
        self._progress = progress

    def bar(self, total: int, description: str, initial: int = 0) -> Any:
        return Bar(total, self._progress)
