"""The scan: hypotheses are compared, also when some of them cannot be simulated."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from diffuphy.learning.scan import compass, scan
from diffuphy.types import MaterialField, SimulationDiverged
from diffuphy.workspace import Workspace

N = 8
TABLE = MaterialField(
    ("neo_hookean",),
    ("identity",),
    torch.ones(N, 1),
    torch.ones(N, 1),
    {"E": torch.full((N,), 1e5), "nu": torch.full((N,), 0.3)},
    torch.full((N,), 1000.0),
)
COND: Any = SimpleNamespace(prepare=lambda frames: None, score=lambda drop, weight: float((drop - 5.0).square().mean()))
"""Scores by how near log10 E is to 5."""


def case(torn: float) -> Any:
    """An object whose drop nobody needs to see."""
    return SimpleNamespace(bench=bench(torn), cond=COND, table=TABLE, labels=torch.zeros(N, dtype=torch.long))


def bench(torn: float) -> Any:
    """Films log10 E; what is softer than ``torn`` cannot be simulated."""

    def simulate(field, frames):
        value = field.theta["E"].log10()
        if float(value.mean()) < torn:
            raise SimulationDiverged(f"particle 3 was turned inside out with log E = {float(value.mean()):.2f}")
        return value

    return SimpleNamespace(simulate=simulate)


def best(torn: float) -> float:
    found = scan(case(torn), (3.0, 4.0, 4.75, 6.0), frames=3, weight="unit", work=Workspace())
    return float(torch.tensor(found[0][0]["theta"]["E"]).log10())


def test_what_cannot_be_simulated_does_not_win_and_is_told(caplog):
    """The nearest to 5 of those that can; the log counts the others, and quotes one. Steps of 1 are halved twice."""
    assert best(torn=0.0) == pytest.approx(5.0)  # 4.75 + 0.25
    assert not caplog.records or "cannot be simulated" not in caplog.text
    assert best(torn=5.2) == pytest.approx(5.25)  # 6 − 0.5 − 0.25
    assert "3 of 4 hypotheses cannot be simulated: particle 3 was turned inside out" in caplog.text


def test_if_nothing_can_be_simulated_the_reason_is_raised():
    with pytest.raises(SimulationDiverged, match="turned inside out"):
        best(torn=7.0)


def test_every_choice_of_laws_comes_with_its_best_stiffness():
    """One start for each choice of laws, the best first; the search between grid values is part of the score."""
    both = dataclasses.replace(TABLE, plastic=("identity", "fluid"), w_p=torch.tensor([[1.0, 0.0]]).repeat(N, 1))

    def simulate(field, frames):
        return field.theta["E"].log10() + (0.3 if field.plastic == ("fluid",) else 0.0)

    made = SimpleNamespace(
        bench=SimpleNamespace(simulate=simulate), cond=COND, table=both, labels=torch.zeros(N, dtype=torch.long)
    )
    found = scan(made, (3.0, 4.0, 5.0), frames=3, weight="unit", work=Workspace())
    assert [f[0]["plastic"] for f in found] == ["identity", "fluid"]
    E = [float(torch.tensor(f[0]["theta"]["E"]).log10()) for f in found]
    assert E == pytest.approx([5.0, 4.75])  # 4.7 is best for the second; 5 − 0.25 is the nearest it may look at


def test_a_right_law_far_from_the_grid_wins_over_a_wrong_one_on_it():
    """Grid 3, 6: the right law scores (log E − 4.3)², the wrong one 0.02. Its nearest within two halvings is 4.5, of
    0.04; steps of 0.094, the first below 0.15, end within 0.094."""
    both = dataclasses.replace(TABLE, plastic=("identity", "fluid"), w_p=torch.tensor([[1.0, 0.0]]).repeat(N, 1))

    def simulate(field, frames):
        log_E = field.theta["E"].log10()
        return log_E + 0.7 if field.plastic == ("fluid",) else torch.full_like(log_E, 5.0 + 0.02**0.5)

    made: Any = SimpleNamespace(
        bench=SimpleNamespace(simulate=simulate), cond=COND, table=both, labels=torch.zeros(N, dtype=torch.long)
    )
    found = scan(made, (3.0, 6.0), frames=3, weight="unit", work=Workspace())
    assert [f[0]["plastic"] for f in found] == ["fluid", "identity"]
    assert abs(float(torch.tensor(found[0][0]["theta"]["E"]).log10()) - 4.3) < 0.094


def test_the_compass_ends_within_a_fraction_of_the_grid_step_of_the_minimum():
    """Of a convex bowl in two regions: halved h times, each region is within step/2^h."""
    goal = (4.13, 5.38)

    def bowl(pair):
        return sum((e - g) ** 2 for (_, e), g in zip(pair, goal, strict=True))

    start = (("identity", 4.0), ("fluid", 5.0))
    for halvings in (1, 2, 4):
        pair, value = compass(bowl, start, bowl(start), (3.0, 4.0, 5.0, 6.0), halvings)
        assert all(abs(e - g) <= 0.5**halvings for (_, e), g in zip(pair, goal, strict=True))
        assert value == bowl(pair) and [law for law, _ in pair] == ["identity", "fluid"]
