"""From features of a particle to its material: gates on the simplex and parameters inside their bounds.

Everything is an offset from a *start*: the head's last layer is zero at first, so the first field is the start itself.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, Protocol

import torch
from torch import Tensor, nn

from diffuphy.types import MaterialField

GateName = Literal["softmax", "sparsemax", "start"]

MARGIN = 0.01
"""A learnt parameter starts at least this fraction of its (log-)range from both ends, where the sigmoid still moves."""


SATURATED = 1e-6
"""Fraction of the range from its ends below which u_0 counts as being this far away: its logit must be finite."""


class Bounds(Protocol):
    """What the decoder asks of a parameter; ``diffuphy.material.expert.Param`` has it."""

    @property
    def name(self) -> str: ...
    @property
    def lo(self) -> float: ...
    @property
    def hi(self) -> float: ...
    @property
    def log(self) -> bool: ...


def sparsemax(logits: Tensor) -> Tensor:
    """The nearest point of the simplex, with exact zeros.

        w = argmin_{w ∈ Δ} |w − z|² = max(z − τ, 0),   Σ w = 1

    Martins & Astudillo (2016), algorithm 1. The gradient is exact: J = diag(s) − s sᵀ/|s|, s the indicator of w > 0;
    so logits that lead by 1 or more have none. Half precision is computed in float32 and rounded: its own sums would
    not find the support.

    Args:
        logits: shape (..., K).
    """
    if logits.dtype in (torch.float16, torch.bfloat16):
        return sparsemax(logits.float()).to(logits.dtype)
    z = logits.sort(-1, descending=True).values
    excess = z.cumsum(-1) - 1
    k = torch.arange(1, z.shape[-1] + 1, device=z.device)
    support = (k * z > excess).sum(-1, keepdim=True)
    tau = excess.gather(-1, support - 1) / support
    return (logits - tau).clamp(min=0)


def gate(logits: Tensor, kind: GateName) -> Tensor:
    """Weights on the simplex from logits (paper eq. 9 for ``softmax``), shape (..., K); not for ``start``."""
    return sparsemax(logits) if kind == "sparsemax" else torch.softmax(logits, -1)


def bounded(param: Bounds, start: Tensor, o: Tensor, gain: float) -> Tensor:
    """A parameter moved from its start by a network output, never leaving its bounds.

        c(θ) = c(θ_0) + (c(hi) − c(lo)) · (σ(g o + logit u_0) − u_0),   u_0 = (c(θ_0) − c(lo)) / (c(hi) − c(lo))

    with c = ln for a logarithmic parameter and the identity otherwise. Written as a change, so o = 0 returns ``start``
    bit by bit.

    Args:
        start: θ_0 within the bounds, shape (N,), unit of the parameter; at a bound it can hardly move, but is not lost.
        o: network output, shape (N,).
        gain: g [-].
    """
    lo, hi = _ends(param)
    logit = torch.logit(_fraction(param, start), eps=SATURATED)
    change = (hi - lo) * (torch.sigmoid(gain * o + logit) - torch.sigmoid(logit))
    value = start * change.exp() if param.log else start + change
    rounding = (
        value.clamp(param.lo, param.hi) - value
    )  # the formula stays inside, its rounding may not; not differentiated
    return value + rounding.detach()


def inside(params: Sequence[Bounds], theta: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """θ with the values of ``params`` moved into the inner 98 % of their (log-)range; other parameters unchanged.

    A sigmoid cannot start at its own end. Calling this is a decision: the start is then no longer the given value.
    """
    moved = dict(theta)
    for p in params:
        moved[p.name] = theta[p.name].clamp(*_inner(p))
    return moved


def coordinate(p: Bounds, value: Tensor) -> Tensor:
    """A parameter on a scale where equal steps mean equally much: log10 of a logarithmic one, the others over their
    range."""
    return value.log10() if p.log else (value - p.lo) / (p.hi - p.lo)


def _ends(p: Bounds) -> tuple[float, float]:
    return (math.log(p.lo), math.log(p.hi)) if p.log else (p.lo, p.hi)


def _fraction(p: Bounds, value: Tensor) -> Tensor:
    """Place of a value in the (log-)range, 0 at ``lo`` and 1 at ``hi``."""
    lo, hi = _ends(p)
    return ((value.log() if p.log else value) - lo) / (hi - lo)


def _inner(p: Bounds) -> tuple[float, float]:
    lo, hi = _ends(p)
    a, b = lo + MARGIN * (hi - lo), hi - MARGIN * (hi - lo)
    return (math.exp(a), math.exp(b)) if p.log else (a, b)


class Decoder(nn.Module):
    """Features of each point and a start field → a material field.

        w = gate(b w_0 + g_w o_w),   θ = bounded(θ_0, o_θ),   o = head(features)

    A one-hot start w_0 puts the bias b on that expert; a uniform start puts nothing anywhere. A gate of one expert and
    parameters that are not learnt take no part in the network and pass through unchanged, ``rho`` always does.

    Args:
        channels: features per point.
        width: hidden width of the head.
        elastic, plastic: names of the candidate experts.
        params: the learnt parameters, with their bounds.
        kind: ``softmax``, ``sparsemax`` for exact zeros, or ``start``, which leaves the weights as they are.
        bias: b, head start of the start's expert [-]; a softmax begins at e^b / (e^b + K − 1) on a one-hot start.
        gate_gain, param_gain: slopes of the outputs [-].

    Raises:
        ValueError: if there is nothing to learn.
    """

    def __init__(
        self,
        channels: int,
        width: int,
        elastic: Sequence[str],
        plastic: Sequence[str],
        params: Sequence[Bounds],
        *,
        kind: GateName = "softmax",
        bias: float = 8.0,
        gate_gain: float = 3.0,
        param_gain: float = 2.0,
    ):
        super().__init__()
        self.elastic, self.plastic, self.params = tuple(elastic), tuple(plastic), tuple(params)
        self.kind, self.bias, self.gate_gain, self.param_gain = kind, bias, gate_gain, param_gain
        free = [len(e) if len(e) > 1 and kind != "start" else 0 for e in (self.elastic, self.plastic)]
        self.split = [*free, len(self.params)]
        if not sum(self.split):
            raise ValueError(
                f"nothing to learn: one elastic expert {self.elastic}, one plastic {self.plastic} and no parameter; "
                "give a second candidate or a parameter, or leave the network out"
            )
        self.head = nn.Sequential(nn.Linear(channels, width), nn.GELU(), nn.Linear(width, sum(self.split)))

    def forward(self, features: Tensor, start: MaterialField) -> MaterialField:
        """Features (N, channels) and the start of the same N points → their field."""
        o_e, o_p, o_theta = self.head(features).split(self.split, -1)
        theta = dict(start.theta)
        for i, p in enumerate(self.params):
            theta[p.name] = bounded(p, start.theta[p.name], o_theta[:, i], self.param_gain)
        return replace(start, w_e=self._weights(start.w_e, o_e), w_p=self._weights(start.w_p, o_p), theta=theta)

    def _weights(self, start: Tensor, o: Tensor) -> Tensor:
        return gate(self.bias * start + self.gate_gain * o, self.kind) if o.shape[-1] else start

    def check(self, start: MaterialField) -> None:
        """Refuse a start this decoder cannot begin from.

        Raises:
            ValueError: for other experts, a missing parameter, or one outside the inner range.
        """
        if (tuple(start.elastic), tuple(start.plastic)) != (self.elastic, self.plastic):
            raise ValueError(
                f"the start has experts {tuple(start.elastic)} | {tuple(start.plastic)}, "
                f"the network {self.elastic} | {self.plastic}; give both the same candidates in the same order"
            )
        for p in self.params:
            if p.name not in start.theta:
                raise ValueError(
                    f"{p.name!r} is to be learnt but the start has only {sorted(start.theta)}; add it to the start"
                )
            value = start.theta[p.name].detach()
            u = _fraction(p, value)
            # half the margin, so that the rounding of a value moved by `inside` is no mistake
            if not bool(((u > MARGIN / 2) & (u < 1 - MARGIN / 2)).all()):
                lo, hi = _inner(p)
                raise ValueError(
                    f"{p.name} starts at {float(value.min()):.6g} to {float(value.max()):.6g}, allowed is "
                    f"[{lo:.6g}, {hi:.6g}]: at its bounds [{p.lo:g}, {p.hi:g}] a sigmoid cannot move; "
                    f"widen the bounds, do not learn {p.name}, or move the start with decoder.inside"
                )
