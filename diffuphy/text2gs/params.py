"""Gaussians while they are being optimised: the tensors, and Adam's memory of each Gaussian."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.types import Gaussians

MAX_LOGIT = 4.5
"""Opacity 0.989: the rasteriser caps α at 0.99, beyond which an opacity would have no gradient to come back by."""
NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")


@dataclass(frozen=True)
class LearningRates:
    """Step sizes of Adam at the start of a run, in the units of each parameter; all decay together."""

    means: float = 3e-3
    """[object units]: the object is 2 long. 5e-3 loses 0.5 dB, 1e-2 another 0.5."""
    quats: float = 4e-2
    log_scales: float = 4e-2
    """Half as much loses 0.5 dB; half as much again gains nothing and flattens every Gaussian."""
    logit_opacities: float = 1e-1
    sh: float = 5e-2
    """Base colour; 5e-2 · 0.28 moves rgb by 0.014 a step."""
    sh_rest: float = 2.5e-3
    """Coefficients of degree 1 and up: 1/20 of the base colour's (Kerbl et al. 2023), so that colour is not view
    first."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"learning rate of {name} must not be negative, got {value}")


class Parameters:
    """The five tensors of ``Gaussians`` under Adam (Kingma & Ba 2015), with moments *and age* per Gaussian.

        m ← β₁ m + (1 − β₁) g,   v ← β₂ v + (1 − β₂) g²,   x ← x − η · m/(1 − β₁ⁿ) / (√(v/(1 − β₂ⁿ)) + ε)

    n counts the steps of each Gaussian separately: one that densification has just made starts with zero moments and a
    correct bias correction, and its neighbours keep their memory.
    """

    betas = (0.9, 0.99)
    eps = 1e-15  # gradients of one Gaussian may be 1e-9; Kerbl et al. (2023) use the same

    def __init__(self, gaussians: Gaussians):
        self.values = {n: getattr(gaussians, n).detach().clone().requires_grad_() for n in NAMES}
        self.m = {n: torch.zeros_like(x) for n, x in self.values.items()}
        self.v = {n: torch.zeros_like(x) for n, x in self.values.items()}
        self.age = torch.zeros(len(gaussians), dtype=torch.int64, device=gaussians.means.device)

    def __len__(self) -> int:
        return len(self.age)

    def gaussians(self) -> Gaussians:
        """The current values; differentiable."""
        return Gaussians(**self.values)

    # ------------------------------------------------------------------ optimiser
    @torch.no_grad()
    def step(self, rates: LearningRates, factor: float = 1.0, *, opaque: float = 0.0) -> None:
        """One step of Adam with the gradients that ``backward`` left, times ``factor``; clears them.

        Args:
            opaque: drift of every logit of opacity upwards, as a share of a full step of Adam. Decoupled from the
                gradient as AdamW's decay is (Loshchilov & Hutter 2019), so that it means the same for every prior and
                w(t): a Gaussian stays transparent only if the pictures ask for it with a signal-to-noise ratio m/√v
                above ``opaque``.
        """
        self.age += 1
        c1, c2 = (1 - b ** self.age.double() for b in self.betas)  # 1 − 0.99 would lose 4 digits of float32's 7
        for name, x in self.values.items():
            if (g := x.grad) is None:
                continue
            shape = (-1, *[1] * (x.ndim - 1))
            m, v = self.m[name].lerp_(g, 1 - self.betas[0]), self.v[name].lerp_(g * g, 1 - self.betas[1])
            update = (m / c1.to(x).view(shape)) / ((v / c2.to(x).view(shape)).sqrt_() + self.eps)
            x.sub_(update * self._rate(name, x, rates) * factor)
            x.grad = None
        self.values["logit_opacities"].add_(rates.logit_opacities * factor * opaque).clamp_(max=MAX_LOGIT)

    @staticmethod
    def _rate(name: str, x: Tensor, rates: LearningRates) -> Tensor | float:
        if name != "sh" or x.shape[1] == 1:
            return getattr(rates, name)
        rate = x.new_full((x.shape[1], 1), rates.sh_rest)
        rate[0] = rates.sh
        return rate

    @torch.no_grad()
    def project(self, *, max_scale: float, max_ratio: float) -> None:
        """Nearest scales with no axis above ``max_scale`` and none below the longest divided by ``max_ratio``.

        Needles and sheets look right from the training views only, and tear when they are carried by a deforming body
        (Xie et al., PhysGaussian 2024, §3.6); a bound needs no weight to tune.
        """
        s = self.values["log_scales"]
        s.clamp_(max=math.log(max_scale))
        s.copy_(torch.maximum(s, s.amax(1, keepdim=True) - math.log(max_ratio)))

    # ------------------------------------------------------------------ surgery
    @torch.no_grad()
    def replace(self, keep: Tensor, new: dict[str, Tensor]) -> None:
        """Keep the Gaussians of the mask ``keep`` with their Adam state, and append ``new`` ones with none."""
        count = len(new["means"])
        for name, x in self.values.items():
            self.values[name] = torch.cat([x.detach()[keep], new[name].to(x)]).requires_grad_()
            for moment in (self.m, self.v):
                moment[name] = torch.cat([moment[name][keep], x.new_zeros(count, *x.shape[1:])])
        self.age = torch.cat([self.age[keep], self.age.new_zeros(count)])

    # ------------------------------------------------------------------ checkpoint
    def state(self) -> dict[str, object]:
        return {"values": dict(self.values), "m": dict(self.m), "v": dict(self.v), "age": self.age}

    @classmethod
    def restored(cls, state: dict[str, Any], device: torch.device | str) -> "Parameters":
        """What ``state()`` described, on ``device``, bit for bit."""
        values, m, v = ({n: state[k][n].to(device) for n in NAMES} for k in ("values", "m", "v"))
        self = cls(Gaussians(**values))
        self.m, self.v, self.age = m, v, state["age"].to(device)
        return self


