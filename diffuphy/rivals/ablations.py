"""Our own method with a part taken away that no setting turns off."""

import dataclasses
from dataclasses import dataclass

from diffuphy.learning.case import Case
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.rivals.rival import of_one_law
from diffuphy.types import Gaussians, Look, Motion, Particles

LAW = ("fixed_corotated",), ("identity",)
"""Elastic and plastic law that everything has without a mixture."""


@dataclass(frozen=True)
class OneLaw(FitMaterial):
    """Without the mixture of experts: one elastic law for everything, whatever the prompt; the network finds E alone.

    The prior's clips keep the laws of the table.
    """

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        """The one law."""
        return *LAW, "one law for everything: the mixture is left out"

    def case(self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles) -> Case:
        case = FitMaterial.case(dataclasses.replace(self, elastic=(), plastic=()), look, motion, gaussians, particles)
        return dataclasses.replace(case, table=of_one_law(case.table, *(names[0] for names in LAW)))
