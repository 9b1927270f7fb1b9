"""Densification by adaptive splitting (DAS): more Gaussians where the loss still pulls.

The printed rule (DiffuPhyGS, eq. 3) splits Gaussian i when g_i ≥ τ_base (1 + α (g_i − ḡ)/(σ_g + ε)). With
β = τ_base α/(σ_g + ε) this is affine in g_i,

    g_i − τ_i = (1 − β) g_i − τ_base + β ḡ,

so it is one threshold for all, not one each: for β < 1 the vanilla rule with its threshold pushed away from the mean,
g* = ḡ + (τ_base − ḡ)/(1 − β); for β > 1 the rule is *reversed* and splits the Gaussians with the smallest gradients;
for β = 1 it splits all or none. σ_g falls while a scene converges, so a fixed τ_base drifts across β = 1 in mid-run.
"""

import math
import warnings
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from diffuphy.text2gs.params import Parameters

EPS = 1e-12


def beta(g: Tensor, tau_base: float, alpha: float) -> float:
    """β = τ_base α/(σ_g + ε): the slope of the adaptive threshold in g."""
    return tau_base * alpha / (g.std(correction=0).item() + EPS)


def das_literal(g: Tensor, tau_base: float, alpha: float) -> Tensor:
    """Mask of g_i ≥ τ_base (1 + α (g_i − ḡ)/(σ_g + ε)): DiffuPhyGS eq. 3, word for word.

    Args:
        g: norms of the loss gradient with respect to each mean, shape (G,).
        tau_base: baseline threshold, in the unit of g.
        alpha: sensitivity.
    """
    return g >= tau_base * (1 + alpha * (g - g.mean()) / (g.std(correction=0) + EPS))


def das_threshold(g: Tensor, tau_base: float, alpha: float, beta_max: float = 0.5) -> float:
    """The one threshold that eq. 3 amounts to, with the slope kept where the rule means what it says.

    g* = ḡ + (τ_base − ḡ)/(1 − min(β, β_max)),   split where g ≥ g* (for β > 1 where g ≤ g*)
    """
    mean, slope = g.mean().item(), min(beta(g, tau_base, alpha), beta_max)
    return mean + (math.copysign(math.inf, tau_base - mean) if slope == 1 else (tau_base - mean) / (1 - slope))


def das_prose(g: Tensor, tau_base: float, alpha: float) -> float:
    """The one threshold that the words around eq. 3 amount to: lower where the gradient is above the mean.

    g_i ≥ τ_base (1 − α (g_i − ḡ)/(σ_g + ε))  ⇔  g_i ≥ ḡ + (τ_base − ḡ)/(1 + β),   pulled towards the mean, never
    reversed.
    """
    mean = g.mean().item()
    return mean + (tau_base - mean) / (1 + beta(g, tau_base, alpha))


