"""Score distillation of a clip: the exact gradient with one frame's graph in memory, however long the clip is."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffuphy.losses.guidance import Guidance
from diffuphy.losses.sds import inject, score

Draw = Callable[..., Tensor]
"""Draws one frame (H, W, 3) in [0, 1] from one row of each operand."""


def video_sds(
    guidance: Guidance, draw: Draw, operands: Sequence[Tensor], cond: Any, *, t: Tensor, **settings: Any
) -> Tensor:
    """Scalar whose gradient with respect to ``operands`` is the score-distillation gradient of the clip they draw.

        z = E(R(u_1), …, R(u_T)),   ∂L/∂u_f = (∂R/∂u_f)ᵀ (∂E/∂R_f)ᵀ w(t) (ε̂(z_t; y, t) − ε)

    Frames meet in the denoiser alone, and score distillation does not differentiate it (Poole et al. 2023, eq. 3). So
    the latents are made without a graph; when their gradient is known, each frame is encoded and drawn again, its
    gradient pulled back to its row u_f, and its graph freed: checkpointing (Griewank & Walther 2000) with the frame as
    the unit. Nothing is approximated; frames cost their drawing and encoding twice.

    Args:
        guidance: a prior of layout "clip". If it declares ``frames_alone``, frames are encoded one by one; if not, the
            clip is encoded whole, once more after the denoiser ran. Drawn they are one by one in any case.
        draw: draws a frame; must do the same each time and depend on its arguments alone.
        operands: what the frames are drawn from, each of shape (T, ...): row f is frame f.
        cond: what ``guidance.condition(...)`` returned for this clip.
        t: diffusion time in (0, 1), shape (1,).
        settings: of ``sds``: noise, generator, weight, estimator.

    Raises:
        ValueError: operands of unequal length or none; a frame depends on something that wants a gradient and is no
            operand; what ``sds`` refuses.
        FloatingPointError: as ``sds``.
    """
    z = clip_latents(guidance, draw, operands)
    gradient, value = score(guidance, z.detach(), cond, t=t, **settings)
    return inject(z, gradient, value)


def by_frames(f: Callable[..., Tensor], *operands: Tensor) -> Tensor:
    """f of each frame's operands, stacked, with the graph of none of them: backward makes them one by one.

    Args:
        f: of one row of each operand; what it depends on besides gets no gradient.
        operands: one row a frame.
    """
    return _OneByOne.apply(f, *operands)  # type: ignore[return-value]


def clip_latents(guidance: Guidance, draw: Draw, operands: Sequence[Tensor]) -> Tensor:
    """z of the clip that ``operands`` draw, with the graph of none of its frames: backward makes them one by one."""
    if len({len(o) for o in operands}) != 1 or len(operands[0]) == 0:
        raise ValueError(
            f"operands must have one row a frame, got lengths {[len(o) for o in operands]}; "
            "give every operand the same frames, at least one"
        )
    clips = _OneByOne.apply(draw, *operands)[None]
    if getattr(guidance, "frames_alone", False):
        return guidance.encode(clips)
    return _OneByOne.apply(lambda clip: guidance.encode(clip[None])[0], clips)


class _OneByOne(torch.autograd.Function):
    """f(u_1), …, f(u_T), stacked; what is kept for backward are the rows u alone.

    Not ``torch.utils.checkpoint``: that lets go of the tensors that nodes *save*, while the nodes stay, and with them
    whatever they hold besides, as those of the rasteriser hold their lists of tiles.
    """

    @staticmethod
    def forward(ctx: Any, f: Callable[..., Tensor], *operands: Tensor) -> Tensor:
        ctx.f = f
        ctx.save_for_backward(*operands)
        found = []
        for rows in zip(*operands, strict=True):
            with torch.enable_grad():  # no operand wants a gradient here, so nothing may
                found.append(f(*(row.detach() for row in rows)))
            if found[-1].requires_grad:
                raise ValueError(
                    "a frame depends on something that wants a gradient and is no operand, and would not get it; "
                    "make it an operand, or freeze it with requires_grad_(False)"
                )
        return torch.stack(found)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:
        operands, wanted = ctx.saved_tensors, ctx.needs_input_grad[1:]
        bars = [torch.empty_like(o) for o, w in zip(operands, wanted, strict=True) if w]
        for i, found_bar in enumerate(cotangent):
            rows = [o[i].detach().requires_grad_(w) for o, w in zip(operands, wanted, strict=True)]
            for bar, row_bar in zip(bars, _pull(ctx.f, rows, found_bar), strict=True):
                bar[i] = row_bar
        left = iter(bars)
        return None, *(next(left) if w else None for w in wanted)


def _pull(f: Callable[..., Tensor], rows: Sequence[Tensor], found_bar: Tensor) -> tuple[Tensor, ...]:
    """(∂f/∂u)ᵀ ȳ for each row u that wants a gradient; a function of its own, so that the graph ends with it."""
    with torch.enable_grad():
        found = f(*rows)
    return torch.autograd.grad(found, [r for r in rows if r.requires_grad], found_bar, materialize_grads=True)
