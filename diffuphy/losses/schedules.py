"""Numbers that change while an optimisation runs, and the noise schedule of the Stable Diffusion family."""

import functools
import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor


class Schedule(Protocol):
    """A number that depends on the step of a run of ``total`` steps."""

    def __call__(self, step: int, total: int) -> float: ...


def _span(steps: int | float, total: int) -> float:
    return steps if isinstance(steps, int) else steps * total


def _check_steps(steps: int | float) -> None:
    if steps <= 0 or (isinstance(steps, float) and steps > 1):
        raise ValueError(f"steps must be a positive integer, or a share of the run in (0, 1], got {steps!r}")


@dataclass(frozen=True)
class Constant:
    """The same number at every step."""

    value: float

    def __call__(self, step: int, total: int) -> float:
        return self.value


@dataclass(frozen=True)
class Step:
    """``start`` until a step, ``end`` from it on."""

    start: float
    end: float
    at: int | float
    """Where it changes: a step (int) or a share of the run (float in (0, 1])."""

    def __post_init__(self) -> None:
        _check_steps(self.at)

    def __call__(self, step: int, total: int) -> float:
        return self.start if step < _span(self.at, total) else self.end


@dataclass(frozen=True)
class Linear:
    """From ``start`` to ``end`` on a straight line, then ``end``."""

    start: float
    end: float
    steps: int | float = 1.0
    """Length of the ramp: a number of steps (int) or a share of the run (float in (0, 1])."""

    def __post_init__(self) -> None:
        _check_steps(self.steps)

    def __call__(self, step: int, total: int) -> float:
        return self.start + (self.end - self.start) * min(1.0, step / _span(self.steps, total))


@dataclass(frozen=True)
class Exponential:
    """From ``start`` to ``end`` on a straight line of logarithms, then ``end``; the usual decay of a learning rate."""

    start: float
    end: float
    steps: int | float = 1.0
    """Length of the ramp: a number of steps (int) or a share of the run (float in (0, 1])."""

    def __post_init__(self) -> None:
        _check_steps(self.steps)
        if self.start <= 0 or self.end <= 0:
            raise ValueError(
                f"an exponential schedule needs positive ends, got {self.start} and {self.end}; use Linear"
            )

    def __call__(self, step: int, total: int) -> float:
        s = min(1.0, step / _span(self.steps, total))
        return math.exp((1 - s) * math.log(self.start) + s * math.log(self.end))


@functools.lru_cache(maxsize=8)
def scaled_linear(n: int = 1000, beta_start: float = 0.00085, beta_end: float = 0.012) -> Tensor:
    """Cumulative signal power ᾱ_k of Stable Diffusion, shape (n,), float64.

        √β_k = √β_0 + k/(n−1) (√β_{n−1} − √β_0),   ᾱ_k = Π_{j≤k} (1 − β_j)

    Rombach et al. (2022), appendix; the numbers are those of ``scheduler/scheduler_config.json`` of Stable Diffusion
    1.5.
    """
    betas = torch.linspace(beta_start**0.5, beta_end**0.5, n, dtype=torch.float64) ** 2
    return torch.cumprod(1 - betas, 0)


def timestep(t: Tensor, n: int) -> Tensor:
    """Index of the discrete step that diffusion time t ∈ (0, 1) falls in: k = ⌊n t⌋ ∈ {0, …, n−1}, int64."""
    return (t * n).long().clamp(0, n - 1)


def variance_preserving(t: Tensor, alpha_bar: Tensor) -> tuple[Tensor, Tensor]:
    """α_t = √ᾱ_k and σ_t = √(1 − ᾱ_k) at k = ⌊n t⌋, each of the shape, dtype and device of ``t``."""
    a = alpha_bar.to(t.device)[timestep(t, len(alpha_bar))]
    return a.sqrt().to(t.dtype), (1 - a).sqrt().to(t.dtype)


def rectified_flow(t: Tensor, shift: float = 1.0) -> tuple[Tensor, Tensor]:
    """α = 1 − σ and σ = s t/(1 + (s − 1) t) of straight paths between sample and noise, each of the shape of ``t``.

    Lipman et al., flow matching (2023); the shift to more noise for large pictures of Esser et al. (2024), eq. 23.
    """
    sigma = shift * t / (1 + (shift - 1) * t)
    return 1 - sigma, sigma


@functools.lru_cache(maxsize=8)
def cosine(n: int = 1024) -> Tensor:
    """Cumulative signal power of a cosine schedule, shape (n,), float64.

        f(s) = cos²((s + 0.008)/1.008 · π/2),   β_k = min(1 − f((k+1)/n)/f(k/n), 0.999),   ᾱ_k = Π_{j≤k} (1 − β_j)

    Nichol & Dhariwal (2021), eq. 17.
    """
    s = torch.arange(n + 1, dtype=torch.float64) / n
    f = torch.cos((s + 0.008) / 1.008 * math.pi / 2) ** 2
    return torch.cumprod(1 - (1 - f[1:] / f[:-1]).clamp(max=0.999), 0)


@functools.lru_cache(maxsize=8)
def linear_betas(n: int = 1024) -> Tensor:
    """ᾱ_k of β from 1e-4 to 2e-2 over 1000 steps, stretched to n: β_k = 1000/n (1e-4 + k/(n−1) (2e-2 − 1e-4)).

    Ho et al. (2020), §4; shape (n,), float64.
    """
    return torch.cumprod(1 - torch.linspace(1e-4, 2e-2, n, dtype=torch.float64) * 1000 / n, 0)
