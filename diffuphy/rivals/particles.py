"""A field of free particles, and the rule that DreamPhysics and Physics3D move it by."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from diffuphy.learning.descent import Model
from diffuphy.material import Param
from diffuphy.material.decoder import coordinate
from diffuphy.material.encoder import Points
from diffuphy.rivals.rival import Frozen
from diffuphy.types import MaterialField

Rule = Literal["minmax", "adam"]


class MinMax(torch.optim.Optimizer):
    """A step of fixed length, whatever the size of the gradient, and whatever its sign.

        y ← clamp(y − step ((g − min g)/(max g − min g) − ½), low, high)

    So of every field some particles rise and some fall in every step, even where the loss wants all to rise. From the
    published programs of DreamPhysics and Physics3D; a learning rate plays no part.

    Args:
        params: tensors whose rows, along the last axis, are fields.
        step: length of the step, in the unit of y.
        low, high: bounds of each row, broadcast against the tensor.
    """

    def __init__(self, params: Iterable[Tensor] | Iterable[dict], step: float, low: Tensor, high: Tensor):
        super().__init__(params, {"step": step, "lr": 1.0})
        self.low, self.high = low, high

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        for group in self.param_groups:
            for y in group["params"]:
                g = y.grad
                least, most = g.amin(-1, keepdim=True), g.amax(-1, keepdim=True)
                share = torch.where(most > least, (g - least) / (most - least).clamp(min=1e-38), 0.5)
                y.copy_(torch.clamp(y - group["step"] * (share - 0.5), self.low, self.high))


class ParticleField(Model):
    """Each learnt parameter of each draft particle is a free number.

    y is log10 θ of a logarithmic parameter, of others their place in their range (``decoder.coordinate``).
    """

    def __init__(self, start: MaterialField, learn: Sequence[Param], rule: Rule, step: float, lr: float):
        super().__init__()
        self.start, self.learn, self.rule, self.step, self.lr = Frozen(start), tuple(learn), rule, step, lr
        self.y = torch.nn.Parameter(torch.stack([coordinate(p, start.theta[p.name]) for p in self.learn]))
        for name in ("low", "high"):
            ends = [coordinate(p, torch.tensor(p.lo if name == "low" else p.hi)) for p in self.learn]
            self.register_buffer(name, torch.stack(ends)[:, None].to(self.y))

    def forward(self) -> MaterialField:
        return self._field(None)

    def at(self, points: Points, draft: Tensor) -> MaterialField:
        return self._field(draft)

    def _field(self, rows: Tensor | None) -> MaterialField:
        field, y = self.start(rows), self.y.clamp(self.low, self.high)
        y = y if rows is None else y[:, rows]
        values = {p.name: 10 ** y[i] if p.log else p.lo + (p.hi - p.lo) * y[i] for i, p in enumerate(self.learn)}
        return dataclasses.replace(field, theta=field.theta | values)

    def groups(self) -> list[dict[str, Any]]:
        return [{"params": [self.y], "lr": self.lr}]

    def optimiser(self) -> torch.optim.Optimizer:
        if self.rule == "adam":
            return super().optimiser()
        return MinMax([self.y], self.step, self.low, self.high)


def risen(learn: Sequence[Param], theta: Mapping[str, Tensor], by: float) -> dict[str, Tensor]:
    """Parameters moved up by a distance on their scale (``decoder.coordinate``), each up to its bound."""
    found = {}
    for p in learn:
        y, high = coordinate(p, theta[p.name]) + by, coordinate(p, torch.tensor(p.hi))
        y = y.clamp(max=float(high))
        found[p.name] = 10**y if p.log else p.lo + (p.hi - p.lo) * y
    return found


def towards(start: Tensor, goal: Tensor, reach: float) -> Tensor:
    """A value that goes from ``start`` to ``goal`` as far as ``reach`` decades take it."""
    way = (goal / start).log10()
    return start * 10 ** way.clamp(-reach, reach)
