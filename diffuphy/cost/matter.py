"""What a film will be made of, as far as it costs something."""

from dataclasses import dataclass
from typing import Any, Self

from diffuphy.cost.body import Body
from diffuphy.cost.learning import believed, fitted, own, regions_of
from diffuphy.cost.rollouts import Laws
from diffuphy.material import wave_speed
from diffuphy.types import MaterialField, Motion


@dataclass(frozen=True)
class Matter:
    """Laws, and how fast they carry a wave."""

    laws: Laws
    """Every particle pays for all of them."""
    wave: float
    """Fastest wave at rest [m/s]."""

    @classmethod
    def of(cls, field: MaterialField) -> Self:
        """That of a field."""
        wave = wave_speed(field.elastic, field.w_e, field.theta, field.rho, field.branches)
        return cls(Laws.of(field.elastic, field.plastic, field.branches), float(wave.max()))

    @classmethod
    def of_film(cls, fit: Any, motion: Motion, body: Body) -> Self:
        """That which a material stage will end with: what it says itself (``expected``), else where our training is
        taken to end, with the laws of the table or the one that it is left with."""
        if hasattr(fit, "expected"):
            return cls.of(fit.expected(motion))
        body = believed(fit, body)
        return cls(Laws.of(*own(body)), body.wave(fitted(fit, body, regions_of(fit, motion), 1.0)))
