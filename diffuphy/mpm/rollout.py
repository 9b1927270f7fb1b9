"""From particles and a material field to a trajectory: one autograd node a frame, the time step from the material."""

import dataclasses
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from diffuphy.material import make_mixture, rate_gate
from diffuphy.mpm.controls import Controls
from diffuphy.mpm.diagnostics import balance
from diffuphy.mpm.drive import Drive, tags
from diffuphy.mpm.engine.clock import Clock
from diffuphy.mpm.engine.frame import joined
from diffuphy.mpm.engine.leaving import Members
from diffuphy.mpm.engine.limits import check_limits, check_options, check_steering, check_velocity, say_small
from diffuphy.mpm.engine.solver import Body, Solver, backward_bytes
from diffuphy.mpm.engine.trouble import Trouble, blame, trouble_of
from diffuphy.mpm.report import FrameReport
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import REAL, Matter, Rows, State, check, check_state, initial_state, make_matter, placed
from diffuphy.mpm.stretch import bounded
from diffuphy.mpm.substep.gather import Gather, Sums, check_gather
from diffuphy.mpm.substep.kernels import LEFT
from diffuphy.types import MaterialField, Trajectory

log = logging.getLogger(__name__)

Steering = Callable[[State], Sequence[Drive]]
"""Drives of the frame that begins with a state."""

GROWTHS = 6
"""How often the block of a frame may be enlarged, each time twice as much, before the particles are taken to have
exploded."""

ROOM = 2**20
"""Nodes that an enlarged block may always have, a hundred megabytes; or eight times those that a frame began with."""

HALVINGS = 4
"""How often the substep of a frame may be halved before its scene is taken to be impossible."""

THREADED = 4096
"""Particles from which on several threads are used unless told otherwise."""

MAX_THREADS = 8
"""Most threads that are taken unless told otherwise: each has a copy of the nodes."""


def rollout(scene: Scene, x: Tensor, vol: Tensor, field: MaterialField, **options: Any) -> Trajectory:
    """The film of :func:`simulate`, whose options it takes; frame 0 is the initial state.

    Differentiable in ``x``, ``velocity``, ``field.w_e``, ``field.w_p``, every ``field.theta`` and ``field.rho`` with
    ``grad=True``: the gradient is that of the discrete scheme, with the number of substeps and the shift that
    ``scene.lift`` makes held fixed.
    """
    states = list(simulate(scene, x, vol, field, **options))
    x, v, F = (torch.stack([getattr(s, name) for s in states]) for name in ("x", "v", "F"))
    Fe = [s.Fe for s in states if s.Fe is not None]
    return Trajectory(x, v, F, scene.fps, torch.stack(Fe) if Fe else None)


