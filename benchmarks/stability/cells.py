"""One cell of the map: a body of one material thrown at a floor, and what is measured on it.

A cube of three cells along each side, with 8 particles in each, hits a rough floor aslant at a given share of its speed
of sound c, under a weight of 1 % of its stiffness, for 6 L/c: waves cross it six times. All times, speeds and stresses
of the material are in units of L/c, c and E, so that stiffness alone changes nothing but units.
"""

import dataclasses
import itertools
import math
import time
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.stability.verdict import Verdict, classify
from benchmarks.verification.bodies import Body, block
from diffuphy.material import ELASTIC, PLASTIC, make_mixture
from diffuphy.material.branch import BRANCHES
from diffuphy.mpm import FrameReport, HalfSpace, Scene, Scheme, State, simulate
from diffuphy.mpm.diagnostics import diagnose
from diffuphy.mpm.state import REAL, Matter, make_matter
from diffuphy.types import MaterialField, SimulationDiverged

DX, CELLS, RHO = 0.05, 3, 1000.0
SIDE = CELLS * DX
TRANSITS, FRAMES = 6.0, 12
WEIGHT = 0.01
"""g L/c² [-]."""
STILL = 0.01
"""Share of the energy put in below which a body is taken to rest [-]."""
LONG = 10.0
"""Crossings of a wave in a frame beyond which two such frames are a rest and no turning point [-]."""
DTYPES = {"float64": torch.float64, "float32": torch.float32}

Laws = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Elastic laws, plastic laws and branches."""

MATTERS: dict[str, Laws] = {
    **{law: ((law,), ("identity",), ()) for law in ELASTIC if law != "fluid_eos"},
    "fluid_eos, fluid": (("fluid_eos",), ("fluid",), ()),
    **{f"hencky, {law}": (("hencky",), (law,), ()) for law in PLASTIC if law != "identity"},
    "neo_hookean, maxwell": (("neo_hookean",), ("identity",), ("maxwell",)),
    "three and three": (
        ("neo_hookean", "fixed_corotated", "hencky"),
        ("identity", "von_mises", "drucker_prager"),
        (),
    ),
}
"""Every elastic law, every plastic law beside that for which return maps are exact, a branch, and a mixture."""


@dataclass(frozen=True)
class Cell:
    """A point of the map."""

    matter: str
    """Key in ``MATTERS``."""
    E: float = 1e5
    """Young's modulus [Pa]."""
    nu: float = 0.3
    """Poisson's ratio [-]."""
    speed: float = 0.1
    """Speed of impact [c]."""
    cfl: float = 0.4
    """As of ``Scene``."""
    precision: str = "float64"
    """Key in ``DTYPES``."""
    yields: float = 1e-2
    """Stress at which plastic laws begin to flow [E]."""
    contact: str = "elastic"
    """As of ``Scheme``; films are made with "elastic"."""
    side: int = CELLS
    """Side of the body [Δx]; times are in units of three, whatever it is."""


@dataclass(frozen=True)
class Outcome:
    """A cell and what became of it."""

    cell: Cell
    verdict: Verdict
    measured: dict[str, float]
    """Numbers by the names of ``LIMITS``."""
    lost: float = math.nan
    """Energy lost in all, of that put in [-]."""
    substeps: int = 0
    halvings: int = 0
    """How often a substep was halved."""
    seconds: float = 0.0
    """Process time."""
    cured: str = ""
    """What becomes of it at a third of the speed, if it ended with an error."""


