"""A material field in words: what each part of an object turned out to be."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.types import MaterialField

from .elastic import ELASTIC
from .plastic import PLASTIC
from .presets import PRESETS


@dataclass(frozen=True)
class Readout:
    """One part of an object."""

    name: str
    """What it is called ("bun"), or "object" for the whole."""
    share: float
    """Its part of the particles [-]."""
    like: str
    """The material word whose law is the same and whose parameters are nearest."""
    elastic: str
    """Elastic expert with the largest mean weight."""
    plastic: str
    """Plastic expert with the largest mean weight."""
    purity: float
    """Mean weight of these two, the smaller [-]."""
    theta: dict[str, float]
    """Means of what these laws read [SI]; geometric means of moduli, stresses and viscosities."""
    spread: float
    """Standard deviation of log10 E inside the part [decades]."""

    def __str__(self) -> str:
        from_laws = ", ".join(f"{name} {value:.3g}" for name, value in self.theta.items())
        doubt = f" ({self.purity:.0%})" if self.purity < 0.995 else ""
        return f"{self.name}: {self.like}-like, {self.elastic}, {self.plastic}{doubt}, {from_laws}"


def readout(field: MaterialField, part: Tensor, names: Sequence[str]) -> list[Readout]:
    """What each part is made of, the largest part first.

        like = argmin_word Σ_θ (log10 θ − log10 θ_word)²   over words of the same plastic law, θ what both laws read

    Args:
        field: any field.
        part: index of each particle's part, shape (N,), int64.
        names: of the parts; one without particles is left out.
    """
    rows = []
    for index, name in enumerate(names):
        where = part == index
        if not bool(where.any()):
            continue
        w_e, w_p = (w[where].mean(0) for w in (field.w_e, field.w_p))
        elastic, plastic = field.elastic[int(w_e.argmax())], field.plastic[int(w_p.argmax())]
        read = {p.name: p.log for law in (ELASTIC[elastic], PLASTIC[plastic]) for p in law.params}
        theta = {
            k: float(10 ** field.theta[k][where].log10().mean() if log else field.theta[k][where].mean())
            for k, log in read.items()
        }
        rows.append(
            Readout(
                name, float(where.float().mean()), _nearest_word(plastic, theta), elastic, plastic,
                float(torch.minimum(w_e.max(), w_p.max())), theta,
                float(field.theta["E"][where].log10().std(correction=0)),
            )
        )  # fmt: skip
    return sorted(rows, key=lambda r: -r.share)


def _nearest_word(plastic: str, theta: dict[str, float]) -> str:
    """The word of the table that is nearest; the law alone where the table has no word for it."""

    def distance(word: str) -> float:
        there = {k: getattr(PRESETS[word], k, None) for k in theta}
        pairs = [(theta[k], float(v)) for k, v in there.items() if k != "nu" and v and theta[k] > 0]
        return sum(float(torch.tensor(a / b).log10()) ** 2 for a, b in pairs)

    words = [word for word, preset in PRESETS.items() if preset.plastic == plastic]
    return min(words, key=distance, default=plastic)
