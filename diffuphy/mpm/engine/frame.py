"""One frame as a node of the autograd graph."""

from typing import Any

import torch
from torch import Tensor

from diffuphy.mpm.controls import Controls
from diffuphy.mpm.engine.clock import Clock
from diffuphy.mpm.engine.solver import Solver
from diffuphy.mpm.engine.trouble import blame_gradient, unbounded
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import Bars, Matter, State


class Frame(torch.autograd.Function):
    """Unless told otherwise only the state at its start is kept, and backward runs its substeps again."""

    @staticmethod
    def forward(ctx: Any, solver: Solver, span: Span, replay: dict[str, Any], end: State, *parts: Tensor | None) -> Any:
        """Hand out ``end``, which the solver made from ``parts``: vol, tag, those of a state, w_e, w_p, θ, m,
        the fastest wave, and those of the controls."""
        ctx.solver, ctx.span, ctx.replay = solver, span, replay
        ctx.save_for_backward(*parts)
        return end.tensors()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        vol, tag, *parts = ctx.saved_tensors
        state, matter = State(*parts[:7]), Matter(*parts[7:11], vol, tag)
        wave, controls = parts[11], Controls(*parts[12:])
        need = ctx.needs_input_grad[17:]
        wanted = {"wave": need[0], "gravity": need[1], "walls": any(need[2:])}
        run = (state, matter, ctx.span)

        def bars() -> Bars:
            return Bars(*(_bar(t, g) for t, g in zip(state.tensors(), grads, strict=True)))

        out = ctx.solver.advance_adjoint(*run, bars(), ctx.needs_input_grad[13:17], **wanted, **ctx.replay)
        if unbounded(out) is not None:
            raise blame_gradient(ctx.solver, *run, bars(), ctx.needs_input_grad[13:17], **wanted)
        span = ctx.span
        alpha, omega = (0.0 if t is None else float(t.sum()) for t in (out.alpha, out.omega))
        wave_bar = wave.new_tensor(span.wave_bar(alpha, omega)) if need[0] else None
        of_state = (out.x, out.v, out.C, out.He, out.H, out.memory, out.HN)
        return (
            (None,) * 6
            + of_state
            + (out.w_e, out.w_p, out.theta, out.m, wave_bar)
            + controls.bars(out.gravity, ctx.solver.wall_gradients(span, out))
        )


def _bar(t: Tensor | None, grad: Tensor | None) -> Tensor | None:
    """A contiguous copy of a gradient, zero where there is none."""
    if t is None:
        return None
    return torch.zeros_like(t) if grad is None else torch.empty_like(t).copy_(grad)


def joined(
    clock: Clock, span: Span, replay: dict[str, Any], end: State, start: State, matter: Matter, controls: Controls
) -> State:
    """``end`` as a function of ``start``, ``matter`` and ``controls``, if anything there wants a gradient."""
    wanted = (*start.tensors(), *matter.tensors()[:4], clock.top, *controls.tensors())
    if not any(t is not None and t.requires_grad for t in wanted):
        return end
    parts = tuple(None if t is None else t.contiguous() for t in wanted)
    return State(*Frame.apply(clock.solver, span, replay, end, matter.vol, matter.tag, *parts), end.time)