def field(matter: str, n: int, E: float, nu: float, yields: float, dtype: torch.dtype) -> MaterialField:
    """The material, its parameters in units of E and of the time in which a wave crosses the body."""
    elastic, plastic, branches = MATTERS[matter]
    crossing = SIDE / math.sqrt(E / RHO)
    stress = yields * E
    values = {
        "E": E,
        "nu": nu,
        "bulk_modulus": E / (3 * (1 - 2 * nu)),
        "yield_stress": stress,
        "hardening": 0.1 * E,
        "viscosity": stress * crossing,
        "consistency": stress * crossing**0.5,
        "preconsolidation": stress,
        "melt_time": crossing,
        "E_N": E,
        "relaxation_time": crossing,
    }
    laws = [ELASTIC[k] for k in elastic] + [PLASTIC[k] for k in plastic] + [BRANCHES[k] for k in branches]
    one = torch.ones(n, dtype=dtype)
    theta = {p.name: values.get(p.name, p.default) * one for law in laws for p in law.params}
    weights = [one[:, None].expand(n, len(laws)) / len(laws) for laws in (elastic, plastic)]
    return MaterialField(elastic, plastic, *weights, theta, RHO * one, branches)


def wave(cell: Cell) -> float:
    """Speed of sound c of the material at rest [m/s]."""
    if cell.matter.startswith("fluid_eos"):
        return math.sqrt(cell.E / (3 * (1 - 2 * cell.nu)) / RHO)
    nu = cell.nu
    c = math.sqrt(cell.E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / RHO)
    return c * math.sqrt(2.0) if "maxwell" in cell.matter else c


def scene_of(cell: Cell) -> Scene:
    """A rough floor, and a body that comes down on it aslant."""
    c = wave(cell)
    way = (0.3, 0.1, -math.sqrt(1 - 0.3**2 - 0.1**2))
    return Scene(
        gravity=(0.0, 0.0, -WEIGHT * c * c / SIDE),
        dx=DX,
        fps=FRAMES * c / (TRANSITS * SIDE),
        frames=FRAMES,
        velocity=tuple(cell.speed * c * a for a in way),  # type: ignore[arg-type]
        boundaries=(HalfSpace(friction=0.3),),
        lift=0.25 * DX,
        cfl=cell.cfl,
        scheme=Scheme(contact=cell.contact),  # type: ignore[arg-type]
    )


def run(cell: Cell, twin: Tensor | None = None) -> tuple[Outcome, Tensor | None]:
    """What becomes of a cell, and where its particles are at the end.

    Args:
        twin: where they are in float64.
    """
    return play(cell, scene_of(cell), twin)


def run_pair(cell: Cell) -> list[Outcome]:
    """A cell in float64 and in float32, the second held against the first; with the remedy where there is an error."""
    double, end = run(dataclasses.replace(cell, precision="float64"))
    single, _ = run(dataclasses.replace(cell, precision="float32"), end)
    return [remedied(o) for o in (double, single)]


def remedied(outcome: Outcome) -> Outcome:
    """The same, with what "slow it down" does to an error."""
    if outcome.verdict.kind != "error":
        return outcome
    slow, _ = run(dataclasses.replace(outcome.cell, speed=outcome.cell.speed / 3))
    return dataclasses.replace(outcome, cured=slow.verdict.kind)


def play(cell: Cell, scene: Scene, twin: Tensor | None = None) -> tuple[Outcome, Tensor | None]:
    """What becomes of the body of a cell in a scene, and where its particles are at the end."""
    body = block((cell.side,) * 3, DX)
    dtype = DTYPES[cell.precision]
    material = field(cell.matter, len(body.x), cell.E, cell.nu, cell.yields, dtype)
    reports: list[FrameReport] = []
    states: list[State] = []
    error, foreign, begin = None, False, time.process_time()
    try:
        x, vol = body.x.to(dtype), body.vol.to(dtype)
        for state in simulate(scene, x, vol, material, report=reports, gather=("impulse",)):
            states.append(state)
    except (ValueError, SimulationDiverged) as e:
        error = str(e)
    except Exception as e:  # a crash is a result of this benchmark, and the worst
        error, foreign = f"{type(e).__name__}: {e}", True
    counts = sum(r.n_sub for r in reports), sum(r.halvings for r in reports), time.process_time() - begin
    if error is not None:
        return Outcome(cell, classify({}, error, foreign), {}, math.nan, *counts), None
    measured, lost = measure(cell, body, scene, states, reports)
    end = states[-1].x.double()
    if twin is not None:
        measured["apart"] = float((end - twin).square().sum(1).mean().sqrt()) / SIDE
    return Outcome(cell, classify(measured), measured, lost, *counts), end


