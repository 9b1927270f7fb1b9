"""What is said when a simulation or its gradient has no answer."""

import dataclasses
import re
import sys

import pytest
import torch

from diffuphy.mpm import FrameReport, Grid, HalfSpace, Scene, Solver, Span, State, backward_bytes, rollout, simulate
from diffuphy.mpm.engine.solver import segment_of
from diffuphy.mpm.rollout import ROOM, _left_first
from diffuphy.mpm.scene import STABLE
from diffuphy.mpm.state import state_bytes
from diffuphy.types import SimulationDiverged
from tests.mpm.bodies import block, field

DX = 0.05
FREE = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=4, boundaries=(), lift=None)


def cube(E: float = 1e5, cells: int = 2):
    x, vol = block((cells, cells, cells), DX, (0.013, 0.021, 0.337))
    return x, vol, field(len(x), E=E)


def test_divergence_names_everything_and_the_first_bad_substep():
    """Quantity, particle, substep, time, value, limit and one remedy, of a force of which the clock cannot know; time =
    substep · Δt, and one substep earlier the state was good: |v| Δt/Δx grows by a Δt²/Δx in each."""
    x, vol, f = cube()
    push, a = torch.zeros_like(x), 1e6
    push[:, 0] = a
    with pytest.raises(SimulationDiverged) as caught:
        rollout(FREE, x, vol, f, body=lambda t: push)
    text = str(caught.value)
    found = re.search(
        r"particle (\d+) crossed more than one cell in a substep in frame (\d+) "
        r"\(substep (\d+) of (\d+), t = (\S+) s\): "
        r"\|v\| Δt/Δx = (\S+), at most 1; x = .* m, \|v\| = .* m/s, .* Δt = (\S+) s, CFL = \S+; "
        r"shorter substeps did not help: .*lower cfl below (\S+)$",
        text,
    )
    assert found, text
    p, frame, s, n, t, cells, dt, cfl = (float(a) for a in found.groups())
    assert 0 <= p < len(x) and frame == 0 and 0 < s < n and 0.0 < cfl < FREE.cfl
    assert 1.0 < cells <= 1.0 + 1.01 * a * dt * dt / DX
    assert t == pytest.approx((s + 1) * dt, rel=5e-3)  # three digits of Δt


class Watched:
    """A solver whose rounds are known: status and state of each."""

    def __init__(self, *rounds: tuple[list[int], State]):
        self.rounds = rounds

    def watch(self, *_: object):
        for s, (status, state) in enumerate(self.rounds):
            yield s, status, state


def test_a_particle_whose_place_is_no_number_has_not_left_the_block():
    """Stress that is NaN in a round makes places NaN in it and outside of every block in the next: no block is large
    enough, and a larger one is not tried. One that leaves before that has left."""
    x, vol, f = cube()
    good = next(simulate(FREE, x, vol, f))
    bad = dataclasses.replace(good, x=torch.full_like(x, float("nan")))
    span = Span(Grid(DX, (0, 0, 0), (8, 8, 8)), 0.0, 1e-3, 3, 10.0, 0.0, False)
    rest = [0, 0, 0]
    assert not _left_first(Watched((rest, bad), ([8, 0, 0], bad)), good, None, span)  # type: ignore[arg-type]
    assert not _left_first(Watched(([8, 0, 0], bad)), good, None, span)  # type: ignore[arg-type]
    assert not _left_first(Watched((rest, good), ([0, 3, 0], good), ([8, 0, 0], good)), good, None, span)  # type: ignore[arg-type]
    assert _left_first(Watched((rest, good), ([8, 0, 0], good), (rest, bad)), good, None, span)  # type: ignore[arg-type]


