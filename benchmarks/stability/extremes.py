"""Extreme input: the contract cases of the verification, what each refusal says, and how far from the origin float32
goes."""

import dataclasses
import math
from collections.abc import Callable

import torch

from benchmarks.stability.cells import CELLS, DTYPES, DX, SIDE, Cell, field, scene_of, wave
from benchmarks.stability.verdict import Verdict
from benchmarks.verification import CASES, SETTINGS
from benchmarks.verification.bodies import block
from diffuphy.mpm import Scene, Sphere, simulate
from diffuphy.types import SimulationDiverged

PLACES = (0.0, 1e2, 1e3, 1e4, 1e5, 1e6)
"""Distances from the origin [m]."""


def contracts(ids: tuple[str, ...] | None = None) -> list[dict[str, object]]:
    """The cases D1 … D17 of the daily verification: how many checks, and which fail."""
    rows = []
    for case in sorted((c for c in CASES.values() if c.id.startswith("D") and c.tier == 0), key=lambda c: c.place):
        if ids is not None and case.id not in ids:
            continue
        checks = case.measure(SETTINGS["default"])
        outside = [str(check) for check in checks if not check.ok]
        rows.append({"id": case.id, "title": case.title, "checks": len(checks), "outside": outside})
    return rows


def _simulated(
    scene: Scene | None = None, change: Callable[[dict[str, torch.Tensor]], None] | None = None, **options: object
) -> None:
    """A cube that vibrates, with something about it changed."""
    body = block((CELLS,) * 3, DX)
    material = field("hencky, von_mises", len(body.x), 1e5, 0.3, 1e-2, torch.float64)
    tensors = {"x": body.x, "vol": body.vol, "rho": material.rho, **material.theta}
    if change is not None:
        change(tensors)
    theta = {k: tensors[k] for k in material.theta}
    material = dataclasses.replace(material, theta=theta, rho=tensors["rho"])
    made = scene or dataclasses.replace(scene_of(Cell("hencky")), boundaries=(), lift=None)
    list(simulate(made, tensors["x"], tensors["vol"], material, **options))  # type: ignore[arg-type]


def _set(name: str, value: float) -> Callable[[dict[str, torch.Tensor]], None]:
    def change(tensors: dict[str, torch.Tensor]) -> None:
        tensors[name][7] = value

    return change


def _inside_out() -> None:
    body = block((CELLS,) * 3, DX)
    material = field("hencky", len(body.x), 1e5, 0.3, 1e-2, torch.float64)
    scene = dataclasses.replace(scene_of(Cell("hencky")), boundaries=(), lift=None)
    first = next(simulate(scene, body.x, body.vol, material))
    He = first.He.clone()
    He[7] = torch.diag(He.new_tensor([0.0, 0.0, -1.5]))
    list(simulate(scene, body.x, body.vol, material, state=dataclasses.replace(first, He=He)))


def _pushed() -> None:
    """By a force of which the clock knows nothing."""
    push = torch.zeros(8 * CELLS**3, 3, dtype=torch.float64)
    push[:, 0] = 1e7
    _simulated(body=lambda _: push)


def _sprayed() -> None:
    """A drop alone at a pinned step that a body would bear."""
    drop = block((0.5, 0.5, 0.5), DX)
    material = field("fluid_eos, fluid", 1, 1e5, 0.3, 1e-2, torch.float64)
    scene = dataclasses.replace(scene_of(Cell("fluid_eos, fluid", speed=0.0)), boundaries=(), lift=None, fps=20.0)
    first = next(simulate(scene, drop.x, drop.vol, material))
    first = dataclasses.replace(first, C=first.C + 0.1 * torch.eye(3, dtype=torch.float64))
    c = wave(Cell("fluid_eos, fluid"))
    list(simulate(scene, drop.x, drop.vol, material, state=first, dt=0.7 * DX / c))


def _spread(tensors: dict[str, torch.Tensor]) -> None:
    tensors["x"][0] = torch.tensor([1e5, 1e5, 1e5], dtype=torch.float64)


