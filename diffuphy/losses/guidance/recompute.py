"""Rows computed one by one, and once more in the backward pass: the memory of one row for any number of them."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import torch
from torch import Tensor


class Recomputed(torch.autograd.Function):
    """f of each row alone: no graph is kept; the backward pass computes f once more, row by row.

    Unlike ``torch.utils.checkpoint`` it has the module at hand *during* the backward pass of each row, so that a module
    may live elsewhere between uses.

    Args of ``apply``:
        rows: shape (n, ...).
        f: ``f(module, row) -> Tensor``.
        use: a context that yields the module, ready to compute.
    """

    @staticmethod
    def forward(
        ctx: Any, rows: Tensor, f: Callable[[Any, Tensor], Tensor], use: Callable[[], AbstractContextManager[Any]]
    ) -> Tensor:
        ctx.save_for_backward(rows)
        ctx.f, ctx.use = f, use
        with use() as module:
            return torch.stack([f(module, row) for row in rows])

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        (rows,) = ctx.saved_tensors
        gradients = []
        with torch.enable_grad(), ctx.use() as module:
            for row, g in zip(rows, upstream, strict=True):
                x = row.detach().requires_grad_()
                gradients.append(torch.autograd.grad(ctx.f(module, x), x, g)[0])
        return torch.stack(gradients), None, None
