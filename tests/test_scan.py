"""The scan: hypotheses are compared, also when some of them cannot be simulated."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from diffuphy.scan import scan
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
    """The nearest to 5 of those that can; the log counts the others, and quotes one."""
    assert best(torn=0.0) == pytest.approx(4.75)
    assert not caplog.records or "cannot be simulated" not in caplog.text
    assert best(torn=4.9) == pytest.approx(6.0)
    assert "3 of 4 hypotheses cannot be simulated: particle 3 was turned inside out" in caplog.text


def test_if_nothing_can_be_simulated_the_reason_is_raised():
    with pytest.raises(SimulationDiverged, match="turned inside out"):
        best(torn=7.0)