def test_a_block_grows_by_no_more_cells_than_there_are_substeps(monkeypatch):
    """Nobody crosses more than a cell a substep: whoever is outside of a block that wide is not met by a wider one. And
    what explodes does not take the memory of the machine."""
    x, vol, f = cube(cells=1)
    seen, advance = [], Solver.advance

    def left(self, state, matter, span, keep=False, sums=None):
        seen.append(span)
        end, _, rows = advance(self, state, matter, span, keep, sums)
        return end, [1, 0, 0], rows

    monkeypatch.setattr(Solver, "advance", left)
    with pytest.raises(SimulationDiverged, match=r"left every block.*; raise fps"):
        rollout(FREE, x, vol, f, frames=1, velocity=0.3 * torch.sin(9.0 * x))
    first = seen[0]
    margins = [(s.grid.shape[0] - first.grid.shape[0]) // 2 for s in seen]
    assert margins[0] == 0 and first.steps <= margins[-1] < 2 * first.steps + 8
    assert max(s.grid.nodes for s in seen) <= ROOM


def test_a_pinned_step_that_turns_out_unstable_is_what_the_remedy_names():
    """The wall comes at twice the speed of sound; at the beginning nothing forbids the step."""
    x, vol, f = cube(E=100.0)
    wall = HalfSpace(point=(0.0, 0.0, 0.33), velocity=(0.0, 0.0, 6.0), kind="sticky")
    with pytest.raises((SimulationDiverged, ValueError), match=r"lower dt below|use at most"):
        rollout(dataclasses.replace(FREE, boundaries=(wall,)), x, vol, f, dt=4e-3)


@pytest.mark.parametrize("factor", [2.0, 10.0, 100.0])
def test_an_unstable_step_is_refused_with_the_number_that_would_do(factor):
    """D3: pinned at a multiple of the limit; the number in the message is then accepted."""
    x, vol, f = cube()
    with pytest.raises(ValueError, match="dt = 1 s is unstable"):
        rollout(dataclasses.replace(FREE, fps=1.0), x, vol, f, frames=1, dt=1.0)
    c = (1e5 * 0.7 / (1.3 * 0.4) / 1000.0) ** 0.5  # √((λ + 2μ)/ρ), ν = 0.3
    limit = STABLE * DX / c
    slow = dataclasses.replace(FREE, fps=1.0 / (500 * limit))  # a frame is longer than any of the steps
    with pytest.raises(ValueError, match="is unstable") as refused:
        rollout(slow, x, vol, f, frames=1, dt=factor * limit)
    said = float(str(refused.value).split("use at most ")[1].split(" s")[0])
    assert said == pytest.approx(limit, rel=5e-3)
    reports: list[FrameReport] = []
    rollout(dataclasses.replace(FREE, fps=50.0), x, vol, f, frames=1, dt=0.99 * said, report=reports)
    assert reports[0].dt <= said


def test_a_gradient_that_the_loss_spoils_is_not_zeroed():
    """∂√x at 0 is infinite, ∞ · 0 is NaN: said, with the particle, and that it is not the simulation."""
    x, vol, f = cube()
    v = torch.zeros_like(x).requires_grad_()
    out = rollout(FREE, x, vol, f, frames=1, velocity=v, grad=True)
    loss = ((out.x[-1, 5] - out.x[-1, 5].detach()).square().sum()).sqrt()
    with pytest.raises(SimulationDiverged, match=r"gradient .* end of the frame .* of particle 5.*mend the loss"):
        loss.backward()


def test_a_gradient_that_overflows_names_particle_substep_and_law():
    """A loss of slope 1e38 in float32: the adjoint of stress multiplies it by E V Δt/Δx … > 10 and overflows."""
    x, vol = block((2, 2, 2), DX, (0.013, 0.021, 0.337), dtype=torch.float32)
    f = field(len(x), E=1e7, dtype=torch.float32)
    v = torch.zeros_like(x).requires_grad_()
    out = rollout(FREE, x, vol, f, frames=1, velocity=v, grad=True)
    with pytest.raises(
        SimulationDiverged, match=r"gradient in \w+ of particle \d+ \(neo_hookean, identity\).*substep \d+"
    ):
        (1e38 * out.F[-1].sum()).backward()


def test_a_window_cuts_the_graph():
    """With window = 2 a loss at frame 4 sees frames 3 and 4 only: its gradient in E is that of two frames from the
    state at frame 2 as a constant, and none reaches the initial velocity."""
    x, vol, f = cube()
    v, E = (0.3 * torch.sin(9.0 * x)).requires_grad_(), f.theta["E"].clone().requires_grad_()
    f = dataclasses.replace(f, theta=f.theta | {"E": E})
    out = rollout(FREE, x, vol, f, velocity=v, grad=True, window=2)
    E_bar, v_bar = torch.autograd.grad(out.F[-1].square().sum(), [E, v], allow_unused=True)
    assert v_bar is None or not bool(v_bar.any())
    *_, middle = simulate(FREE, x, vol, f, velocity=v.detach(), frames=2)
    *_, end = simulate(FREE, x, vol, f, state=middle, frames=2, grad=True)
    (expected,) = torch.autograd.grad(end.F.square().sum(), E)
    assert torch.equal(E_bar, expected) and bool(expected.any())


def test_the_memory_of_a_backward_pass_is_stated(caplog, monkeypatch):
    """States of the frames and of one frame at work: 24 numbers a particle and state here. Said once for a clip of this
    size, however often it is made."""
    monkeypatch.setattr(sys.modules["diffuphy.mpm.rollout"], "_told", set())
    x, vol, f = cube()
    v = torch.zeros_like(x).requires_grad_()
    with caplog.at_level("INFO", logger="diffuphy.mpm.rollout"):
        for _ in range(2):
            states = list(simulate(FREE, x, vol, f, velocity=v, grad=True, segment=7))
    assert caplog.text.count("backward pass") == 1
    row = 24 * 8 * len(x)
    assert state_bytes(states[-1]) == row
    steps = int(re.search(r"(\d+) rounds", caplog.text).group(1))  # type: ignore[union-attr]
    expected = (4 + 7 + 1 + -(-steps // 7) - 1) * row
    assert backward_bytes(states[-1], 4, steps, segment=7) == expected
    assert f"{expected / 1e6:.1f} MB" in caplog.text
    assert backward_bytes(states[-1], 4, steps, keep=True) == 4 * (steps + 1) * row


def test_segments_are_as_few_as_the_budget_allows():
    """1600 substeps of 8000 particles in 16 frames stay below 64 MB; a frame that fits is one segment; one that never
    fits is cut into √steps."""
    row = 8000 * 96
    assert (16 + segment_of(101, row) + 1 + -(-101 // segment_of(101, row))) * row <= 64e6
    assert segment_of(100, 1000) == 100
    assert segment_of(100, 10**9) == 10


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_books_of_a_frame_balance(dtype):
    """Free fall of an unstrained body: momentum gains m g T, the energy lost is that of the rounding, J = 1."""
    x, vol = block((2, 2, 2), DX, (0.013, 0.021, 0.337), dtype=dtype)
    f = field(len(x), dtype=dtype)
    g, reports = (0.0, 0.0, -9.81), []
    scene = dataclasses.replace(FREE, gravity=g, velocity=(0.3, 0.0, 0.0), frames=2)
    list(simulate(scene, x, vol, f, report=reports, diagnose=True))
    books = reports[-1].balance
    m = float((f.rho * vol).sum())
    eps = torch.finfo(dtype).eps
    assert books.end.mass == pytest.approx(m, rel=1e-6)
    # sums over 64 particles and 27 nodes in some 40 substeps, each rounded
    torch.testing.assert_close(
        books.end.momentum, m * x.new_tensor((0.3, 0.0, -9.81 * 2 / 50.0)), rtol=100 * eps, atol=100 * eps
    )
    assert abs(books.lost) < 2000 * eps * books.end.kinetic
    assert books.end.J == pytest.approx((1.0, 1.0), abs=2000 * eps) and 0.0 < books.courant < 0.8


def test_books_show_what_a_body_dissipates():
    """A body that vibrates loses energy to the transfer, and gains none: 0 ≤ lost, E_end + Σ lost = E_start."""
    x, vol, f = cube()
    reports: list[FrameReport] = []
    kick = 0.3 * torch.sin(9.0 * x)
    list(simulate(FREE, x, vol, f, velocity=kick, report=reports, diagnose=True))
    ends = [r.balance.end.kinetic + r.balance.end.elastic for r in reports]  # type: ignore[union-attr]
    lost = [r.balance.lost for r in reports]  # type: ignore[union-attr]
    for before, after, gone in zip(ends, ends[1:], lost[1:], strict=False):
        assert after + gone == pytest.approx(before, rel=1e-12)
    assert sum(lost) > 0.0
    assert reports[0].balance.end.J[0] < 1.0 < reports[0].balance.end.J[1]  # type: ignore[union-attr]


def test_what_is_not_asked_for_is_not_there():
    x, vol, f = cube()
    reports: list[FrameReport] = []
    rollout(FREE, x, vol, f, report=reports)
    assert all(r.balance is None for r in reports)
    with pytest.raises(ValueError, match="give a list as report"):
        rollout(FREE, x, vol, f, diagnose=True)
    with pytest.raises(ValueError, match="window must be at least 1 frame"):
        rollout(FREE, x, vol, f, window=0)
