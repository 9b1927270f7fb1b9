"""Score distillation of a clip: the exact gradient with one frame's graph in memory, however long the clip is."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.utils.checkpoint import checkpoint

from diffuphy.losses.guidance import Guidance
from diffuphy.losses.sds import sds

Draw = Callable[..., Tensor]
"""Draws one frame (H, W, 3) in [0, 1] from one row of each operand."""


def video_sds(
    guidance: Guidance,
    draw: Draw,
    operands: Sequence[Tensor],
    cond: Any,
    *,
    t: Tensor,
    estimate: Callable[..., Tensor] = sds,
    **settings: Any,
) -> Tensor:
    """Scalar whose gradient with respect to ``operands`` is the score-distillation gradient of the clip they draw.

        z_f = E(R(u_f)),   ∂L/∂z = w(t) (ε̂(z_t; y, t) − ε),   ∂L/∂u_f = (∂R/∂u_f)ᵀ (∂E/∂R)ᵀ ∂L/∂z_f

    Frames meet in the denoiser alone, and score distillation does not differentiate it (Poole et al. 2023, eq. 3). So
    the latents are made without a graph; when their gradient is known, frame by frame is drawn and encoded again, its
    gradient pulled back to its row u_f, and its graph freed: checkpointing (Griewank & Walther 2000) with the frame as
    the unit. Nothing is approximated; frames cost their drawing and encoding twice.

    Args:
        guidance: a prior of layout "clip". Its ``frame_axis`` says whether frames may be encoded alone; if not, they
            are drawn one by one, and the autoencoder's graph is that of the whole clip, made after the denoiser ran.
        draw: draws a frame; must do the same each time and depend on its arguments alone.
        operands: what the frames are drawn from, each of shape (T, ...): row f is frame f.
        cond: what ``guidance.condition(...)`` returned for this clip.
        t: diffusion time in (0, 1), shape (1,).
        estimate: the estimator, with the signature of ``sds``.
        settings: of the estimator: noise, generator, weight.

    Raises:
        ValueError: operands of unequal length or none; latents without the frame axis that the guidance declares;
            something wants a gradient that is no operand.
    """
    return estimate(_given_latents(guidance), clip_latents(guidance, draw, operands), cond, t=t, **settings)


def clip_latents(guidance: Guidance, draw: Draw, operands: Sequence[Tensor]) -> Tensor:
    """z of the clip that ``operands`` draw, without the graph of its frames: backward makes it again, one by one."""
    lengths = {len(o) for o in operands}
    if len(lengths) != 1 or 0 in lengths:
        raise ValueError(
            f"operands must have one row a frame, got lengths {[len(o) for o in operands]}; "
            "give every operand the same frames, at least one"
        )
    axis = getattr(guidance, "frame_axis", None)
    if axis is None:
        clip = _FrameByFrame.apply(draw, 0, *operands)
        return checkpoint(guidance.encode, clip[None], use_reentrant=False, preserve_rng_state=False)

    def latent(*rows: Tensor) -> Tensor:
        z = guidance.encode(draw(*rows)[None, None])
        if z.shape[axis] != 1:
            raise ValueError(
                f"{type(guidance).__name__}.frame_axis = {axis}, but the latents of one frame have shape "
                f"{tuple(z.shape)}; set it to the axis of frames, or to None if the clip must be encoded whole"
            )
        return z.squeeze(axis)

    return _FrameByFrame.apply(latent, axis, *operands)


class _FrameByFrame(torch.autograd.Function):
    """Stack of f(u_1), …, f(u_T) along an axis; what is kept for backward are the rows u alone.

    Not ``torch.utils.checkpoint``, frame by frame: that lets go of the tensors that nodes *save*, while the nodes stay,
    and with them whatever they hold besides, as those of the rasteriser hold their lists of tiles.
    """

    @staticmethod
    def forward(ctx: Any, of_frame: Draw, axis: int, *operands: Tensor) -> Tensor:
        ctx.of_frame, ctx.axis = of_frame, axis
        ctx.save_for_backward(*operands)
        frames = []
        for rows in zip(*operands, strict=True):
            with torch.enable_grad():  # no operand wants a gradient here, so nothing may
                frame = of_frame(*(row.detach() for row in rows))
            if frame.requires_grad:
                raise ValueError(
                    "a frame depends on something that wants a gradient and is no operand, and would not get it; "
                    "make it an operand, or freeze it with requires_grad_(False)"
                )
            frames.append(frame)
        return torch.stack(frames, axis)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:
        operands, wanted = ctx.saved_tensors, ctx.needs_input_grad[2:]
        bars = [torch.empty_like(o) for o, w in zip(operands, wanted, strict=True) if w]
        for f, frame_bar in enumerate(cotangent.unbind(ctx.axis)):
            rows = [o[f].detach().requires_grad_(w) for o, w in zip(operands, wanted, strict=True)]
            for bar, row_bar in zip(bars, _pull(ctx.of_frame, rows, frame_bar), strict=True):
                bar[f] = row_bar
        found = iter(bars)
        return None, None, *(next(found) if w else None for w in wanted)


def _pull(of_frame: Draw, rows: Sequence[Tensor], frame_bar: Tensor) -> tuple[Tensor, ...]:
    """(∂f/∂u)ᵀ ȳ for each row u that wants a gradient; a function of its own, so that the graph ends with it."""
    with torch.enable_grad():
        frame = of_frame(*rows)
    return torch.autograd.grad(frame, [r for r in rows if r.requires_grad], frame_bar, materialize_grads=True)


class _Encoded:
    """A guidance that is given latents instead of pixels: its ``encode`` changes nothing."""

    def __init__(self, guidance: Guidance):
        self._guidance = guidance

    def encode(self, sample: Tensor) -> Tensor:
        return sample

    def __getattr__(self, name: str) -> Any:
        return getattr(self._guidance, name)


def _given_latents(guidance: Guidance) -> Guidance:
    """``guidance`` behind ``_Encoded``, by its own name, since errors name a prior by its type."""
    given: Any = type(type(guidance).__name__, (_Encoded,), {})(guidance)
    return given
