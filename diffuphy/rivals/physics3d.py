"""Physics3D: a visco-elastic field from a video prior."""

import dataclasses
from dataclasses import dataclass

from diffuphy.learning.case import Case
from diffuphy.learning.descent import Model
from diffuphy.material.branch import E_N, RELAXATION_TIME
from diffuphy.material.decoder import inside
from diffuphy.material.moduli import NU, E
from diffuphy.rivals.dreamphysics import DreamPhysics
from diffuphy.rivals.particles import ParticleField
from diffuphy.rivals.rival import of_one_law
from diffuphy.types import MaterialField, Motion


@dataclass(frozen=True)
class Physics3D(DreamPhysics):
    """E, ν, and modulus and time of a Maxwell branch of each particle by video SDS; elastic and viscous, nothing else.

        τ = τ_FCR(E, ν) + τ_N(E_N, ν, t_N)

    Liu et al., Physics3D (2024), moved as its published program does, which is DreamPhysics'.

    What differs: the program has two moduli μ_N, λ_N and one viscosity of the branch, here the branch shares ν and its
    bulk stays stiff (``material.branch``); its stress there has U Vᵀ where U Uᵀ is meant. A step of ν is a tenth of its
    range.
    """

    NAME = "Physics3D"

    E_N: float = 1e5
    """Modulus of the branch to start from [Pa]."""
    relaxation_time: float = 0.1
    """Its relaxation time to start from [s]."""

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        return ("fixed_corotated",), ("identity",), f"{self.NAME} is visco-elastic, whatever the material"

    @property
    def branches(self) -> tuple[str, ...]:
        """Viscous branches of the result."""
        return ("maxwell",)

    def model(self, case: Case, told: MaterialField) -> Model:
        young = dataclasses.replace(E, lo=self.low, hi=self.high)
        learn = [young, NU, E_N, RELAXATION_TIME]
        constants = {"E": self.start, "E_N": self.E_N, "relaxation_time": self.relaxation_time, "bulk_relaxation": 0.0}
        start = of_one_law(told, "fixed_corotated", "identity", constants, self.branches)
        start = dataclasses.replace(start, theta=inside(learn, start.theta))
        return ParticleField(start, learn, self.rule, self.step, self.lr)

    def plan(self) -> list[tuple[str, str, str]]:
        _, gradient = super().plan()
        return [
            (
                "video SDS",
                "kept" if self.steps else "left out",
                "it trains E, ν, E_N and relaxation time of each particle",
            ),
            gradient,
        ]
