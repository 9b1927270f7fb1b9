"""The material network: appearance and place of a particle → which laws it follows, and with which parameters.

    groups of the draft particles ─ encoder → tokens ─ 3-nearest interpolation → particle ─ decoder → MaterialField

The groups are fixed when the network is built; the particles that ask may be any: the draft ones in training, all
those of the film afterwards. All of it is said in the frame of the body (``patches.body_frame``): an object that is
moved, turned or listed in another order has the same material.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

import torch
from torch import Tensor, nn

from diffuphy.material import pretrained
from diffuphy.material.decoder import Bounds, Decoder, GateName
from diffuphy.material.encoder import N_FEATURES, Encoder, Points
from diffuphy.material.field import take
from diffuphy.material.patches import body_frame, farthest_points, interpolation, nearest
from diffuphy.types import MaterialField

STD_FLOOR = 0.05
"""Least spread a feature is divided by (nats, opacity, rgb): smaller differences are noise, not structure."""


@dataclass(frozen=True)
class Net:
    """Settings of the material network; ``build`` makes it for one object."""

    groups: int = 64
    """Patches; 64 × 32 puts each of 1.5 k draft particles in 1.4 patches on average, so they overlap a little."""
    group_size: int = 32
    """Particles per patch (Point-BERT)."""
    width: int = 96
    """Length of a token; wider was not needed for objects of a few regions."""
    depth: int = 2
    """Transformer blocks."""
    heads: int = 4
    """Attention heads; divides ``width``."""
    gate: GateName = "softmax"
    """``softmax`` (paper eq. 9); ``sparsemax``, which reaches exact zeros; or ``start``: the weights stay as they are,
    a choice of laws by the scan alone, and laws without weight are not even simulated."""
    bias: float = 8.0
    """Head start b of the start's expert in its gate [-]: 1.5 was trained away, 4 and 8 were kept; of four experts the
    others begin with 3/(3 + eᵇ) = 0.001 at 8 but 0.05 at 4, and that much plasticity a substep melts a solid."""
    own: bool = True
    """Give the decoder the particle's own features besides its patches': sharp borders between regions need them."""
    gate_gain: float = 3.0
    """Slope of the gate logits [-], so that a learning rate fit for the network also moves the gates."""
    param_gain: float = 2.0
    """Slope of the parameters before their sigmoid [-], for the same reason."""
    seed: int = 0
    """Seed of the initial weights."""
    pretrained: str | None = field(default=None, metadata={"content": lambda file: (Path(file),) if file else ()})
    """Weights of an encoder trained before on other objects, a file of ``benchmarks/pretrain.py``; null draws them:
    after a scan no gain was measured (docs/benchmarks/pretrain.md)."""

    def __post_init__(self) -> None:
        if self.pretrained is not None and not Path(self.pretrained).is_file():
            raise ValueError(
                f"net.pretrained = {self.pretrained!r} is no file; make one with `python -m benchmarks pretrain`, "
                "or leave it null"
            )
        for name in ("groups", "group_size", "width", "heads"):
            if getattr(self, name) < 1:
                raise ValueError(f"net.{name} must be at least 1, got {getattr(self, name)}")
        if self.depth < 0:
            raise ValueError(f"net.depth must be 0 or more, got {self.depth}")
        if self.width % 2 or self.width % self.heads:
            raise ValueError(f"net.width must be even and a multiple of net.heads = {self.heads}, got {self.width}")
        if self.gate not in get_args(GateName):
            raise ValueError(f"net.gate must be one of {get_args(GateName)}, got {self.gate!r}")
        if self.bias < 0 or self.gate_gain <= 0 or self.param_gain <= 0:
            raise ValueError(
                "net.bias must be ≥ 0, net.gate_gain and net.param_gain > 0, "
                f"got {self.bias}, {self.gate_gain}, {self.param_gain}"
            )
        if self.gate == "sparsemax" and self.bias >= 1:
            raise ValueError(
                f"net.bias = {self.bias} with net.gate = 'sparsemax' starts exactly one-hot, where the gate has no "
                "gradient and no expert could ever change; use net.bias < 1 (0.8 puts 0.85 on one of four) "
                "or net.gate = 'softmax'"
            )

    def build(self, points: Points, start: MaterialField, learn: Sequence[Bounds]) -> "MaterialNet":
        """A network for the object of these draft particles, whose field is ``start`` until it has been trained.

        Args:
            points: draft particles, at least ``groups`` distinct ones (``encoder.features``).
            start: their field to begin from (``warm_start`` or ``presets.field``).
            learn: parameters to learn (``expert.Param``); the others stay at the start.
        """
        return MaterialNet(self, points, start, learn)


@dataclass(frozen=True)
class Untrained(Net):
    """The network of a random seed and no start: its last layer, which elsewhere begins at zero, is random as well.

    What it says of an object, frozen, is the reference that Diff_SSIM and Diff_CLIP compare with (OmniPhysGS, 2025;
    DiffuPhyGS, A.2).
    """

    def build(self, points: Points, start: MaterialField, learn: Sequence[Bounds]) -> "MaterialNet":
        net = super().build(points, start, learn)
        last, generator = net.decoder.head[-1], torch.Generator().manual_seed(self.seed)
        with torch.no_grad():
            for parameter in last.parameters():
                bound = last.in_features**-0.5
                parameter.copy_(torch.empty(parameter.shape).uniform_(-bound, bound, generator=generator))
        return net


class MaterialNet(nn.Module):
    """See the module's head. The state dict holds weights, groups and start: tensors only, enough to go on from.

    Raises:
        ValueError: for fewer points than groups or group members, a start of another length, or one the decoder
        refuses.
    """

    def __init__(self, net: Net, points: Points, start: MaterialField, learn: Sequence[Bounds]):
        super().__init__()
        n = len(points)
        if len(start) != n or n < max(net.groups, net.group_size):
            raise ValueError(
                f"got {n} points and a start for {len(start)}; need one row of start per point, and at least "
                f"net.groups = {net.groups} and net.group_size = {net.group_size} points; "
                "take more particles or lower these two"
            )
        self._place(net, points)
        own = 3 + N_FEATURES if net.own else 0
        with torch.random.fork_rng(devices=[]):  # layer constructors draw from the global generator; it must not notice
            self.encoder = Encoder(3 + N_FEATURES, net.width, net.depth, net.heads)
            self.decoder = Decoder(
                net.width + own, net.width, start.elastic, start.plastic, learn,
                kind=net.gate, bias=net.bias, gate_gain=net.gate_gain, param_gain=net.param_gain,
            )  # fmt: skip
        self.own = net.own
        self.decoder.check(start)
        _initialise(self, torch.Generator().manual_seed(net.seed))
        if net.pretrained is not None:
            pretrained.load(self.encoder, Path(net.pretrained))
        self.to(points.x.device, points.x.dtype)
        for name in ("w_e", "w_p", "rho"):
            self.register_buffer(f"start_{name}", getattr(start, name).detach().clone())
        self._theta, self._branches = tuple(start.theta), start.branches
        for name, value in start.theta.items():
            self.register_buffer(f"start_theta_{name}", value.detach().clone())

    def _place(self, net: Net, points: Points) -> None:
        """Fix the frame of the network, its groups, and the draft particles' place among them."""
        origin, axes = body_frame(points.x, 1 + points.color.mean(1))
        points = points.seen_from(origin, axes)
        radius = points.x.norm(dim=1).amax()
        if not radius > 0:
            raise ValueError("all points coincide; a material network needs an object with extent")
        self.register_buffer("origin", origin)
        self.register_buffer("axes", axes)
        self.register_buffer("radius", radius)
        self.register_buffer("mean", points.f.mean(0))
        self.register_buffer("std", points.f.std(0, correction=0).clamp(min=STD_FLOOR))
        x, f = points.x / radius, (points.f - self.mean) / self.std
        centres = x[farthest_points(x, net.groups)]
        reach, members = nearest(centres, x, net.group_size)
        relative = (x[members] - centres[:, None]) / reach[:, -1].mean().clamp(min=torch.finfo(x.dtype).tiny)
        self.register_buffer("groups", torch.cat([relative, f[members]], 2))  # (G, M, 3 + 10)
        self.register_buffer("centres", centres)
        weight, near = interpolation(x, centres)
        self.register_buffer("draft", torch.cat([x, f], 1))
        self.register_buffer("draft_near", near)
        self.register_buffer("draft_weight", weight)

    def _normalise(self, points: Points) -> tuple[Tensor, Tensor]:
        """Positions in the frame of the body over its radius, and standardised features."""
        points = points.seen_from(self.origin, self.axes)
        return points.x / self.radius, (points.f - self.mean) / self.std

    @property
    def start(self) -> MaterialField:
        """The field of the draft particles before training."""
        theta = {name: getattr(self, f"start_theta_{name}") for name in self._theta}
        names = self.decoder.elastic, self.decoder.plastic
        return MaterialField(*names, self.start_w_e, self.start_w_p, theta, self.start_rho, self._branches)

    def transfer(self, points: Points) -> MaterialField:
        """The start for other points: that of the nearest draft particle."""
        x, _ = self._normalise(points)
        index = nearest(x, self.draft[:, :3], 1)[1][:, 0]
        return take(self.start, index)

    def forward(self, points: Points | None = None, start: MaterialField | None = None) -> MaterialField:
        """The material of any points of the object.

        Args:
            points: who asks; by default the draft particles the network was built with.
            start: their field to begin from; by default that of the nearest draft particle.

        Returns:
            The field of these points, differentiable in the weights of the network; ``rho`` is the start's.

        Raises:
            ValueError: for a start without points, of another length, or one the decoder refuses.
        """
        if points is None and start is not None:
            raise ValueError("forward got a start but no points; give the points the start belongs to")
        tokens = self.encoder(self.groups, self.centres)
        if points is None:
            own, near, weight, start = self.draft, self.draft_near, self.draft_weight, self.start
        else:
            if start is not None:
                self.decoder.check(start)
                if len(start) != len(points):
                    raise ValueError(f"got {len(points)} points and a start for {len(start)}; give one row per point")
            x, f = self._normalise(points)
            own = torch.cat([x, f], 1)
            weight, near = interpolation(x, self.centres)
            start = start if start is not None else self.transfer(points)
        mixed = (tokens[near] * weight[..., None]).sum(1)
        return self.decoder(torch.cat([mixed, own], 1) if self.own else mixed, start)


def _initialise(net: MaterialNet, generator: torch.Generator) -> None:
    """U(±1/√fan_in) for every linear layer, in order; zero for the last layer of the head."""
    with torch.no_grad():
        for m in net.modules():
            if isinstance(m, nn.Linear):
                bound = m.in_features**-0.5
                m.weight.uniform_(-bound, bound, generator=generator)
                if m.bias is not None:
                    m.bias.uniform_(-bound, bound, generator=generator)
        for parameter in net.decoder.head[-1].parameters():
            parameter.zero_()
