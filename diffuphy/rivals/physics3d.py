"""Physics3D: a visco-elastic field from a video prior."""

import dataclasses
from dataclasses import dataclass

from diffuphy.material import Param
from diffuphy.material.branch import E_N, RELAXATION_TIME
from diffuphy.material.decoder import inside
from diffuphy.material.moduli import NU
from diffuphy.rivals.dreamphysics import DreamPhysics
from diffuphy.rivals.rival import of_one_law
from diffuphy.types import MaterialField, Motion


@dataclass(frozen=True)
class Physics3D(DreamPhysics):
    """E, ν, and modulus and time of a Maxwell branch of each particle by video SDS; elastic and viscous, nothing else.

        τ = τ_FCR(E, ν) + τ_N(E_N, ν, t_N)

    Liu et al., Physics3D (2024), moved as its published program does (``simulation.py``), which is DreamPhysics'
    way.

    What differs: the program moves E and, of the branch, two moduli μ_N, λ_N and a viscosity; here the branch shares ν,
    which stands for their ratio and moves within its range as the others within a decade, and its bulk stays stiff
    (``material.branch``). The program's stress of the branch has U Vᵀ where U Uᵀ is meant.
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

    @property
    def learnt(self) -> list[Param]:
        return [*super().learnt, NU, E_N, RELAXATION_TIME]

    def begin(self, told: MaterialField) -> MaterialField:
        constants = {"E": self.start, "E_N": self.E_N, "relaxation_time": self.relaxation_time, "bulk_relaxation": 0.0}
        start = of_one_law(told, "fixed_corotated", "identity", constants, self.branches)
        return dataclasses.replace(start, theta=inside(self.learnt, start.theta))

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
