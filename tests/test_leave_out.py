"""Leave out what a scene does not need: the feature-elimination matrix.

Each feature is run three ways: absent, present but neutral, present and at work. Where a neutral setting exists, absent
and neutral agree to the last bit; absent, nothing of it is left in the text of the kernels, the launches of a round and
the bytes of a particle or node; at work, it shows in the result, so that the equality above says something.
"""

import dataclasses
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
import torch
import warp as wp

from diffuphy.mpm import (
    Acceleration,
    HalfSpace,
    Scene,
    Schedule,
    Scheme,
    simulate,
)
from diffuphy.mpm.solver import Solver, state_bytes
from tests.mpm.bodies import block
from tests.mpm.bodies import field as material
from tests.mpm.test_kernels import forward, functions

DX = 0.05
FAR = HalfSpace(kind="separate", point=(0.0, 0.0, -100.0), friction=0.5)
FLOOR = HalfSpace(friction=0.5)
FREE = Scheme(half_kick=False, mirror=False, sharpen=False, retain=0.0)
"""No part of the scheme that can be left out."""


@dataclass(frozen=True)
class Feature:
    """Something a scene may do without."""

    absent: Mapping[str, Any]
    """Settings of ``run`` without it."""
    present: Mapping[str, Any]
    """Settings with it, at work."""
    neutral: Mapping[str, Any] | None = None
    """Settings with it, in which it does nothing; None where there are none."""
    words: frozenset[str] = field(default_factory=frozenset)
    """Functions that its kernels call, and those of a scene without it do not."""
    launches: int = 0
    """Kernels a round that go with it."""
    particle: int = 0
    """Numbers of a particle's state that go with it."""
    node: int = 0
    """Rows of a node that go with it."""


def feature(absent, present, neutral=None, words="", **counts):
    return Feature(absent, present, neutral, frozenset(words.split()), **counts)


DEFAULT = Scheme()
VALUES = {
    "yield_stress": 50.0, "hardening": 0.0, "residual": 0.2, "E_N": 1e5, "relaxation_time": 0.01,
    "bulk_relaxation": 0.0,
}  # fmt: skip
"""Parameters with which everything that can act does [SI]."""

HENCKY = dict(elastic=("hencky",), scheme=FREE)
STILL = Schedule(times=(0.0, 1.0), offsets=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))

FEATURES = {
    "plasticity": feature(
        HENCKY, HENCKY | dict(plastic=("von_mises",)), HENCKY | dict(plastic=("von_mises",), yield_stress=1e30),
        "flow", particle=9,
    ),
    "decomposition": feature(
        dict(scheme=FREE), HENCKY, None, "decompose sqrt",
    ),
    "several elastic experts": feature(
        HENCKY, HENCKY | dict(elastic=("hencky", "neo_hookean")),
        HENCKY | dict(elastic=("hencky", "neo_hookean"), first=True),
    ),
    "memory": feature(
        HENCKY | dict(plastic=("von_mises",)), HENCKY | dict(plastic=("von_mises_hardening",), hardening=1e4),
        HENCKY | dict(plastic=("von_mises_hardening",), hardening=0.0), "stress_h", particle=1,
    ),
    "viscous branch": feature(
        dict(scheme=FREE), dict(scheme=FREE, branches=("maxwell",)), None, "branch_stress", particle=9,
    ),
    "walls": feature(
        dict(scheme=FREE), dict(scheme=FREE, walls=(FLOOR,)), dict(scheme=FREE, walls=(FAR,)), "act surface",
    ),
    "friction": feature(
        dict(scheme=FREE, walls=(HalfSpace(),)), dict(scheme=FREE, walls=(FLOOR,)),
        dict(scheme=FREE, walls=(HalfSpace(friction=0.0),)), "length",
    ),
    "moving walls": feature(
        dict(scheme=FREE, walls=(FLOOR,)),
        dict(scheme=FREE, walls=(HalfSpace(friction=0.5, velocity=(0.3, 0.0, 0.0)),)),
        dict(scheme=FREE, walls=(HalfSpace(friction=0.5, schedule=STILL),)),
    ),
    "drives": feature(
        dict(scheme=FREE), dict(scheme=FREE, drives=(Acceleration(acceleration=(5.0, 0.0, 0.0)),)),
        dict(scheme=FREE, drives=(Acceleration(acceleration=(0.0, 0.0, 0.0)),)), "accelerate",
    ),
    "gravity": feature(
        dict(scheme=FREE, gravity=(0.0, 0.0, 0.0)), dict(scheme=FREE), dict(scheme=FREE, gravity=(0.0, 0.0, -0.0)),
    ),
    "retention": feature(
        dict(scheme=FREE), dict(scheme=dataclasses.replace(FREE, retain=1.0)),
    ),
    "sharpening": feature(
        dict(scheme=FREE), dict(scheme=dataclasses.replace(FREE, sharpen=True)), None,
        "sharpened gradient corner", launches=2, node=2,
    ),
    "mirror walls": feature(
        dict(scheme=FREE, walls=(HalfSpace(kind="slip"),)),
        dict(scheme=dataclasses.replace(FREE, mirror=True), walls=(HalfSpace(kind="slip"),)), None,
        "folded image seen", launches=1, node=1,
    ),
    "half kick": feature(dict(scheme=FREE), dict(scheme=dataclasses.replace(FREE, half_kick=True))),
    "elastic contact": feature(
        dict(scheme=FREE, walls=(FLOOR,)),
        dict(scheme=dataclasses.replace(FREE, contact="elastic"), walls=(FLOOR,)), None, "", launches=1, node=1,
    ),
    "gradient": feature(
        dict(), dict(grad=True), dict(grad=True),
    ),
    "sums": feature(
        dict(walls=(FLOOR,)), dict(walls=(FLOOR,), gather=("impulse", "expected_dv")),
        dict(walls=(FLOOR,), gather=("impulse", "expected_dv")), "", launches=1,
    ),
    "diagnostics": feature(dict(), dict(diagnose=True), dict(diagnose=True)),
}  # fmt: skip


