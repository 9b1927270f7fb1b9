"""DreamPhysics: the stiffness of every particle from a video prior, by the gradient of one substep."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

from diffuphy.learning.case import Case
from diffuphy.learning.descent import Model
from diffuphy.material import Param
from diffuphy.material.decoder import inside
from diffuphy.material.moduli import E
from diffuphy.rivals.particles import ParticleField, Rule, risen, towards
from diffuphy.rivals.rival import Rival, of_one_law, whole
from diffuphy.rivals.substep import LastSubstep
from diffuphy.types import MaterialField, Motion


@dataclass(frozen=True)
class DreamPhysics(Rival):
    """Young's modulus of each particle by video SDS; the law is the user's.

    Huang et al., DreamPhysics (2024), with the update of its published program (``ms_simulation.py``): the gradient is
    that of the last substep before each frame, is stretched over [−½, ½] and taken from log10 E (``particles.MinMax``).

    What differs: the program keeps one buffer for all substeps, so that its gradient is taken at the state of the last
    frame; here each is taken at its own. It simulates nine frames between two that are drawn, in 50 steps.
    """

    NAME = "DreamPhysics"

    start: float = 1e6
    """E to start from [Pa]; 0.1 in the program's unit of 10⁷ Pa."""
    low: float = 1e4
    """Least E [Pa], the program's."""
    high: float = 4e6
    """Largest E [Pa], the program's."""
    step: float = 1.0
    """Length of a step: the two ends of the field move apart by as much [decades]."""
    rule: Rule = "minmax"
    """``minmax`` as published, or ``adam``: what the gradient itself is worth."""
    lr: float = 0.08
    """Learning rate of ``adam`` [decades]."""
    gradient: Literal["substep", "full"] = "substep"
    """``substep`` as published, or ``full``: through the whole simulation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.low < self.start < self.high:
            raise ValueError(f"need 0 < low < start < high [Pa], got {self.low:g}, {self.start:g} and {self.high:g}")

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        preset = whole(motion)
        return (preset.elastic,), (preset.plastic,), f"{self.NAME} takes the law that the user names: {preset.word}"

    @property
    def learnt(self) -> list[Param]:
        """Parameters of each particle, with their bounds."""
        return [dataclasses.replace(E, lo=self.low, hi=self.high)]

    def begin(self, told: MaterialField) -> MaterialField:
        start = of_one_law(told, told.elastic[0], told.plastic[0], {"E": self.start})
        return dataclasses.replace(start, theta=inside(self.learnt, start.theta))

    def model(self, case: Case, start: MaterialField) -> Model:
        return ParticleField(start, self.learnt, self.rule, self.step, self.lr)

    def stiffest(self, start: MaterialField, told: MaterialField, share: float) -> MaterialField:
        """``minmax`` moves one particle up by half a step whatever the clip says; Adam goes towards what it shows."""
        steps = round(share * self.steps)
        if self.rule == "minmax":
            moved = risen(self.learnt, start.theta, 0.5 * self.step * steps)
        else:
            descent = self.descent()
            reach = self.lr * sum(descent.rate(step) for step in range(steps))
            moved = {"E": towards(start.theta["E"], told.theta["E"], reach)}
        return dataclasses.replace(start, theta=start.theta | moved)

    def trained_against(self, case: Case) -> Case:
        return dataclasses.replace(case, bench=LastSubstep.like(case.bench)) if self.gradient == "substep" else case

    def plan(self) -> list[tuple[str, str, str]]:
        through = "the last substep before each frame" if self.gradient == "substep" else "the whole simulation"
        moved = "stretched over [−½, ½] whatever its size" if self.rule == "minmax" else "Adam"
        return [
            ("video SDS", "kept" if self.steps else "left out", "it trains E of each particle"),
            ("gradient", self.gradient, f"through {through}; {moved}"),
        ]
