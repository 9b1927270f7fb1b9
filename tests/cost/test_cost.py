"""What a run will cost is counted right; and the prices are those of the file."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from diffuphy import cost
from diffuphy.cost import machine, rollouts
from diffuphy.cost.body import BLOAT, body, gaussians
from diffuphy.cost.rollouts import Laws
from diffuphy.cost.stages import STAGES
from diffuphy.cost.substeps import rounds
from diffuphy.errors import Estimate
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.material import ELASTIC, PLASTIC, make_mixture
from diffuphy.material.branch import BRANCHES
from diffuphy.mpm import HalfSpace, Sample, Scene, Scheme, Solver, simulate
from diffuphy.mpm.engine.launch import Bound
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import REAL, Rows, initial_state, make_matter, state_bytes
from diffuphy.mpm.trajectory import Simulate
from diffuphy.plan import make_plan
from diffuphy.render import Film
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.refine.rules import Rules
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Look, MaterialField, Motion, Prompt

ROOT = Path(__file__).parents[2]
DROP = Prompt(Look("ball", "a ball"), Motion("falling", "a ball falling", {"": "rubber"}))


def components(**changed):
    library = Library()
    made = {
        "prompt": Rules(prompt="a ball falling"),
        "gaussians": FitGaussians(guidance=Analytic(layout="views", references=library)),
        "particles": Sample(),
        "material": FitMaterial(guidance=Analytic(layout="clip", s=0.0), library=library),
        "trajectory": Simulate(),
        "clip": Film(),
    }
    made |= {stage: dataclasses.replace(made[stage], **settings) for stage, settings in changed.items()}
    return make_plan(made, DROP).components


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The yardstick's result goes to a folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine.pace.cache_clear()
    yield tmp_path / "diffuphy" / "pace.json"
    machine.pace.cache_clear()


def cube(n, dtype=torch.float32, laws=(("neo_hookean",), ("identity",), ())):
    """n³ particles, 8 a cell of 0.05 m, with every parameter a law can ask for."""
    a = (torch.arange(n, dtype=dtype) + 0.5) * 0.025
    x = torch.cartesian_prod(a, a, a) + 0.1
    known = {p.name: p.default for r in (ELASTIC, PLASTIC, BRANCHES) for law in r.values() for p in law.params}
    params = make_mixture(*laws[:2], REAL[dtype], laws[2]).params
    theta = {p: torch.full((len(x),), known[p], dtype=dtype) for p in params}
    weights = [torch.full((len(x), len(k)), 1 / len(k), dtype=dtype) for k in laws[:2]]
    rho = torch.full((len(x),), 1000.0, dtype=dtype)
    return x, torch.full((len(x),), 0.025**3, dtype=dtype), MaterialField(*laws[:2], *weights, theta, rho, laws[2])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "laws",
    [
        (("neo_hookean",), ("identity",), ()),
        (("hencky", "neo_hookean"), ("identity", "von_mises"), ()),
        (("hencky",), ("von_mises_hardening",), ()),
        (("neo_hookean",), ("identity",), ("maxwell",)),
    ],
    ids=lambda laws: "+".join(name for names in laws for name in names),
)
def test_bytes_of_a_particle_are_those_of_its_tensors(laws, dtype):
    """row = 3 u + 3 v + 9 C + 9 He (+ 9 H + memory + 9 HN);  matter = w_e + w_p + θ + m + V_0."""
    x, vol, field = cube(2, dtype, laws)
    mixture = make_mixture(*laws[:2], REAL[dtype], laws[2])
    matter = make_matter(field, vol, mixture.params, dtype)
    scene = Scene(dx=0.05)
    state = initial_state(scene, x, matter, mixture)
    solver = Solver(mixture, (), scene.gravity, dtype, "cpu", particles=len(x), dx=0.05)
    rows = Rows(solver.variant, state, slots=1)
    stored = sum(t.nbytes for t in rows.take(0) if t is not None)
    double = dtype == torch.float64
    mine = Laws.of_mixture(mixture)
    assert rollouts.row_bytes(mine, double) * len(x) == stored == state_bytes(state)
    unit = 8 if double else 4
    identity = (len(laws[1]) - len([p for p in laws[1] if p != "identity"])) if len(laws[1]) > 1 else 0
    counted = (rollouts.matter_bytes(mine, double) + identity * unit) * len(x)  # a weight of no law costs its place
    assert counted == sum(t.nbytes for t in matter.tensors())


@pytest.mark.parametrize("scheme", [Scheme(), Scheme.mls(), Scheme(mirror=False, sharpen=False, contact="elastic")])
@pytest.mark.parametrize("grad", [False, True])
def test_bytes_of_a_node_are_those_of_its_buffers(scheme, grad):
    """Every buffer that a frame takes has a row of eight numbers a node, or a single row when it is not needed."""
    x, vol, field = cube(2)
    mixture = make_mixture(("neo_hookean",), ("identity",), REAL[x.dtype])
    matter = make_matter(field, vol, mixture.params, x.dtype)
    walls = (HalfSpace(friction=0.5),)
    solver = Solver(
        mixture, walls, (0, 0, -9.81), x.dtype, "cpu", particles=len(x), dx=0.05, scheme=scheme, grad=grad,
        extent=([0.1] * 3, [0.15] * 3),
    )  # fmt: skip
    state = initial_state(Scene(dx=0.05), x, matter, mixture)
    span = Span(Grid.around((0.0,) * 3, (0.3,) * 3, 0.05), 0.0, 1e-4, 2, 1.0, scheme.retain, scheme.half_kick)
    Bound(solver._args, Rows(solver.variant, state, 1), matter, span, None)
    big = [t for t in solver._args._nodes.values() if len(t) >= span.grid.nodes]
    back = grad * (3 + scheme.sharpen) * 32  # bar, y, out; and those of the sharpening
    assert rollouts.node_bytes(scheme, False, grad=grad) - back == 32 * len(big)


@pytest.mark.parametrize("lift", [0.0, 0.3])
@pytest.mark.parametrize("E", [1e4, 1e5])
def test_rounds_are_those_that_the_clock_takes(lift, E):
    """Σ ⌈(c + V) T/(cfl Δx)⌉ + 1; falling freely V is known, so that only ⌈⌉ of stiffening is left: 3 %."""
    x, vol, field = cube(4)
    field = dataclasses.replace(field, theta=field.theta | {"E": torch.full_like(vol, E)})
    scene = Scene(dx=0.05, frames=6, lift=lift, boundaries=(HalfSpace(friction=0.5),))
    report = []
    for _ in simulate(scene, x, vol, field, report=report):
        pass
    taken = sum(r.n_sub + 1 for r in report)
    assert rounds(scene, report[0].wave, 0.0) == pytest.approx(taken, rel=0.03)


@pytest.mark.parametrize("double", [False, True])
def test_every_law_scheme_and_precision_has_a_price(double):
    for elastic in ELASTIC:
        for plastic in PLASTIC:
            for branches in ((), *((b,) for b in BRANCHES)):
                for scheme in (Scheme(), Scheme.mls(), Scheme(order=3, force="classic")):
                    laws = Laws.of((elastic,), (plastic,), branches)
                    work = rollouts.forward(1000, 100, 1, 2000, laws, scheme, double=double)
                    back = rollouts.backward(1000, 100, 2000, laws, scheme, kept=True, double=double)
                    assert cost.price(work) > 0 and cost.price(back) > cost.price(work)


def test_every_stage_is_predicted_in_order():
    found = cost.predict(components(), DROP)
    assert list(found.stages) == list(STAGES) == ["prompt", "gaussians", "particles", "material", "trajectory", "clip"]
    assert found.seconds == pytest.approx(sum(s.seconds for s in found.stages.values()))
    assert found.bytes == max(s.bytes for s in found.stages.values())
    assert all(0 < s.seconds <= s.processor for s in found.stages.values())


def test_a_rollout_is_paid_by_the_particle_and_substep():
    """seconds = R (round + N (particle + Σ law) + M node): linear in R, and in N up to the surface of the block."""
    mixture = make_mixture(("hencky",), ("von_mises",))
    one, twice, more = (cost.simulation(n, s, mixture, Scheme(), torch.float32) for n, s in
                        ((10_000, 100), (10_000, 200), (80_000, 100)))  # fmt: skip
    assert twice.seconds == pytest.approx(2 * one.seconds)
    assert 5 * one.seconds < more.seconds < 8 * one.seconds
    assert twice.bytes == one.bytes


def test_what_a_scene_does_not_need_costs_nothing():
    """No plasticity: fewer units; no training: no gradient among them; no shadow: nobody pays for one."""
    plain = Laws.of(("neo_hookean",), ("identity",))
    assert set(plain.units()) == {"direct.neo_hookean"}
    found = cost.predict(components(material={"steps": 0}, clip={"shadow": 0.0}), DROP)
    work = {unit: n for stage in found.stages.values() for unit, n in stage.work.items() if n}
    assert not [unit for unit in work if unit.startswith("back.particle") or unit == "train.flop"]
    assert "shadow.particle" not in work


def test_known_particles_replace_the_guess():
    small, large = (cost.predict(components(), DROP, particles=n).stages["trajectory"] for n in (5000, 20_000))
    # N Δt⁻¹ ∝ N^(4/3) for particles, less for the surface of the block and for what is paid once a round
    assert 4 < large.processor / small.processor < 4 ** (4 / 3)


def test_a_ball_fills_what_a_ball_fills():
    """(π/6)(1 + bloat)³ of its cube; the lattice that measures it is good to 1 % in length."""
    found = body(components(), DROP)
    assert found.volume == pytest.approx(torch.pi / 6 * (1 + BLOAT) ** 3 * found.size**3, rel=0.03)
    assert found.extent == pytest.approx((found.size * (1 + BLOAT),) * 3, rel=0.01)


def test_gaussians_grow_from_their_first_to_their_largest_number():
    fit = components()["gaussians"]
    first, last, mean = gaussians(fit)
    assert first == fit.init.count < mean < last <= fit.densify.max_count
    still = dataclasses.replace(fit, densify=None)
    assert gaussians(still) == (first, first, first)


def test_the_yardstick_is_read_once_and_kept(cache, monkeypatch):
    calls = []
    monkeypatch.setattr(machine, "measure", lambda device: calls.append(device) or 0.04)
    assert machine.pace(0.02) == pytest.approx(2.0)
    machine.pace.cache_clear()
    assert machine.pace(0.01) == pytest.approx(4.0)
    assert calls == ["cpu"] and list(json.loads(cache.read_text()).values()) == [0.04]


def test_prices_scale_with_the_pace_of_the_machine(monkeypatch):
    table = cost.coefficients()
    monkeypatch.setattr(machine, "measure", lambda device: 3.0 * table["yardstick"])
    assert cost.price({"round": 1.0}) == pytest.approx(3.0 * table["seconds"]["round"])


def test_a_cache_that_cannot_be_written_costs_only_time(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(machine, "measure", lambda device: 0.04)
    assert machine.pace(0.02) == pytest.approx(2.0)


def test_nothing_is_measured_at_import(tmp_path):
    code = "import diffuphy.cost, os, pathlib; print(*pathlib.Path(os.environ['XDG_CACHE_HOME']).rglob('pace.json'))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True,
        env={"XDG_CACHE_HOME": str(tmp_path), "PATH": "", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stdout.strip() == ""


def test_a_unit_without_a_price_is_an_error_that_says_how_to_get_one():
    with pytest.raises(KeyError, match=r"no price for teleport.*benchmarks speed"):
        cost.price({"teleport": 1.0})


def test_coefficients_are_few_and_readable():
    table = json.loads(cost.COEFFICIENTS.read_text())["cpu"]
    assert set(table) >= {"machine", "yardstick", "seconds", "bytes"}
    assert all(v >= 0 for kind in ("seconds", "bytes") for v in table[kind].values())


def test_a_draft_that_the_scene_refuses_costs_nothing():
    """A finger 0.2 m thick stands on three nodes of the film's grid, not on three of a draft's: the stage makes no
    estimate, and the forecast does not fail where the stage does not."""
    poked = Prompt(DROP.look, dataclasses.replace(DROP.motion, verb="poked"))
    made = components() | {"errors": Estimate()}
    found = cost.predict(made, poked, particles=4000)
    assert found.stages["trajectory"].seconds > 0 == found.stages["errors"].seconds
    assert cost.predict(made, poked, particles=50_000).stages["errors"].seconds > 0
