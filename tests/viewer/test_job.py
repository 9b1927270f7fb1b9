"""Work in the background ends as it should, whatever it does."""

import threading
import time

import pytest

from diffuphy.types import SimulationDiverged
from diffuphy.viewer.job import Job, Watched, line_of


def wait(job: Job) -> None:
    end = time.monotonic() + 10
    while job.running:
        assert time.monotonic() < end
        time.sleep(0.005)


def test_one_piece_of_work_at_a_time_and_its_last_line_stays():
    job, go = Job(), threading.Event()

    def work(progress):
        progress(0.5)
        go.wait(10)
        return "done"

    assert job.start("work", work)
    while job.share < 0.5:
        time.sleep(0.001)
    assert not job.start("other", work)
    go.set()
    wait(job)
    assert job.message == "done"


def test_work_that_is_stopped_ends_at_its_next_step():
    """The count stays far below what there was to do."""
    job, steps = Job(), []

    def work(progress):
        with Watched(progress).bar(10**6, "steps") as bar:
            for k in range(10**6):
                steps.append(k)
                bar.update()
                time.sleep(1e-4)
        return "done"

    job.start("work", work)
    while len(steps) < 3:
        time.sleep(0.001)
    job.stop(timeout=10)
    assert not job.running and job.message == "work: stopped" and len(steps) < 10**5


@pytest.mark.parametrize("error", [ValueError("a\nb"), SimulationDiverged("a\nb"), OSError("a\nb"), KeyError("a")])
def test_an_error_is_one_line(error):
    """Also one that is a bug: the page stays."""
    job = Job()

    def work(progress):
        raise error

    job.start("work", work)
    wait(job)
    assert job.message == f"work failed: {line_of(error)}" and "\n" not in job.message and "a" in job.message