def _half(tensors: dict[str, torch.Tensor]) -> None:
    tensors["x"] = tensors["x"].half()


def _far(tensors: dict[str, torch.Tensor]) -> None:
    tensors["x"] = tensors["x"].float() + 1e6


REFUSALS: dict[str, Callable[[], None]] = {
    "a pinned step ten times too long": lambda: _simulated(dt=0.04),
    "a film of a second every eleven days": lambda: _simulated(dataclasses.replace(Scene(boundaries=()), fps=1e-6)),
    "a cfl beyond what is stable": lambda: _simulated(Scene(cfl=0.9)),
    "ν = ½": lambda: _simulated(change=_set("nu", 0.5)),
    "E < 0": lambda: _simulated(change=_set("E", -1.0)),
    "a yield stress below zero": lambda: _simulated(change=_set("yield_stress", -1.0)),
    "no density": lambda: _simulated(change=_set("rho", 0.0)),
    "a place that is no number": lambda: _simulated(change=_set("x", math.nan)),
    "a velocity that is no number": lambda: _simulated(velocity=torch.tensor([0.0, math.nan, 0.0])),
    "half precision": lambda: _simulated(change=_half),
    "float32 a thousand kilometres from the origin": lambda: _simulated(change=_far),
    "a particle a hundred kilometres away": lambda: _simulated(change=_spread),
    "a body inside out": _inside_out,
    "a force of a million g that the clock does not know of": _pushed,
    "a drop alone, with a step pinned at 0.7 Δx/c": _sprayed,
    "a particle that leaves the bounds": lambda: _simulated(
        Scene(dx=DX, boundaries=(), lift=None, bounds=((-1.0,) * 3, (0.2,) * 3), velocity=(1.0, 0.0, 0.0))
    ),
    "a wall thinner than three cells": lambda: _simulated(Scene(dx=DX, boundaries=(Sphere(radius=DX),))),
}
"""Input that is to be refused."""


def refusals() -> list[dict[str, str]]:
    """What is said to each; silent, in the terms of the map, where nothing is."""
    rows = []
    for name, provoke in REFUSALS.items():
        try:
            provoke()
            verdict = Verdict("silent", "nothing was said")
        except (ValueError, SimulationDiverged) as error:
            verdict = Verdict("error", str(error))
        except Exception as error:
            verdict = Verdict("silent", f"{type(error).__name__}: {error}")
        rows.append({"input": name, "kind": verdict.kind, "why": verdict.why})
    return rows


def far() -> list[dict[str, object]]:
    """Change of the velocities of a vibrating cube with its distance from the origin, over themselves, or the refusal;
    places round to ε|x|/2, and so do weights, in Δx."""
    rows = []
    for precision, dtype in DTYPES.items():
        ends: dict[float, torch.Tensor] = {}
        for place in PLACES:
            body = block((CELLS,) * 3, DX)
            material = field("neo_hookean", len(body.x), 1e5, 0.3, 1e-2, dtype)
            c = wave(Cell("neo_hookean"))
            scene = dataclasses.replace(
                scene_of(Cell("neo_hookean", speed=0.0)), boundaries=(), lift=None, fps=c / (3 * SIDE), frames=2
            )
            x = (body.x + body.x.new_tensor([place, 0.0, 0.0])).to(dtype)
            row: dict[str, object] = {"precision": precision, "place": place}
            try:
                *_, end = simulate(
                    scene, x, body.vol.to(dtype), material, velocity=(0.03 * c * torch.sin(30.0 * body.x)).to(dtype)
                )
            except (ValueError, SimulationDiverged) as error:
                rows.append(row | {"change": None, "why": str(error)})
                continue
            ends[place] = end.v.double()
            change = float((ends[place] - ends[0.0]).norm() / ends[0.0].norm())
            rows.append(row | {"change": change, "theory": torch.finfo(dtype).eps / 2 * place / DX, "why": ""})
    return rows