@dataclass(frozen=True)
class AdaptiveSplitting:
    """When, which and how Gaussians are split, cloned and pruned."""

    rule: Literal["das", "das_literal", "das_prose"] = "das"
    """``das``: eq. 3 with β ≤ ½, where it means what it says. ``das_literal``: eq. 3 as printed, reversed for β > 1.
    ``das_prose``: eq. 3 with a minus sign, which allocates more to detailed areas, as the words around it promise."""
    alpha: float = 0.25
    """Sensitivity α of eq. 3; larger is more economical."""
    kappa: float = 1.5
    """τ_base = κ ḡ, taken anew at every event, so that the rule does not depend on resolution, batch or w(t)."""
    tau_base: float | None = None
    """Absolute τ_base instead of κ ḡ, in the unit of the gradient; ``das_literal`` in the paper's sense needs one."""
    start: int | float = 0.08
    """First event: a step (int) or a share of the run (float)."""
    stop: int | float = 0.6
    """No events after this; the rest of the run settles what was split."""
    every: int | float = 0.075
    """Between events: steps or a share of the run."""
    growth: float = 0.2
    """At most this share of the Gaussians is added in one event, those with the largest gradients first."""
    max_count: int = 8000
    """Never more Gaussians than this."""
    clone_below: float = 0.02
    """A Gaussian with no axis longer than this [object units] is cloned, a longer one is split."""
    min_opacity: float = 0.02
    """Gaussians more transparent than this are removed at every event."""

    def __post_init__(self) -> None:
        if self.rule not in ("das", "das_literal", "das_prose"):
            raise ValueError(f"rule must be 'das', 'das_literal' or 'das_prose', got {self.rule!r}")
        if self.alpha < 0 or self.kappa <= 0 or (self.tau_base is not None and self.tau_base <= 0):
            raise ValueError(
                f"alpha must be ≥ 0, kappa and tau_base > 0, got {self.alpha}, {self.kappa}, {self.tau_base}"
            )
        if not 0 <= self.growth <= 1:
            raise ValueError(f"growth must be in [0, 1], got {self.growth}")
        for name, x in (("start", self.start), ("stop", self.stop), ("every", self.every)):
            if x < 0 or (name == "every" and x == 0) or (isinstance(x, float) and x > 1):
                raise ValueError(
                    f"{name} must be a number of steps (int) or a share of the run in [0, 1] (float), got {x}"
                )

    def due(self, step: int, total: int) -> bool:
        """True when an event follows step ``step`` (counted from 1) of ``total``."""
        start, stop, every = (
            x if isinstance(x, int) else round(x * total) for x in (self.start, self.stop, self.every)
        )
        return start <= step <= stop and (step - start) % max(1, every) == 0

    def threshold(self, g: Tensor) -> float:
        """g*, the one gradient that the rule amounts to."""
        tau = self._tau(g)
        if self.rule == "das_prose":
            return das_prose(g, tau, self.alpha)
        return das_threshold(g, tau, self.alpha, math.inf if self.rule == "das_literal" else 0.5)

    def _tau(self, g: Tensor) -> float:
        return self.tau_base if self.tau_base is not None else self.kappa * g.mean().item()

    def chosen(self, g: Tensor) -> tuple[Tensor, float]:
        """Mask of the Gaussians to split or clone, within the caps, and β."""
        tau = self._tau(g)
        slope = beta(g, tau, self.alpha)
        if self.rule == "das_literal":
            if slope >= 1:
                warnings.warn(
                    f"DAS is reversed: β = τ_base α/σ_g = {slope:.2f} ≥ 1, so eq. 3 splits the Gaussians "
                    "with the smallest gradients; lower alpha or tau_base, or use rule='das'",
                    RuntimeWarning,
                    stacklevel=2,
                )
            mask = das_literal(g, tau, self.alpha)
        else:
            mask = g >= self.threshold(g)
        allowed = max(0, min(int(self.growth * len(g)), self.max_count - len(g)))
        if int(mask.sum()) > allowed:
            order = torch.where(mask, g, -torch.inf).argsort(descending=True, stable=True)
            mask = torch.zeros_like(mask)
            mask[order[:allowed]] = True
        return mask, slope

    @torch.no_grad()
    def __call__(self, params: Parameters, g: Tensor, generator: torch.Generator) -> dict[str, float]:
        """One event: change ``params`` in place. Returns counts for the log.

        Args:
            g: mean over the steps since the last event of ‖∂L/∂mean_i‖, shape (G,).
        """
        mask, slope = self.chosen(g)
        scale = params.values["log_scales"].exp()
        small = scale.amax(1) <= self.clone_below
        alive = torch.sigmoid(params.values["logit_opacities"]) >= self.min_opacity
        split, clone = mask & alive & ~small, mask & alive & small
        new = [_split(params, split, generator), _clone(params, clone, generator)]
        params.replace(alive & ~split & ~clone, {n: torch.cat([part[n] for part in new]) for n in params.values})
        return {
            "split": int(split.sum()),
            "cloned": int(clone.sum()),
            "pruned": int((~alive).sum()),
            "gaussians": len(params),
            "beta": slope,
            "threshold": self.threshold(g),
        }


def _split(params: Parameters, mask: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """Two children of each, drawn from the parent and 1.6 times smaller (Kerbl et al. 2023, §5.2)."""
    new = _pairs(params, mask, generator)
    new["log_scales"] = new["log_scales"] - math.log(1.6)
    return new


def _clone(params: Parameters, mask: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """Two of each, drawn from the parent, which together are as opaque as it: 1 − (1 − o′)² = o (Rota Bulò et al.
    2024, eq. 8)."""
    new = _pairs(params, mask, generator)
    o = torch.sigmoid(new["logit_opacities"])
    new["logit_opacities"] = torch.logit(1 - (1 - o).sqrt(), eps=1e-6)
    return new


def _pairs(params: Parameters, mask: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """Every Gaussian of ``mask`` twice, each at its own draw from N(mean, R S² Rᵀ)."""
    index = mask.nonzero()[:, 0].repeat(2)
    new = {n: x.detach()[index] for n, x in params.values.items()}
    xi = torch.randn(len(index), 3, generator=generator, device=generator.device).to(new["means"])
    new["means"] = new["means"] + rotate(new["quats"], xi * new["log_scales"].exp())
    return new


def rotate(quats: Tensor, x: Tensor) -> Tensor:
    """R(q) x for quaternions wxyz (n, 4), normalised here, and vectors (n, 3)."""
    q = quats / quats.norm(dim=1, keepdim=True)
    w, u = q[:, :1], q[:, 1:]
    t = 2 * torch.linalg.cross(u, x)
    return x + w * t + torch.linalg.cross(u, t)
