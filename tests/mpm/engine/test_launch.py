"""Threads: what they compute does not depend on how they interleave, and what one raises all raise."""

import dataclasses

import pytest
import torch

from diffuphy.mpm import Controls, HalfSpace, Scene, rollout
from diffuphy.mpm.engine.launch import Lanes, Program
from diffuphy.mpm.substep.barrier import Halted, Step
from tests.mpm.bodies import block, field

SCENE = Scene(dx=0.05, fps=60.0, frames=2, velocity=(0.5, 0.2, -2.0), spin=(1.0, 2.0, 0.0), lift=0.01)


def film(threads: int, dtype: torch.dtype, scene: Scene = SCENE, **options):
    """Trajectory of a block on a floor, and the gradient of a sum over it in E and the velocity."""
    x, vol = block((5, 4, 3), 0.05, (0.013, 0.021, 0.0), dtype=dtype)
    f = field(len(x), dtype=dtype)
    E, v = f.theta["E"].clone().requires_grad_(), (0.1 * torch.sin(20 * x)).requires_grad_()
    f = dataclasses.replace(f, theta=f.theta | {"E": E})
    out = rollout(scene, x, vol, f, velocity=v, grad=True, threads=threads, **options)
    bars = torch.autograd.grad(out.x.square().sum() + out.v.square().sum() + out.F.square().sum(), [E, v])
    return (out.x.detach(), out.v.detach(), out.F.detach(), *bars)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_give_the_same_bits_every_time(threads):
    """Each thread sums into nodes of its own: no order of arrival is in the result, forward or backward."""
    first = film(threads, torch.float32)
    for _ in range(4):
        assert all(torch.equal(a, b) for a, b in zip(first, film(threads, torch.float32), strict=True))


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_change_nothing_but_rounding(threads):
    """Another order of the same sums over some 60 substeps: 60 · 27 · 1.1e-16, times the condition of gradients that
    partly cancel (about 1e3)."""
    one, many = film(1, torch.float64), film(threads, torch.float64)
    for a, b in zip(one, many, strict=True):
        torch.testing.assert_close(b, a, rtol=0, atol=1e-9 * float(a.abs().max()))


def test_a_body_acceleration_is_there_before_any_thread_reads_it():
    """g as a body acceleration that changes in time is the same with one and with three threads."""
    still = dataclasses.replace(SCENE, boundaries=(HalfSpace(friction=0.3),))
    n = 5 * 4 * 3 * 8

    def wind(t: float) -> torch.Tensor:
        return torch.full((n, 3), 100.0 * t, dtype=torch.float64)

    one, three = (film(k, torch.float64, still, body=wind) for k in (1, 3))
    for a, b in zip(one, three, strict=True):
        torch.testing.assert_close(b, a, rtol=0, atol=1e-9 * float(a.abs().max()))


class Stub:
    """A command that records when it was called, or fails at a round."""

    empty = False

    def __init__(self, calls: list[tuple[str, int]], name: str, fails: int | None = None):
        self.calls, self.name, self.fails = calls, name, fails

    def __call__(self, numbers: dict[str, int]) -> None:
        if numbers["s"] == self.fails:
            raise OSError(f"round {self.fails}")
        self.calls.append((self.name, numbers["s"]))


@pytest.mark.parametrize("thread", [0, 1])
def test_what_one_thread_raises_comes_out_and_ends_the_others(thread):
    """Neither a hang nor another round."""
    calls: list[tuple[str, int]] = []
    phases = [[Stub(calls, f"{k}{t}", 3 if (k, t) == (1, thread) else None) for t in range(2)] for k in range(3)]
    with pytest.raises(OSError, match="round 3"):
        Program(phases).run([{"s": s} for s in range(9)])  # type: ignore[arg-type]
    assert max(s for _, s in calls) == 3
    assert not any(name[0] == "2" and s == 3 for name, s in calls)


def test_a_phase_begins_when_the_one_before_has_ended():
    """In every round all calls of a phase come before those of the next."""
    calls: list[tuple[str, int]] = []
    phases = [[Stub(calls, f"{k}{t}") for t in range(3)] for k in range(4)]
    Program(phases).run([{"s": s} for s in range(50)])  # type: ignore[arg-type]
    for s in range(50):
        order = [int(name[0]) for name, at in calls if at == s]
        assert order == sorted(order) and len(order) == 12


def test_a_barrier_lets_nobody_ahead():
    """A single thread passes its own barrier; one of two does not before the other arrives."""
    Step(1).wait(0)
    step = Step(2)
    step.halted = True  # so that a wait that would last ends
    with pytest.raises(Halted):
        step.wait(0)
    step.wait(1)  # the other has arrived once already


@pytest.mark.parametrize("lanes", [Lanes(1, 10, 3), Lanes(4, 5, 3), Lanes(2, 7, 5), Lanes(1, 2, 4)])
def test_lanes_share_out_everything_once(lanes):
    """Ranges of particles and of nodes are disjoint and complete, and no lane is cut between threads."""
    for ranges, total in ((lanes.of_particles(), lanes.particles * lanes.scenes), (lanes.of_nodes(101), 101)):
        assert len(ranges) == lanes.threads
        assert [i for a, n in ranges for i in range(a, a + n)] == list(range(total))
    owners = [{p // lanes.per for p in range(a, a + n)} for a, n in lanes.of_particles()]
    assert sum(len(o) for o in owners) == len(set().union(*owners))


def test_gradients_of_walls_do_not_depend_on_threads():
    """Every node adds to the one row of a wall: with several threads as with one, to rounding, and to the bit each
    time."""
    x, vol = block((8, 8, 4), 0.05, (0.0, 0.0, 0.0))
    scene = Scene(
        dx=0.05, fps=60.0, frames=2, lift=None, velocity=(1.0, 0.0, -1.0), boundaries=(HalfSpace(friction=0.3),)
    )
    found = []
    for threads in (1, 2, 2, 2):
        mu = torch.tensor([0.3], dtype=x.dtype, requires_grad=True)
        V = torch.zeros(1, 3, dtype=x.dtype, requires_grad=True)
        controls = Controls(friction=mu, velocity=V)
        out = rollout(scene, x, vol, field(len(x)), grad=True, threads=threads, controls=controls)
        found.append(torch.autograd.grad(out.x[-1, :, 0].sum(), [mu, V]))
    assert abs(float(found[0][0])) > 0.0
    for g in found[1:]:
        torch.testing.assert_close(g, found[0], rtol=1e-10, atol=1e-12)
        assert all(torch.equal(a, b) for a, b in zip(g, found[1], strict=True))