DONE: dict[str, SimpleNamespace] = {}
"""Runs by their settings: several claims are about the same one."""


def run(settings: Mapping[str, Any]) -> SimpleNamespace:
    """A block that turns and falls a little, once for all who ask."""
    key = repr(sorted(settings.items()))
    if key not in DONE:
        with pytest.MonkeyPatch.context() as patch:
            DONE[key] = _run(patch, **settings)
    return DONE[key]


def _run(
    patch, *, elastic=("neo_hookean",), plastic=("identity",), branches=(), first=False, walls=(), drives=(),
    scheme=DEFAULT, gravity=(0.0, 0.0, -9.81), grad=False, gather=(), diagnose=False, **theta,
):  # fmt: skip
    """Its states, its kernels, its launches a round, and its bytes."""
    x, vol = block((3, 2, 2), DX, (0.0, 0.0, 0.5 * DX), dtype=torch.float32)
    f = material(len(x), elastic, plastic, E=2e4, dtype=torch.float32, **VALUES | theta)
    f = dataclasses.replace(f, branches=branches)
    if first:
        f = dataclasses.replace(f, w_e=torch.zeros_like(f.w_e).index_fill(1, torch.tensor(0), 1.0))
    scene = Scene(
        dx=DX, fps=60.0, frames=2, lift=None, gravity=gravity, velocity=(0.2, 0.1, -0.5), spin=(1.0, 2.0, 3.0),
        boundaries=walls, drives=drives, scheme=scheme,
    )  # fmt: skip
    solvers, launched, launch = [], [], wp.Launch.launch

    def made(*args, **options):
        solvers.append(Solver(*args, **options))
        return solvers[-1]

    patch.setattr(sys.modules["diffuphy.mpm.rollout"], "Solver", made)
    patch.setattr(wp.Launch, "launch", lambda self, *a, **k: (launched.append(1), launch(self, *a, **k))[1])
    report: list[Any] = []
    states = list(simulate(scene, x, vol, f, grad=grad, gather=gather, diagnose=diagnose, report=report))
    v = solvers[-1].variant
    kernels = forward(v)
    rounds = sum(r.n_sub + scheme.half_kick for r in report)
    nodes = {n: t for n, t in solvers[-1]._args._nodes.items() if len(t) >= report[-1].grid.nodes and n != "impulse"}
    return SimpleNamespace(
        states=states, variant=v, kernels=kernels, launches=len(launched) / rounds, particle=state_bytes(states[-1]),
        functions=frozenset().union(*(functions(k) for k in kernels)), nodes=set(nodes), count=len(x), rounds=rounds,
        reports=report,
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
def test_absent_it_leaves_no_trace(name):
    """Kernels, launches a round, numbers a particle and rows a node, with the feature and without."""
    feature = FEATURES[name]
    absent, present = run(feature.absent), run(feature.present)
    assert feature.words <= present.functions, "the words do tell"
    assert not feature.words & absent.functions
    assert absent.functions <= present.functions | {"log", "direct"}
    assert present.launches - absent.launches == feature.launches
    assert present.particle - absent.particle == 4 * feature.particle * absent.count
    assert len(present.nodes - absent.nodes) == feature.node and absent.nodes <= present.nodes
