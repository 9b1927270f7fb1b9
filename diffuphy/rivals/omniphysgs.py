"""OmniPhysGS: a hard choice of laws for each neighbourhood, with constants that are the same for every object."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from diffuphy.learning.case import Case, parameters
from diffuphy.learning.descent import Model
from diffuphy.material.encoder import Points
from diffuphy.material.field import harden, take
from diffuphy.material.net import MaterialNet, Untrained
from diffuphy.material.patches import nearest
from diffuphy.rivals.rival import Rival
from diffuphy.types import MaterialField, Motion

CONSTANTS = {"E": 2e6, "nu": 0.4, "friction_angle": 25.0, "cohesion": 0.0, "yield_stress": 1e3, "viscosity": 10.0}
"""Parameters of the experts: those of its published settings [SI]; σ_Y is compared with |dev τ| there and here."""


def straight_through(w: Tensor, hard: Tensor) -> Tensor:
    """The hard weights, with the gradient of the soft ones: hard + w − stop(w)."""
    return hard + (w - w.detach())


class GroupChoice(Model):
    """Every particle follows the laws that the nearest group's token chooses."""

    def __init__(self, net: MaterialNet, draft: Tensor, lr: float):
        super().__init__()
        self.net, self.lr = net, lr
        x = (draft - net.origin) / net.radius
        self.register_buffer("centre_row", nearest(net.centres, x, 1)[1][:, 0])
        self.register_buffer("group", nearest(x, net.centres, 1)[1][:, 0])

    def forward(self) -> MaterialField:
        return self._chosen(self.group)

    def at(self, points: Points, draft: Tensor) -> MaterialField:
        x = (points.x - self.net.origin) / self.net.radius
        return self._chosen(nearest(x, self.net.centres, 1)[1][:, 0], rho=self.net.transfer(points).rho)

    def _chosen(self, group: Tensor, rho: Tensor | None = None) -> MaterialField:
        """At a centre the interpolation of tokens is that centre's own."""
        soft = take(self.net(), self.centre_row[group])
        hard = harden(soft)
        w_e, w_p = straight_through(soft.w_e, hard.w_e), straight_through(soft.w_p, hard.w_p)
        return dataclasses.replace(soft, w_e=w_e, w_p=w_p, rho=self.net.start.rho if rho is None else rho)

    def groups(self) -> list[dict[str, Any]]:
        return [{"params": list(self.net.parameters()), "lr": self.lr}]


@dataclass(frozen=True)
class OmniPhysGS(Rival):
    """Laws of each neighbourhood by video SDS, hard, through a straight-through gradient; no parameter is learnt.

        w = onehot(argmax z) + softmax(z) − stop(softmax(z)),   z of the nearest group's token

    Lin et al., OmniPhysGS (2025), and its published program and settings: the tokens see no other group, the
    choice has neither noise nor temperature, and the constants are the same for every object.

    What differs: its "StVK" is neither symmetric nor objective, its place is taken by Neo-Hookean; features are not
    scrambled between the points of a group; a group is centred; learning rate 40 times larger for as many times fewer
    steps. One material's density is that of the table.
    """

    NAME = "OmniPhysGS"

    candidates_elastic: tuple[str, ...] = ("fixed_corotated", "hencky", "neo_hookean")
    """Elastic experts."""
    candidates_plastic: tuple[str, ...] = ("identity", "drucker_prager", "von_mises", "fluid")
    """Plastic experts."""
    constants: dict[str, float] = field(default_factory=lambda: dict(CONSTANTS))
    """Parameters of all experts [SI]."""
    network: Untrained = field(default_factory=lambda: Untrained(depth=0, own=False, bias=0.0))
    """Groups and their tokens; begins at random, as there."""
    lr: float = 2e-3
    """Learning rate of the network; 5e-5 in the program, with 1500 steps."""

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        return self.candidates_elastic, self.candidates_plastic, f"{self.NAME} chooses among them, whatever the prompt"

    def begin(self, told: MaterialField) -> MaterialField:
        n, laws = len(told), (tuple(self.candidates_elastic), tuple(self.candidates_plastic))
        even = [told.rho.new_full((n, len(names)), 1 / len(names)) for names in laws]
        values = {p.name: self.constants.get(p.name, p.default) for p in parameters(*laws)}
        theta = {name: torch.full_like(told.rho, value) for name, value in values.items()}
        return MaterialField(*laws, *even, theta, told.rho)

    def model(self, case: Case, start: MaterialField) -> Model:
        return GroupChoice(self.network.build(case.points, start, ()), case.bench.draft.x, self.lr)

    def plan(self) -> list[tuple[str, str, str]]:
        return [
            ("video SDS", "kept" if self.steps else "left out", "it trains which laws each group follows"),
            (
                "gradient",
                "straight-through",
                "the choice is hard, its gradient that of soft weights; parameters are fixed",
            ),
        ]