def clean(
    gaussians: Gaussians, *, min_opacity: float, radius: float, isolation: float
) -> tuple[Gaussians, dict[str, int]]:
    """Gaussians that make matter: opaque enough, inside the object's ball, and not alone. Returns them and the count
    of each removal.

    Args:
        min_opacity: below it a Gaussian is haze.
        radius: ball around the origin [object units].
        isolation: a Gaussian farther from its 4th nearest neighbour than this many standard deviations of that
            Gaussian's own longest axis plus its median neighbour distance floats in the void.
    """
    x = gaussians.means.detach()
    opaque = torch.sigmoid(gaussians.logit_opacities.detach()) >= min_opacity
    inside = x.norm(dim=1) <= radius
    keep = opaque & inside
    reach = nearest_distance(x[keep], k=4)
    size = gaussians.log_scales.detach()[keep].amax(1).exp()
    alone = reach > isolation * (size + reach.median()) if len(reach) else reach.bool()
    removed = {
        "transparent": int((~opaque).sum()),
        "outside": int((opaque & ~inside).sum()),
        "isolated": int(alone.sum()),
    }
    index = keep.nonzero()[:, 0][~alone]
    if len(index) == 0:
        raise ValueError(
            f"nothing is left of {len(gaussians)} Gaussians after cleaning ({removed}); "
            "train longer or lower min_opacity"
        )
    return Gaussians(**{n: getattr(gaussians, n).detach()[index].contiguous() for n in NAMES}), removed


def nearest_distance(x: Tensor, k: int = 1, chunk: int = 1024) -> Tensor:
    """Distance of each point to its k-th nearest other, shape (n,); 0 for fewer than k + 1 points."""
    if len(x) <= k:
        return x.new_zeros(len(x))
    return torch.cat(
        [
            torch.cdist(part, x, compute_mode="donot_use_mm_for_euclid_dist").topk(k + 1, largest=False).values[:, -1]
            for part in x.split(chunk)
        ]
    )
