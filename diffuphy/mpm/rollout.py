"""From particles and a material field to a trajectory: one autograd node a frame, the time step from the material."""

import dataclasses
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.material import make_mixture, rate_gate
from diffuphy.mpm.clock import Clock
from diffuphy.mpm.controls import Controls
from diffuphy.mpm.drive import tags
from diffuphy.mpm.gather import Gather, Sums, check_gather
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.kernels import FAST, INVERTED, LEFT
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.solver import Body, Solver
from diffuphy.mpm.state import (
    REAL,
    Bars,
    Matter,
    Rows,
    Span,
    State,
    check,
    check_state,
    initial_state,
    make_matter,
    placed,
)  # fmt: skip
from diffuphy.types import MaterialField, SimulationDiverged, Trajectory

GROWTHS = 6
"""How often the block of a frame may be enlarged, each time twice as much, before the particles are taken to have
exploded."""

HALVINGS = 4
"""How often the substep of a frame may be halved before its scene is taken to be impossible."""

THREADED = 16384
"""Particles from which on several threads are faster than one."""

MAX_THREADS = 8
"""Most threads that are taken unless told otherwise: each has a copy of the nodes."""


@dataclass(frozen=True)
class FrameReport:
    """What one frame took."""

    n_sub: int
    """Substeps."""
    dt: float
    """Length of one [s]."""
    wave: float
    """Fastest wave c at rest [m/s]."""
    speed: float
    """Bound V on the speed of a particle [m/s]."""
    grid: Grid
    """Block of nodes."""
    reruns: int
    """How often it was enlarged because particles left it."""
    halvings: int = 0
    """How often the substep was halved because waves became too fast for it."""
    expected_dv: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)
    """Velocity change of each particle by stress and gravity, shape (N, 3) [m/s], if gathered; see ``mpm.gather``."""
    impulse: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)
    """Impulse of all walls on the body, shape (3,) [N s], if gathered."""


class Frame(torch.autograd.Function):
    """One frame as a node of the graph. Unless told otherwise only the state at its start is kept, and backward runs
    its substeps again."""

    @staticmethod
    def forward(ctx: Any, solver: Solver, span: Span, replay: dict[str, Any], end: State, *parts: Tensor | None) -> Any:
        """Hand out ``end``, which the solver made from ``parts``: vol, tag, those of a state, w_e, w_p, θ, m, and
        the fastest wave, and those of the controls."""
        ctx.solver, ctx.span, ctx.replay = solver, span, replay
        ctx.save_for_backward(*parts)
        return end.tensors()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        vol, tag, *parts = ctx.saved_tensors
        state, matter, wave, controls = parts[:7], parts[7:11], parts[11], Controls(*parts[12:])
        need = ctx.needs_input_grad[17:]
        out = ctx.solver.advance_adjoint(
            State(*state),
            Matter(*matter, vol, tag),
            ctx.span,
            Bars(*(_bar(t, g) for t, g in zip(state, grads, strict=True))),
            ctx.needs_input_grad[13:17],
            wave=need[0],
            gravity=need[1],
            walls=any(need[2:]),
            **ctx.replay,
        )
        alpha, omega = (0.0 if t is None else float(t.sum()) for t in (out.alpha, out.omega))
        wave_bar = wave.new_tensor(ctx.span.wave_bar(alpha, omega)) if need[0] else None
        of_state = (out.x, out.v, out.C, out.He, out.H, out.memory, out.HN)
        return (
            (None,) * 6
            + of_state
            + (out.w_e, out.w_p, out.theta, out.m, wave_bar)
            + controls.bars(out.gravity, out.walls)
        )


def _bar(t: Tensor | None, grad: Tensor | None) -> Tensor | None:
    """A contiguous copy of a gradient, zero where there is none."""
    if t is None:
        return None
    return torch.zeros_like(t) if grad is None else torch.empty_like(t).copy_(grad)