def measure(
    cell: Cell, body: Body, scene: Scene, states: list[State], reports: list[FrameReport]
) -> tuple[dict[str, float], float]:
    """The numbers of ``LIMITS``, and the share of energy lost; in float64 whatever the run was in. NaN, all of them, if
    anything in a state is not finite."""
    tensors = [t for s in states for t in s.tensors() if t is not None]
    if not all(bool(torch.isfinite(t).all()) for t in tensors):
        return dict.fromkeys(("gain", "momentum", "shrunk", "sunk"), math.nan), math.nan
    gain, put, last, stirred = books(cell, body, scene, states)
    J = torch.stack([torch.linalg.det(s.He.double() + torch.eye(3, dtype=torch.float64)) for s in states])
    low = min(float(s.x[:, 2].min()) for s in states)
    measured = {
        "gain": gain / put,
        "momentum": imbalance(cell, body, scene, states, reports),
        "shrunk": max(float(J.max()), 1 / float(J.min())) if float(J.min()) > 0 else math.nan,
        "sunk": max(0.0, -low / DX),
    }
    if wave(cell) / scene.fps > LONG * SIDE:
        measured["stirred"] = stirred / put
    return measured, -last / put


def books(cell: Cell, body: Body, scene: Scene, states: list[State]) -> tuple[float, float, float, float]:
    """Largest rise of the energy, energy put in, rise at the end, and largest rise after a rest [J]."""
    elastic, plastic, branches = MATTERS[cell.matter]
    mixture = make_mixture(elastic, plastic, REAL[torch.float64], branches)
    material = field(cell.matter, len(body.x), cell.E, cell.nu, cell.yields, torch.float64)
    matter: Matter = make_matter(material, body.vol, mixture.params, torch.float64, False)
    g, m = body.x.new_tensor(scene.gravity), matter.m
    energies, works = [], []
    for state in states:
        exact = State(*(None if t is None else t.double() for t in state.tensors()), state.time)  # type: ignore[arg-type]
        d = diagnose(mixture, exact, matter, DX, scene.scheme)
        energies.append(d.kinetic + d.elastic)
        works.append(float((exact.x @ g * m).sum()))
    rises = [e - energies[0] - (w - works[0]) for e, w in zip(energies, works, strict=True)]
    put = energies[0] + max(works) - works[0]
    return max(rises), put, rises[-1], after_rest(energies, rises, STILL * put)


def after_rest(energies: list[float], rises: list[float], still: float) -> float:
    """The largest rise from the first of two times in a row at which the energy was below ``still``; 0 without one."""
    rests = [k for k, pair in enumerate(itertools.pairwise(energies)) if max(pair) < still]
    return max(rises[rests[0] :]) - rises[rests[0]] if rests else 0.0


def imbalance(cell: Cell, body: Body, scene: Scene, states: list[State], reports: list[FrameReport]) -> float:
    """Momentum that nothing accounts for, over that of rounding [-]."""
    m, S = RHO * body.vol[:, None], sum(r.n_sub for r in reports)
    before, after = ((m * s.v.double()).sum(0) for s in (states[0], states[-1]))
    M, t, g = float(m.sum()), states[-1].time, before.new_tensor(scene.gravity)
    impulse = torch.stack([r.impulse.double() for r in reports if r.impulse is not None]).sum(0)
    scale = M * (float(states[0].v.double().norm(dim=1).max()) + float(g.norm()) * t)
    eps = torch.finfo(DTYPES[cell.precision]).eps
    return float((after - before - M * g * t - impulse).norm()) / (27 * math.sqrt(S) * eps * scale)
