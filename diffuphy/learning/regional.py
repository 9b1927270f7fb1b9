"""What the material stage trains: the network, and what each region has in common."""

import dataclasses
from typing import Any

import torch
from torch import Tensor

from diffuphy.learning.descent import Model
from diffuphy.losses.regularize import spread
from diffuphy.material.decoder import bounded, coordinate
from diffuphy.material.encoder import Points
from diffuphy.material.field import take
from diffuphy.material.net import MaterialNet
from diffuphy.types import MaterialField


class RegionalNet(Model):
    """The network's field, each region moved as a whole by a shift of its own.

        c(θ_p) = bounded(net_p, s_{r(p)})

    A region's shift moves with a large step what its particles have in common, the network with a small one what
    tells them apart; see ``decoder.bounded``.

    Args:
        labels: region r of each draft particle, shape (N,), int64.
        lr, lr_region: learning rates of the network and of the shifts.
        smooth: weight of the variance of each learnt parameter inside a region.
    """

    def __init__(self, net: MaterialNet, labels: Tensor, *, lr: float, lr_region: float, smooth: float):
        super().__init__()
        self.net, self.smooth, self.rates = net, smooth, (lr, lr_region)
        self.params = net.decoder.params
        self.register_buffer("labels", labels)
        regions = int(labels.max()) + 1
        self.shift = torch.nn.Parameter(torch.zeros(regions, len(self.params), device=labels.device))

    def forward(self) -> MaterialField:
        return self._moved(self.net(), self.labels)

    def at(self, points: Points, draft: Tensor) -> MaterialField:
        return self._moved(self.net(points, take(self.net.start, draft)), self.labels[draft])

    def _moved(self, field: MaterialField, labels: Tensor) -> MaterialField:
        gain, theta = self.net.decoder.param_gain, field.theta
        moved = {p.name: bounded(p, theta[p.name], self.shift[labels, i], gain) for i, p in enumerate(self.params)}
        return dataclasses.replace(field, theta=theta | moved)

    def groups(self) -> list[dict[str, Any]]:
        parts = list(self.net.parameters()), [self.shift]
        return [{"params": p, "lr": rate} for p, rate in zip(parts, self.rates, strict=True)]

    def penalty(self, field: MaterialField) -> Tensor | None:
        """The variance of each learnt parameter inside a region."""
        if not self.smooth:
            return None
        inside = [spread(coordinate(p, field.theta[p.name]), self.labels) for p in self.params]
        return self.smooth * torch.stack(inside).sum()