def rollout(scene: Scene, x: Tensor, vol: Tensor, field: MaterialField, **options: Any) -> Trajectory:
    """The film of :func:`simulate`, whose options it takes; frame 0 is the initial state.

    Differentiable in ``x``, ``velocity``, ``field.w_e``, ``field.w_p``, every ``field.theta`` and ``field.rho`` with
    ``grad=True``: the gradient is that of the discrete scheme, with the number of substeps and the shift that
    ``scene.lift`` makes held fixed.
    """
    states = list(simulate(scene, x, vol, field, **options))
    x, v, F = (torch.stack([getattr(s, name) for s in states]) for name in ("x", "v", "F"))
    return Trajectory(x, v, F, scene.fps)


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
    report: list[FrameReport] | None = None,
    gather: Sequence[Gather] = (),
    scenes: int = 1,
    threads: int | None = None,
) -> Iterator[State]:
    """The states at the frames of a scene, one after the other, the initial one first.

    Args:
        x: positions at rest, shape (N, 3) [m]; their precision is that of the simulation.
        vol: rest volumes, shape (N,) [m³].
        field: laws, weights, parameters and densities of the N particles.
        frames: number of frames, ``scene.frames`` if None.
        grad: keep what the backward pass needs: the state at each frame.
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
        report: a list to which the report of each frame is appended.
        gather: sums over substeps that the reports then hold, "expected_dv" or "impulse" or both: constants of the
            graph, taken in the forward pass. What is not asked for costs nothing.
        scenes: how many scenes with the same number of particles the tensors hold one after the other; they do not
            touch and share Δt and the block of nodes. See ``rollout_batch``.
        threads: threads that work on a CPU, by default one for every core if there are THREADED particles or more. The
            result depends on their number by rounding only, and on nothing else.

    Raises:
        ValueError: shapes, precisions or values that make no simulation; an unstable ``dt``.
        SimulationDiverged: a particle with a state that means nothing; the message names it.
    """
    scene = controls.applied(scene)
    check(x, vol, field)
    check_gather(gather)
    _check_options(gather, report, segment, scenes, len(x), threads)
    mixture = make_mixture(tuple(field.elastic), tuple(field.plastic), REAL[x.dtype], tuple(field.branches))
    matter = make_matter(field, vol, mixture.params, x.dtype, grad)
    if state is None:
        state = initial_state(
            scene,
            x if grad else x.detach(),
            matter,
            mixture,
            velocity if grad or velocity is None else velocity.detach(),
            scenes,
        )
    else:
        check_state(state, mixture)
    if scene.drives:
        matter = dataclasses.replace(
            matter, tag=tags(scene.drives, placed(scene, x, matter.vol).detach(), matter.m.detach())
        )
    solver = Solver(
        mixture, scene.boundaries, scene.gravity, x.dtype, x.device, particles=len(x) // scenes, dx=scene.dx,
        scheme=scene.scheme, drives=scene.drives, body=body, gather=gather, grad=grad, scenes=scenes,
        threads=_threads(threads, len(x)),
    )  # fmt: skip
    clock = Clock(scene, solver, field, matter, dt)
    yield state
    for frame in range(scene.frames if frames is None else frames):
        now = matter
        if dt_ref is not None and mixture.is_plastic:
            step = clock.span(state).dt
            now = dataclasses.replace(matter, w_p=rate_gate(matter.w_p, field.plastic, step, dt_ref).contiguous())
        end, kept, span, taken = _advance(clock, state, now, frame, keep and grad, gather)
        if report is not None:
            report.append(taken)
        replay = {"segment": segment, "kept": kept}
        state = _node(clock, span, replay, end, state, now, controls) if grad else end
        yield state


def _check_options(
    gather: Sequence[str], report: Any, segment: int | None, scenes: int, particles: int, threads: int | None
) -> None:
    if gather and report is None:
        raise ValueError(f"gather = {tuple(gather)} fills the reports of frames; give a list as report")
    if segment is not None and segment < 1:
        raise ValueError(f"segment must be at least 1 substep, got {segment}")
    if scenes < 1 or particles % scenes:
        raise ValueError(f"scenes must divide the number of particles, got scenes = {scenes} and {particles} particles")
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")