def simulate(
    scene: Scene,
    x: Tensor,
    vol: Tensor,
    field: MaterialField,
    *,
    frames: int | None = None,
    grad: bool = False,
    state: State | None = None,
    velocity: Tensor | None = None,
    controls: Controls = Controls(),  # noqa: B008, frozen
    body: Body | None = None,
    dt: float | None = None,
    dt_ref: float | None = None,
    segment: int | None = None,
    keep: bool = False,
    window: int | None = None,
    report: list[FrameReport] | None = None,
    gather: Sequence[Gather] = (),
    diagnose: bool = False,
    scenes: int = 1,
    threads: int | None = None,
    steer: Steering | None = None,
) -> Iterator[State]:
    """The states at the frames of a scene, one after the other, the initial one first.

    Args:
        x: positions at rest, shape (N, 3) [m]; their precision is that of the simulation.
        vol: rest volumes, shape (N,) [m³].
        field: laws, weights, parameters and densities of the N particles.
        frames: number of frames, ``scene.frames`` if None.
        grad: keep what the backward pass needs: the state at each frame. How much that is goes to the log.
        state: go on from this one instead of from the scene's initial state; of ``x`` only drives read then.
        velocity: added to the initial velocity of the scene, shape (N, 3) or (3,) [m/s].
        controls: numbers of the scene as tensors, to differentiate in.
        body: acceleration of every particle at a time, f(t [s]) → (N, 3) [m/s²]; a constant of the graph.
        dt: pin the substep to at most this [s]; refused if it is unstable.
        dt_ref: time over which partial plastic weights are meant [s], see ``material.rate_gate``; None takes them
            per substep. One-hot weights are the same either way.
        segment: substeps that the backward pass keeps at a time; the gradient does not depend on it.
        keep: store every substep for the backward pass instead of running it again: 96 bytes a particle and substep in
            float32 (132 with plasticity) for a fifth of the time of forward and backward.
        window: truncated back-propagation: the graph is cut every ``window`` frames, so that a loss at a frame reaches
            parameters through the frames since the last cut only, 1 … ``window`` of them, and the initial state only
            from the first window. For long films with many contacts, where the exact gradient grows exponentially.
        report: a list to which the report of each frame is appended.
        gather: sums over substeps that the reports then hold, "expected_dv" or "impulse" or both: constants of the
            graph, taken in the forward pass. What is not asked for costs nothing.
        diagnose: fill ``balance`` of the reports: mass, momenta, energies, CFL number and volume change.
        scenes: how many scenes with the same number of particles the tensors hold one after the other; they do not
            touch and share Δt and the block of nodes. See ``rollout_batch``.
        threads: threads that work on a CPU, by default one for every core if there are THREADED particles or more. The
            result depends on their number by rounding only, and on nothing else.
        steer: f(state) → drives of the frame that begins with it, after those of the scene: their kinds and regions
            are always the same, all else may change from frame to frame. ``where`` speaks of initial positions.

    Raises:
        ValueError: shapes, precisions or values that make no simulation; an unstable ``dt``.
        SimulationDiverged: a particle with a state that means nothing, or one that leaves; the message names it. Also
            from the backward pass, for a gradient that is not finite.
    """
    scene = controls.applied(scene)
    check(x, vol, field)
    check_velocity(velocity, len(x))
    check_gather(gather)
    check_options(scene, gather, diagnose, report, segment, window, scenes, len(x), threads)
    check_steering(steer, grad, scenes)
    mixture = make_mixture(tuple(field.elastic), tuple(field.plastic), REAL[x.dtype], tuple(field.branches))
    check_limits(field, mixture.params)
    say_small(scene, x, vol)
    matter = make_matter(field, vol, mixture.params, x.dtype, grad)
    if state is None:
        first = velocity if grad or velocity is None else velocity.detach()
        state = initial_state(scene, x if grad else x.detach(), matter, mixture, first, scenes)
    else:
        check_state(state, mixture)
    own = scene.drives

    def driven() -> tuple[Scene, Matter]:
        drives = (*own, *steer(state)) if steer is not None else own
        at = placed(scene, x, matter.vol).detach()
        tag = tags(drives, at, matter.m.detach(), scene.dx, scenes) if drives else None
        return dataclasses.replace(scene, drives=drives), dataclasses.replace(matter, tag=tag)

    scene, matter = driven()
    members = Members(scene)

    start_x = state.x.detach()
    extent = start_x.amin(0).tolist(), start_x.amax(0).tolist()

    def clock_of(part: Matter) -> Clock:
        n = len(part.m)
        solver = Solver(
            mixture, scene.boundaries, scene.gravity, x.dtype, x.device, particles=n // scenes, dx=scene.dx,
            extent=extent, scheme=scene.scheme, drives=scene.drives, body=_body_of(body, members), gather=gather,
            grad=grad, scenes=scenes, threads=_threads(threads, n),
        )  # fmt: skip
        return Clock(scene, solver, field, part, dt)

    count = scene.frames if frames is None else frames
    state, _ = members.watch(state, matter.m, 0)
    part = members.matter(matter)
    clock = clock_of(part if len(part.m) else matter)
    yield state
    for frame in range(count):
        if len(part.m) == 0:  # everybody has left
            state = dataclasses.replace(state, time=state.time + 1.0 / scene.fps)
            yield state
            continue
        if steer is not None:
            scene, matter = driven()
            part = members.matter(matter)
            clock.steer(scene, part)
        start, now = members.state(state), part
        if dt_ref is not None and mixture.is_plastic:
            step = clock.span(start).dt
            now = dataclasses.replace(part, w_p=rate_gate(part.w_p, field.plastic, step, dt_ref).contiguous())
        end, kept, span, taken = _advance(clock, start, now, frame, keep and grad, gather)
        if grad and frame == 0:
            _say_memory(state, count if window is None else min(window, count), span, segment, keep)
        end = joined(clock, span, {"segment": segment, "kept": kept}, end, start, now, controls) if grad else end
        end = bounded(end)
        if diagnose:
            books = balance(mixture, start, end, now, scene.scheme, scene.gravity, span.dt, scene.dx)
            taken = dataclasses.replace(taken, balance=books)
        taken = dataclasses.replace(taken, expected_dv=members.spread(taken.expected_dv, len(x)))
        state, some_left = members.watch(members.joined(end, state), matter.m, frame)
        if report is not None:
            report.append(dataclasses.replace(taken, gone=members.count, removed=members.removed))
        yield state
        if some_left:
            part = members.matter(matter)
            clock = clock_of(part) if len(part.m) else clock
        if window is not None and (frame + 1) % window == 0:
            state = State(*(None if t is None else t.detach() for t in state.tensors()), state.time)  # type: ignore[arg-type]


