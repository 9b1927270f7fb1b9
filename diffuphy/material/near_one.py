"""Exponential and logarithm near one, to the last digits of a small argument: what strains far below 1 need.

    exponential(x) = eˣ and eˣ − 1, the latter by its series for |x| < ⅓
    log1p(y) = ln(1 + y) = ln u + (y − (u − 1)),   u = 1 + y rounded
    remainder(x) = (eˣ − 1 − x)/x² = Σ_n xⁿ/(n + 2)!

The rounding of u is c = y − (u − 1), exact; it adds c/u ≈ c to the logarithm. c − c/u = c y/u is below one ulp of
ln(1 + y) for y in [−¾, 3], where log1p may be used.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor


def _terms(eps: float) -> int:
    """Terms of the series of ``remainder`` for |x| < 1: the next one, 1/(n + 2)! of ½, is below eps/4."""
    return next(n for n in range(40) if 2 / math.factorial(n + 2) < eps / 4)


@dataclass(frozen=True)
class NearOneFunctions:
    """Warp functions of one precision."""

    exponential: Any
    """x → (eˣ, eˣ − 1)."""
    log1p: Any
    """y → ln(1 + y), y in [−¾, 3]."""
    remainder: Any
    """x → (eˣ − 1 − x)/x²."""


@cache
def build(real: Any) -> NearOneFunctions:
    """The functions for ``wp.float32`` or ``wp.float64``."""
    terms = _terms(2**-23 if real is wp.float32 else 2**-52)

    c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13 = (real(1 / math.factorial(n)) for n in range(2, 14))
    double = real is wp.float64

    @wp.func(module="unique")
    def exponential(x: real):
        if wp.abs(x) >= real(1.0 / 3.0):
            y = wp.exp(x)
            return y, y - real(1.0)
        z = c7  # x^8/8! of x is below 1e-8, x^14/14! below 1e-17
        if wp.static(double):
            z = c7 + x * (c8 + x * (c9 + x * (c10 + x * (c11 + x * (c12 + x * c13)))))
        z = x * (real(1.0) + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * (c6 + x * z))))))
        return real(1.0) + z, z

    @wp.func(module="unique")
    def log1p(y: real) -> real:
        u = real(1.0) + y
        return wp.log(u) + (y - (u - real(1.0)))

    @wp.func(module="unique")
    def remainder(x: real) -> real:
        if wp.abs(x) >= real(1.0):
            return (wp.exp(x) - real(1.0) - x) / (x * x)
        y = real(1.0)
        k = real(terms + 2)
        while k > real(2.5):
            y = real(1.0) + x * y / k
            k = k - real(1.0)
        return real(0.5) * y

    return NearOneFunctions(exponential, log1p, remainder)


def remainder(x: Tensor) -> Tensor:
    """(eˣ − 1 − x)/x² to a few ulp, differentiable at 0."""
    near = torch.where(x.abs() < 1, x, torch.zeros_like(x))
    far = torch.where(x.abs() < 1, torch.ones_like(x), x)
    y = torch.ones_like(x)
    for k in range(_terms(torch.finfo(x.dtype).eps) + 2, 2, -1):
        y = 1 + near * y / k
    return torch.where(x.abs() < 1, y / 2, (torch.expm1(far) - far) / (far * far))
