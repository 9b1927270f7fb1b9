"""Warp kernels of the rasteriser: projection, binning, compositing; one source for both devices and precisions."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import torch
import warp as wp
from torch import Tensor

import diffuphy.compiling  # noqa: F401, sets Warp up before it starts


def real_of(dtype: torch.dtype) -> type:
    """Warp scalar type of a torch floating-point type."""
    reals = {torch.float32: wp.float32, torch.float64: wp.float64}
    if dtype not in reals:
        raise ValueError(f"the rasteriser computes in torch.float32 or torch.float64, got {dtype}")
    return reals[dtype]


def array(tensor: Tensor, dtype: Any) -> Any:
    """View of a contiguous tensor as a Warp array of ``dtype`` (a scalar, vector or matrix type), without a copy."""
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False, return_ctype=True)


def spread(work: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``work(start, length)`` on consecutive ranges that cover ``count`` items, each range in a thread of its own.

    A Warp launch on the CPU is a serial loop that releases the GIL, and its atomics are plain additions:
    ``work`` must not let two ranges write one address.
    """
    threads = max(1, min(threads, count, os.cpu_count() or 1))
    edges = [count * k // threads for k in range(threads + 1)]
    if threads == 1:
        work(0, count)
        return
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(work, a, b - a) for a, b in pairwise(edges[1:])]
        work(0, edges[1])
        for other in others:
            other.result()
