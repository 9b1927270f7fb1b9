"""From particles and a material field to a trajectory: one autograd node a frame, the time step from the material.

    n_sub = ⌈T / min( cfl Δx / (c + V),  0.8 Δx / (s c + V) )⌉,      T = 1/fps

c is the fastest wave of the mixture at rest, V bounds the speed of a particle in the frame, s ≥ 1 says how much faster
waves run in the present stretch. The number depends on the material, so it is found again for every frame; it is not
differentiated.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.material import make_mixture, rate_gate, wave_speed
from diffuphy.mpm.gather import Gather, Sums, check_gather
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.kernels import FAST, INVERTED, LEFT
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.solver import Solver
from diffuphy.mpm.state import REAL, Matter, Rows, Span, State, check, initial_state, make_matter, stretches
from diffuphy.types import MaterialField, SimulationDiverged, Trajectory

STABLE = 0.8
"""Largest Δt (c + |v|) / Δx of an explicit step that is stable for all laws of the library [-]."""

GROWTHS = 6
"""How often the block of a frame may be enlarged, each time twice as much, before the particles are taken to have
exploded."""

MAX_SUBSTEPS = 10**6
"""Substeps of one frame beyond which a scene is refused: it is stiffer than an explicit step can film."""


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
    expected_dv: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)
    """Velocity change of each particle by stress and gravity, shape (N, 3) [m/s], if gathered; see ``mpm.gather``."""
    impulse: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)
    """Impulse of all walls on the body, shape (3,) [N s], if gathered."""


class Frame(torch.autograd.Function):
    """One frame as a node of the graph. Unless told otherwise only the state at its start is kept, and backward runs
    its substeps again."""

    @staticmethod
    def forward(
        ctx: Any, solver: Solver, span: Span, replay: dict[str, Any], end: State, vol: Tensor,
        x: Tensor, v: Tensor, C: Tensor, He: Tensor, H: Tensor | None, log_J: Tensor | None,
        w_e: Tensor, w_p: Tensor, theta: Tensor, m: Tensor,
    ) -> tuple[Tensor | None, ...]:  # fmt: skip
        """Hand out ``end``, which the solver made from the other arguments."""
        ctx.solver, ctx.span, ctx.replay = solver, span, replay
        ctx.save_for_backward(x, v, C, He, H, log_J, w_e, w_p, theta, m, vol)
        return end.x, end.v, end.C, end.He, end.H, end.log_J

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        *state, w_e, w_p, theta, m, vol = ctx.saved_tensors
        bars = [_bar(t, g) for t, g in zip(state, grads, strict=True)]
        start, matter = ctx.solver.advance_adjoint(
            State(*state),
            Matter(w_e, w_p, theta, m, vol),
            ctx.span,
            State(*bars),
            ctx.needs_input_grad[11:15],
            **ctx.replay,
        )
        return (None, None, None, None, None, start.x, start.v, start.C, start.He, start.H, start.log_J, *matter)


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
    dt: float | None = None,
    dt_ref: float | None = None,
    segment: int | None = None,
    keep: bool = False,
    report: list[FrameReport] | None = None,
    gather: Sequence[Gather] = (),
) -> Iterator[State]:
    """The states at the frames of a scene, one after the other, the initial one first.

    Args:
        x: positions at rest, shape (N, 3) [m]; their precision is that of the simulation.
        vol: rest volumes, shape (N,) [m³].
        field: laws, weights, parameters and densities of the N particles.
        frames: number of frames, ``scene.frames`` if None.
        grad: keep what the backward pass needs: the state at each frame.
        state: go on from this one instead of from the scene's initial state; ``x`` is then not read.
        velocity: added to the initial velocity of the scene, shape (N, 3) or (3,) [m/s].
        dt: pin the substep to at most this [s]; refused if it is unstable.
        dt_ref: time over which partial plastic weights are meant [s], see ``material.rate_gate``; None takes them
            per substep. One-hot weights are the same either way.
        segment: substeps that the backward pass keeps at a time; the gradient does not depend on it.
        keep: store every substep for the backward pass instead of running it again: 96 bytes a particle and substep in
            float32 (132 with plasticity) for a fifth of the time of forward and backward.
        report: a list to which the report of each frame is appended.
        gather: sums over substeps that the reports then hold, "expected_dv" or "impulse" or both: constants of the
            graph, taken in the forward pass by two kernels and by one. What is not asked for costs nothing.

    Raises:
        ValueError: shapes, precisions or values that make no simulation; an unstable ``dt``.
        SimulationDiverged: a particle with a state that means nothing; the message names it.
    """
    check(x, vol, field)
    check_gather(gather)
    if gather and report is None:
        raise ValueError(f"gather = {tuple(gather)} fills the reports of frames; give a list as report")
    if segment is not None and segment < 1:
        raise ValueError(f"segment must be at least 1 substep, got {segment}")
    mixture = make_mixture(tuple(field.elastic), tuple(field.plastic), REAL[x.dtype])
    matter = make_matter(field, vol, mixture.params, x.dtype, grad)
    solver = Solver(mixture, scene.boundaries, scene.gravity, x.dtype, x.device)
    c = wave_speed(
        tuple(field.elastic),
        matter.w_e.detach(),
        dict(zip(mixture.params, matter.theta.detach().T, strict=True)),
        matter.m.detach() / matter.vol,
    )
    if state is None:
        state = initial_state(
            scene,
            x if grad else x.detach(),
            matter.m,
            mixture,
            velocity if grad or velocity is None else velocity.detach(),
        )
    elif bool((bad := torch.linalg.det(state.He.detach() + torch.eye(3).to(state.He)) <= 0).any()):
        raise ValueError(
            f"det F of particle {int(bad.nonzero()[0])} is not positive in the state to go on from; a body cannot be "
            "inside out"
        )
    elif mixture.volumetric_memory and state.log_J is None:
        raise ValueError(
            f"the laws {field.plastic} read ln J, and the state to go on from has none; start from one of theirs"
        )
    yield state
    for frame in range(scene.frames if frames is None else frames):
        span, speed = _span(scene, state, c, dt)
        now = matter
        if dt_ref is not None and mixture.is_plastic:
            now = dataclasses.replace(matter, w_p=rate_gate(matter.w_p, field.plastic, span.dt, dt_ref).contiguous())
        end, kept, span, reruns, sums = _advance(solver, state, now, span, frame, c, keep and grad, gather)
        if report is not None:
            taken = (None, None) if sums is None else (sums.expected_dv, sums.impulse)
            report.append(FrameReport(span.n_sub, span.dt, float(c.max()), speed, span.grid, reruns, *taken))
        replay = {"segment": segment, "kept": kept}
        state = _node(solver, span, replay, end, state, now) if grad else end
        yield state


def _node(solver: Solver, span: Span, replay: dict[str, Any], end: State, start: State, matter: Matter) -> State:
    """``end`` as a function of ``start`` and ``matter``, if anything there wants a gradient."""
    parts = (start.x, start.v, start.C, start.He, start.H, start.log_J, matter.w_e, matter.w_p, matter.theta, matter.m)
    if not any(t is not None and t.requires_grad for t in parts):
        return end
    parts = tuple(None if t is None else t.contiguous() for t in parts)
    return State(*Frame.apply(solver, span, replay, end, matter.vol, *parts), end.time)


def _span(scene: Scene, state: State, c: Tensor, dt: float | None) -> tuple[Span, float]:
    """Time step and block of the next frame; and the bound on the speed."""
    T, dx = 1.0 / scene.fps, scene.dx
    x, v, He = state.x.detach(), state.v.detach(), state.He.detach()
    ends = x.amin(0).tolist(), x.amax(0).tolist()
    speed = (
        float(v.norm(dim=1).max())
        + math.hypot(*scene.gravity) * T
        + max((b.speed_within(*ends, state.time) for b in scene.boundaries), default=0.0)
    )
    low, high = stretches(He)
    # Waves in space run at c s in extension and c √(1 + |ln s|) in compression, for every elastic law of the library
    # or slower;
    # the closed form of s has no digits below 1e-3 in float32, and the root hardly grows there.
    stiff = float((c * torch.maximum(high, (1 - low.clamp(1e-3, 1).log()).sqrt())).max())
    limit = STABLE * dx / (stiff + speed)
    if dt is not None and T / math.ceil(T / dt) > limit:
        raise ValueError(
            f"dt = {dt:.3g} s is unstable: waves of {stiff:.3g} m/s and particles of up to {speed:.3g} m/s cross "
            f"more than {STABLE} cells "
            f"of {dx:.3g} m in it; use at most {limit:.3g} s, or leave dt out"
        )
    step = min(scene.cfl * dx / (float(c.max()) + speed), limit) if dt is None else dt
    if not step > 0 or T / step > MAX_SUBSTEPS:
        raise (ValueError if state.time == 0.0 else SimulationDiverged)(
            f"the frame at t = {state.time:.4g} s would take {T / step if step > 0 else math.inf:.3g} substeps: "
            f"waves run at {stiff:.3g} m/s through cells of {dx:.3g} m; "
            "use a softer or denser material, a larger dx, or a higher fps"
        )
    n_sub = math.ceil(T / step)
    g = torch.tensor(scene.gravity, dtype=torch.float64)
    slack = dx + 0.25 * speed * T
    down = (x.amin(0).cpu() + (v.amin(0).cpu().clamp_max(0) * T + g.clamp_max(0) * T * T / 2)).double() - slack
    up = (x.amax(0).cpu() + (v.amax(0).cpu().clamp_min(0) * T + g.clamp_min(0) * T * T / 2)).double() + slack
    return Span(Grid.around(down.tolist(), up.tolist(), dx), state.time, T / n_sub, n_sub), speed


def _advance(
    solver: Solver,
    state: State,
    matter: Matter,
    span: Span,
    frame: int,
    c: Tensor,
    keep: bool,
    gather: Sequence[Gather],
) -> tuple[State, Rows | None, Span, int, Sums | None]:
    """The state after a frame, in a block large enough for it, and the sums of that run alone.

    Raises:
        SimulationDiverged: naming particle, frame, place, speed, CFL number and what to change.
    """
    for reruns in range(GROWTHS + 1):
        sums = Sums.zero(gather, state.x.detach(), span.grid.nodes) if gather else None
        end, status, kept = solver.advance(state, matter, span, keep, sums)
        finite = torch.isfinite(end.x).all(1) & torch.isfinite(end.v).all(1) & torch.isfinite(end.He).flatten(1).all(1)
        if not bool(finite.all()):
            _diverged("is not finite", int((~finite).nonzero()[0]), state, end, span, frame, c)
        if status[INVERTED]:
            _diverged("was turned inside out (det F ≤ 0)", status[INVERTED] - 1, state, end, span, frame, c)
        if status[FAST]:
            _diverged("crossed more than one cell in a substep", status[FAST] - 1, state, end, span, frame, c)
        if not status[LEFT]:
            return end, kept, span, reruns, sums
        left = status[LEFT] - 1
        span = dataclasses.replace(span, grid=span.grid.grown(4 * 2**reruns))
    _diverged("left every block of nodes", left, state, end, span, frame, c)
    raise AssertionError


def _diverged(what: str, p: int, start: State, end: State, span: Span, frame: int, c: Tensor) -> None:
    v = float(end.v[p].norm())
    cfl = span.dt * (float(c[p]) + (v if math.isfinite(v) else float(start.v[p].norm()))) / span.grid.dx
    raise SimulationDiverged(
        f"particle {p} {what} in frame {frame} (t = {span.start:.4g} … {span.end:.4g} s): x = {_text(end.x[p])} m, "
        f"|v| = {v:.3g} m/s, "
        f"at the start of the frame x = {_text(start.x[p])} m, |v| = {float(start.v[p].norm()):.3g} m/s; Δt = "
        f"{span.dt:.3g} s, CFL = {cfl:.2f}; "
        "lower cfl or dx, slow the walls or the object down, or use a material that resists compression (hencky, "
        "neo_hookean) or a larger E"
    )


def _text(x: Tensor) -> str:
    return "(" + ", ".join(f"{float(a):.4g}" for a in x) + ")"