def _threads(threads: int | None, particles: int) -> int:
    if threads is not None:
        return threads
    return min(os.cpu_count() or 1, MAX_THREADS) if particles >= THREADED else 1


def _node(
    clock: Clock, span: Span, replay: dict[str, Any], end: State, start: State, matter: Matter, controls: Controls
) -> State:
    """``end`` as a function of ``start``, ``matter`` and ``controls``, if anything there wants a gradient."""
    wanted = (*start.tensors(), *matter.tensors()[:4], clock.top, *controls.tensors())
    if not any(t is not None and t.requires_grad for t in wanted):
        return end
    parts = tuple(None if t is None else t.contiguous() for t in wanted)
    return State(*Frame.apply(clock.solver, span, replay, end, matter.vol, matter.tag, *parts), end.time)


def _advance(
    clock: Clock, state: State, matter: Matter, frame: int, keep: bool, gather: Sequence[Gather]
) -> tuple[State, Rows | None, Span, FrameReport]:
    """The state after a frame, in a block large enough for it and with a step short enough; and the sums of that run
    alone.

    Raises:
        SimulationDiverged: naming particle, frame, place, speed, CFL number and what to change.
    """
    solver, span = clock.solver, clock.span(state)
    grown = halved = 0
    while True:
        sums = Sums.zero(gather, state.x.detach(), span.grid.nodes) if gather else None
        end, status, kept = solver.advance(state, matter, span, keep, sums)
        trouble = _trouble(end, status)
        if trouble is None and status[LEFT] and grown < GROWTHS:
            span = dataclasses.replace(span, grid=span.grid.grown(4 * 2**grown))
            grown += 1
            continue
        if trouble is None and status[LEFT]:
            trouble = ("left every block of nodes", status[LEFT] - 1)
        if trouble is None and not (clock.outrun(span, end) and halved < HALVINGS):
            taken = (None, None) if sums is None else (sums.expected_dv, sums.impulse)
            speed = clock.speed(state)
            report = FrameReport(span.n_sub, span.dt, clock.wave, speed, span.grid, grown, halved, *taken)
            return end, kept, span, report
        if clock.dt is not None or halved == HALVINGS:
            assert trouble is not None
            raise _diverged(*trouble, state, end, span, frame, clock.rest)
        span, halved = clock.halved(span), halved + 1


def _trouble(end: State, status: list[int]) -> tuple[str, int] | None:
    """What went wrong in a frame, and with which particle."""
    if status[INVERTED]:
        return "was turned inside out (det F ≤ 0)", status[INVERTED] - 1
    if status[FAST]:
        return "crossed more than one cell in a substep", status[FAST] - 1
    finite = torch.isfinite(end.x).all(1) & torch.isfinite(end.v).all(1) & torch.isfinite(end.He).flatten(1).all(1)
    return None if bool(finite.all()) else ("is not finite", int((~finite).nonzero()[0]))


def _diverged(what: str, p: int, start: State, end: State, span: Span, frame: int, c: Tensor) -> SimulationDiverged:
    v = float(end.v[p].norm())
    cfl = span.dt * (float(c[p]) + (v if math.isfinite(v) else float(start.v[p].norm()))) / span.grid.dx
    return SimulationDiverged(
        f"particle {p} {what} in frame {frame} (t = {span.start:.4g} … {span.end:.4g} s): x = {_text(end.x[p])} m, "
        f"|v| = {v:.3g} m/s, "
        f"at the start of the frame x = {_text(start.x[p])} m, |v| = {float(start.v[p].norm()):.3g} m/s; Δt = "
        f"{span.dt:.3g} s, CFL = {cfl:.2f}; "
        "lower cfl or dx, slow the walls or the object down, or use a material that resists compression (hencky, "
        "neo_hookean) or a larger E"
    )


def _text(x: Tensor) -> str:
    return "(" + ", ".join(f"{float(a):.4g}" for a in x) + ")"
