"""PhysGaussian: the user says what the object is made of."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch

from diffuphy.material.preset import Preset
from diffuphy.material.presets import field as filled
from diffuphy.material.presets import lookup
from diffuphy.material.stated import Piece, StatedMaterial
from diffuphy.physgaussian.matter import SUBSTANCES
from diffuphy.rivals.rival import whole
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles

KINDS: Mapping[str, str] = {
    "identity": "jelly",
    "von_mises": "metal",
    "drucker_prager": "sand",
    "viscoplastic": "foam",
    "fluid": "foam",
}
"""Plastic law of a material word → the type that a user of PhysGaussian chooses for it; it has no liquid and no
melting."""

PUBLISHED: Mapping[str, Mapping[str, float]] = {
    "jelly": {"E": 2e6, "nu": 0.4, "density": 200.0},
    "metal": {"E": 1e5, "nu": 0.3, "density": 1000.0, "yield_stress": 100.0},
    "sand": {"E": 5e7, "nu": 0.3, "density": 2000.0, "friction_angle": 30.0},
    "foam": {"E": 1e5, "nu": 0.4, "density": 200.0, "yield_stress": 0.0, "plastic_viscosity": 0.0},
}
"""Numbers of its published scenes: ficus, plane, wolf; of foam there is none, and these are its defaults [SI]."""

UNSET: Mapping[str, float] = {"hardening": 0, "xi": 0.0}
"""What those scenes leave alone."""


@dataclass(frozen=True)
class PhysGaussian:
    """One constant material for the whole object; nothing is learnt.

    Xie et al., PhysGaussian (2024), "based on user-defined parameters", as DiffuPhyGS (2025), §4.1, compares with it.
    What a user knows is the kind of matter; the numbers are those of the scene that was published for it.
    """

    VERSION: ClassVar[int] = 1
    NAME: ClassVar[str] = "PhysGaussian"

    values: Literal["published", "table"] = "published"
    """``published``, or ``table``: what the embedded prior itself would say of the whole object. Then nothing is left
    to find for an object of one material, and what remains is the error of the simulation."""
    elastic: tuple[str, ...] = ()
    """Elastic law of the result; the plan writes it down."""
    plastic: tuple[str, ...] = ()
    """Plastic law likewise."""

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        """The law that the user names."""
        piece = self._piece(motion)
        return (piece.elastic,), (piece.plastic,), f"{self.NAME}: the user says so, of {self._word(motion).word}"

    def __call__(
        self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles, *, work: Any
    ) -> MaterialField:
        """The material of all particles."""
        if self.values == "table":
            return filled(whole(motion), torch.zeros(len(particles), dtype=torch.long, device=particles.x.device))
        return StatedMaterial((self._piece(motion),))(look, motion, gaussians, particles, work=work)

    def expected(self, motion: Motion, share: float = 1.0) -> MaterialField:
        """What a forecast is made with: one row."""
        return StatedMaterial((self._piece(motion),)).expected(motion)

    def _word(self, motion: Motion) -> Preset:
        """The material that the user names; it does not melt."""
        return lookup(motion.materials.get("", next(iter(motion.materials.values()))))

    def _piece(self, motion: Motion) -> Piece:
        if self.values == "table":
            p = whole(motion)
            return Piece(p.elastic, p.plastic, p.rho, p.theta)
        kind = KINDS[self._word(motion).plastic]
        file: Any = UNSET | PUBLISHED[kind]
        substance = SUBSTANCES[kind](file)
        theta = {"E": file["E"], "nu": file["nu"], **substance.theta}
        return Piece(substance.elastic, substance.plastic, file["density"], theta)

    def plan(self) -> list[tuple[str, str, str]]:
        """What, decision and why, for the plan."""
        return [("material", "given", f"one constant material, {self.values} values: nothing is learnt")]
