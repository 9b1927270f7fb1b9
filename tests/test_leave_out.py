"""Leave out what a scene does not need: the feature-elimination matrix of ``benchmarks.leaving_out``.

Each feature is run three ways: absent, present but neutral, present and at work. Where a neutral setting exists, absent
and neutral agree to the last bit; absent, nothing of it is left in the text of the kernels, the launches of a round and
the bytes of a particle or node; at work, it shows in the result, so that the equality above says something.
"""

import sys
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest
import torch
import warp as wp

from benchmarks.leaving_out import FEATURES, setting
from diffuphy.mpm.engine.solver import Solver
from diffuphy.mpm.state import state_bytes
from tests.mpm.substep.test_kernels import forward, functions

DONE: dict[str, SimpleNamespace] = {}
"""Runs by their settings: several claims are about the same one."""


def run(settings: Mapping[str, Any]) -> SimpleNamespace:
    """A block that turns and falls a little: its states, kernels, launches a round and bytes; once for all who ask."""
    key = repr(sorted(settings.items()))
    if key not in DONE:
        with pytest.MonkeyPatch.context() as patch:
            DONE[key] = _run(patch, settings)
    return DONE[key]


def _run(patch: pytest.MonkeyPatch, settings: Mapping[str, Any]) -> SimpleNamespace:
    solvers, launched, launch, report = [], [], wp.Launch.launch, []

    def made(*args: Any, **options: Any) -> Solver:
        solvers.append(Solver(*args, **options))
        return solvers[-1]

    patch.setattr(sys.modules["diffuphy.mpm.rollout"], "Solver", made)
    patch.setattr(wp.Launch, "launch", lambda self, *a, **k: (launched.append(1), launch(self, *a, **k))[1])
    s = setting(**settings)
    states = s.states(report)
    kernels, solver = forward(solvers[-1].variant), solvers[-1]
    rounds = sum(r.n_sub + s.scene.scheme.half_kick for r in report)
    nodes = {n for n, t in solver._args._nodes.items() if len(t) >= report[-1].grid.nodes and n != "impulse"}
    return SimpleNamespace(
        states=states, launches=len(launched) / rounds, particle=state_bytes(states[-1]), count=len(s.x), nodes=nodes,
        functions=frozenset().union(*(functions(k) for k in kernels)),
    )  # fmt: skip


def same(a, b) -> bool:
    """Whether two runs went the same way to the last bit: positions, velocities, affine fields, elastic strains."""
    return all(
        torch.equal(getattr(s, name).detach(), getattr(t, name).detach())
        for s, t in zip(a.states, b.states, strict=True)
        for name in ("x", "v", "C", "He")
    )


@pytest.mark.parametrize("name", [n for n, f in FEATURES.items() if f.neutral is not None])
def test_neutral_is_absent_to_the_last_bit(name):
    """x, v, C, F of a run in which the feature does nothing equal those of a run without it, bit by bit."""
    feature = FEATURES[name]
    absent, neutral = run(feature.absent), run(feature.neutral)
    assert same(absent, neutral)


@pytest.mark.parametrize("name", [n for n, f in FEATURES.items() if f.present != f.neutral])
def test_at_work_it_shows(name):
    """The run is one in which the feature matters: with it, the block goes another way."""
    feature = FEATURES[name]
    assert not same(run(feature.absent), run(feature.present))


@pytest.mark.parametrize("name", FEATURES)
def test_what_has_no_neutral_setting_says_why(name):
    assert (FEATURES[name].neutral is None) == bool(FEATURES[name].why_not)


@pytest.mark.parametrize("name", FEATURES)
def test_absent_it_leaves_no_trace(name):
    """Kernels, launches a round, numbers a particle and rows a node, with the feature and without."""
    feature = FEATURES[name]
    absent, present = run(feature.absent), run(feature.present)
    assert feature.words <= present.functions, "the words do tell"
    assert not feature.words & absent.functions
    assert absent.functions <= present.functions | {
        "log",
        "direct",
        "growth",
        "dilation",
        "volume",
    }  # a direct form's own
    assert present.launches - absent.launches == feature.launches
    assert present.particle - absent.particle == 4 * feature.particle * absent.count
    assert len(present.nodes - absent.nodes) == feature.node and absent.nodes <= present.nodes
