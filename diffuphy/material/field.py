"""Material fields before and after the network: warm starts from hypotheses, and the field that is left at the end."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.types import MaterialField


@dataclass(frozen=True)
class Hypothesis:
    """One guess of what a region is made of."""

    elastic: str | None
    """Elastic expert; None leaves all candidates equal."""
    plastic: str | None
    """Plastic expert; None leaves all candidates equal."""
    theta: Mapping[str, float]
    """Parameters by name [SI]."""
    rho: float
    """Density [kg/m³]."""


def warm_start(
    elastic: Sequence[str], plastic: Sequence[str], labels: Tensor, hypotheses: Sequence[Hypothesis]
) -> MaterialField:
    """The field in which region r follows hypothesis r: one-hot weights (uniform for None), constant θ and ρ.

    Args:
        elastic, plastic: candidate experts, the columns of the field.
        labels: region of each particle, shape (N,), int64, values < len(hypotheses).
        hypotheses: one per region, all with the same parameter names.

    Raises:
        ValueError: for an expert that is no candidate, differing parameter names, or a label without hypothesis.
    """
    names = list(hypotheses[0].theta) if hypotheses else []
    if any(set(h.theta) != set(names) for h in hypotheses):
        raise ValueError(
            f"hypotheses have parameters {[sorted(h.theta) for h in hypotheses]}; give each the same names"
        )
    if len(labels) and not (0 <= int(labels.min()) and int(labels.max()) < len(hypotheses)):
        raise ValueError(
            f"labels run from {int(labels.min())} to {int(labels.max())}, but there are {len(hypotheses)} hypotheses; "
            "give one hypothesis per region"
        )

    def rows(candidates: Sequence[str], chosen: list[str | None]) -> Tensor:
        if unknown := [c for c in chosen if c is not None and c not in candidates]:
            raise ValueError(f"expert {unknown[0]!r} is not among the candidates {tuple(candidates)}; add it to them")
        one = torch.eye(len(candidates), device=labels.device)
        even = one.new_full((len(candidates),), 1 / len(candidates))
        return torch.stack([even if c is None else one[candidates.index(c)] for c in chosen])[labels]

    def column(values: list[float]) -> Tensor:
        return torch.tensor(values, dtype=torch.float32, device=labels.device)[labels]

    return MaterialField(
        tuple(elastic),
        tuple(plastic),
        rows(elastic, [h.elastic for h in hypotheses]),
        rows(plastic, [h.plastic for h in hypotheses]),
        {n: column([h.theta[n] for h in hypotheses]) for n in names},
        column([h.rho for h in hypotheses]),
    )


def take(field: MaterialField, index: Tensor) -> MaterialField:
    """The rows of a field chosen by an index tensor."""
    theta = {k: v[index] for k, v in field.theta.items()}
    return dataclasses.replace(field, w_e=field.w_e[index], w_p=field.w_p[index], theta=theta, rho=field.rho[index])


def harden(field: MaterialField) -> MaterialField:
    """The same field with every particle wholly on its heaviest expert; equal weights go to the earlier expert.

    One-hot weights are the only ones whose material does not depend on the time step, so this is what is reported and
    filmed.
    """

    def one_hot(w: Tensor) -> Tensor:
        places = torch.arange(w.shape[1], device=w.device).expand_as(w)
        first = torch.where(w == w.amax(1, keepdim=True), places, w.shape[1]).amin(1)
        return torch.nn.functional.one_hot(first, w.shape[1]).to(w.dtype)

    return dataclasses.replace(field, w_e=one_hot(field.w_e.detach()), w_p=one_hot(field.w_p.detach()))


@dataclass(frozen=True)
class Pruned:
    """A field without the experts that nobody needs, and what became of each candidate."""

    field: MaterialField
    """Remaining columns only, rows on the simplex again."""
    peaks: dict[str, float]
    """Largest weight of each candidate over all particles [-]."""
    dropped: tuple[str, ...]
    """The candidates that went."""
    moved: float
    """Largest weight that was redistributed in any one particle [-]."""


def prune(field: MaterialField, threshold: float = 1e-3) -> Pruned:
    """Drop the experts whose weight is below the threshold in every particle; nothing need be compiled or run for them.

    Args:
        field: any field; after ``harden`` exactly the unused experts go.
        threshold: in (0, 1/K) [-]; below 1/K every particle keeps at least its heaviest expert.

    Raises:
        ValueError: for another threshold.
    """
    most = max(field.w_e.shape[1], field.w_p.shape[1])
    if not 0 < threshold < 1 / most and not (most == 1 and 0 < threshold <= 1):
        raise ValueError(
            f"threshold must be in (0, 1/{most}) for {most} candidates, got {threshold}; "
            "lower it, or a particle could lose all its experts"
        )
    peaks: dict[str, float] = {}
    moved = 0.0

    def columns(names: tuple[str, ...], w: Tensor) -> tuple[tuple[str, ...], Tensor]:
        nonlocal moved
        peak = w.detach().amax(0)
        peaks.update(zip(names, peak.tolist(), strict=True))
        keep = (peak >= threshold).nonzero()[:, 0]
        if len(keep) == len(names):
            return names, w
        kept = w[:, keep]
        total = kept.sum(1, keepdim=True)
        moved = max(moved, float((1 - total.detach()).amax()))
        return tuple(names[i] for i in keep.tolist()), kept / total

    elastic, w_e = columns(tuple(field.elastic), field.w_e)
    plastic, w_p = columns(tuple(field.plastic), field.w_p)
    dropped = tuple(n for n in (*field.elastic, *field.plastic) if n not in (*elastic, *plastic))
    return Pruned(dataclasses.replace(field, elastic=elastic, plastic=plastic, w_e=w_e, w_p=w_p), peaks, dropped, moved)


def summary(field: MaterialField) -> dict[str, float]:
    """Mean log10 E and mean weight of each expert, for the log."""
    log_E = field.theta["E"].detach().log10()
    weights = zip(
        (*field.elastic, *field.plastic), (*field.w_e.detach().mean(0), *field.w_p.detach().mean(0)), strict=True
    )
    return {"log10_E": float(log_E.mean()), **{f"w_{name}": float(w) for name, w in weights}}