def _threads(threads: int | None, particles: int) -> int:
    if threads is not None:
        return threads
    return min(os.cpu_count() or 1, MAX_THREADS) if particles >= THREADED else 1


def _body_of(body: Body | None, members: Members) -> Body | None:
    """The acceleration of those who take part."""
    if body is None or members.rows is None:
        return body
    rows: Tensor = members.rows
    of_all: Callable[[float], Tensor] = body
    return lambda t: of_all(t)[rows]


_told: set[tuple[int, int]] = set()


def _say_memory(state: State, frames: int, span: Span, segment: int | None, keep: bool) -> None:
    """What a backward pass keeps, once for each size of clip: a training loop makes the same one again and again."""
    size, clip = backward_bytes(state, frames, span.steps, segment=segment, keep=keep), (len(state.x), frames)
    level = logging.DEBUG if clip in _told else logging.INFO
    _told.add(clip)
    log.log(
        level, "backward pass: states of %d frames, %d rounds in the first: %.1f MB", *clip[1:], span.steps, size / 1e6
    )


def _advance(
    clock: Clock, state: State, matter: Matter, frame: int, keep: bool, gather: Sequence[Gather]
) -> tuple[State, Rows | None, Span, FrameReport]:
    """The state after a frame, in a block large enough for it and with a step short enough; and the sums of that run
    alone.

    Raises:
        SimulationDiverged: naming quantity, particle, substep, time, value, limit and what to change.
    """
    solver, span = clock.solver, clock.span(state)
    first, grown, halved = span.grid, 0, 0
    while True:
        sums = Sums.zero(gather, state.x.detach(), span.grid.nodes) if gather else None
        end, status, kept = solver.advance(state, matter, span, keep, sums)
        trouble = trouble_of(end, status, span)
        wider = span.grid.grown(4 * 2**grown) if status[LEFT] and grown < GROWTHS else None
        if (
            wider is not None
            and 4 * (2**grown - 1) < span.steps  # nobody crosses more than a cell a substep
            and wider.nodes <= max(ROOM, 8 * first.nodes)
            and (trouble is None or _left_first(solver, state, matter, span))
        ):
            span = dataclasses.replace(span, grid=wider)
            grown += 1
            continue
        if trouble is None and (gone := trouble_of(end, status, span, left=True)) is not None:
            raise blame(clock, state, matter, span, frame, gone)  # as far in shorter substeps
        trouble = trouble or _outrun(clock, end, span)
        if trouble is None:
            taken = (None, None) if sums is None else (sums.expected_dv, sums.impulse)
            part = solver.active(state, span)
            report = FrameReport(
                span.n_sub, span.dt, clock.wave, clock.speed(state), span.grid, grown, halved,
                None if part is None else len(part.nodes), expected_dv=taken[0], impulse=taken[1],
            )  # fmt: skip
            return end, kept, span, report
        if clock.dt is not None or halved == HALVINGS:
            raise blame(clock, state, matter, span, frame, trouble)
        span, grown, halved = dataclasses.replace(clock.halved(span), grid=first), 0, halved + 1


def _left_first(solver: Solver, state: State, matter: Matter, span: Span) -> bool:
    """Whether a particle left the block before anything else went wrong: then that may be all that did. One whose place
    is no number has not left: something went wrong a round before."""
    for _, status, end in solver.watch(state, matter, span):
        if status[LEFT] and bool(torch.isfinite(end.x[status[LEFT] - 1]).all()):
            return True
        if trouble_of(end, status, span) is not None:
            return False
    return False


def _outrun(clock: Clock, end: State, span: Span) -> Trouble | None:
    """Waves that became too fast for the step of a frame."""
    if not clock.outrun(span, end):
        return None
    fast = clock.pace(end)
    p = int(fast.argmax())
    cells = float(fast[p]) * span.dt / span.grid.dx
    return Trouble("carries waves too fast for the substep", p, f"c Δt/Δx = {cells:.4g}, at most 1")
