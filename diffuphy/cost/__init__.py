"""What a run will cost: predicted before it starts from a few measured prices.

    seconds = pace · Σ_units price · count,      bytes = base + Σ_kinds factor · size

Counts follow from the components (``stages``, ``rollouts``); prices are those of ``coefficients.json``, which
``python -m benchmarks speed`` measures; ``pace`` is how fast this machine is (``machine``). Nothing is measured at
import. Kernels that have not been compiled yet are compiled on the way, which is not counted.
"""

import json
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import torch

from diffuphy.cost import machine
from diffuphy.cost.body import body
from diffuphy.cost.drafts import errors, wanted
from diffuphy.cost.result import Cost, StageCost
from diffuphy.cost.rollouts import Laws
from diffuphy.cost.scores import judges, scores
from diffuphy.cost.stages import STAGES, single
from diffuphy.types import Prompt

__all__ = ["COEFFICIENTS", "Cost", "StageCost", "coefficients", "predict", "price", "simulation"]

COEFFICIENTS = Path(__file__).with_name("coefficients.json")
"""The measured prices."""

SHARED = 0.85
"""How much of a second core's time helps when a rollout runs on two threads; the rest is waiting at barriers [-]."""


@cache
def coefficients(device: str = "cpu") -> dict[str, Any]:
    """Measured prices for a kind of device: ``machine``, ``yardstick`` [s], ``seconds`` a unit, ``bytes`` a kind.

    A kind that nobody has measured yet takes those of a processor, scaled by the yardstick: an order of magnitude.
    """
    known = json.loads(COEFFICIENTS.read_text(encoding="utf-8"))
    return known.get(device.partition(":")[0], known["cpu"])


def price(work: Mapping[str, float], device: str = "cpu") -> float:
    """Processor time of some work on this machine [s].

    Raises:
        KeyError: a unit that was never measured.
    """
    table = coefficients(device)
    prices = table["seconds"]
    if missing := sorted(unit for unit, count in work.items() if count and unit not in prices):
        raise KeyError(f"no price for {', '.join(missing)}; measure them: python -m benchmarks speed")
    return machine.pace(table["yardstick"], device) * sum(prices[unit] * n for unit, n in work.items() if n)


def predict(
    components: Mapping[str, Any],
    prompt: Prompt,
    *,
    particles: int | None = None,
    device: str = "cpu",
    threads: int | None = None,
) -> Cost:
    """Time and memory of a run, stage by stage.

    Args:
        components: one a stage, by stage name, as of the plan: with no expert left open.
        prompt: the refined sentence.
        particles: how many there will be, where it is known; else the shape of the object tells.
        device: where it runs.
        threads: processor cores to run on; by default those there are.
    """
    what, table = body(components, prompt, particles), coefficients(device)
    cores = threads or os.cpu_count() or 1
    stages = {}
    every = {name: (count, name) for name, count in STAGES.items()}
    every |= {"errors": (errors, "trajectory")} if wanted(components) else {}  # the same code once more
    every |= {"evaluate": (scores, "clip")} if judges(components) else {}
    for name, (count, code) in every.items():
        counted = count(components, prompt.motion, what)
        seconds = price(counted.work, device)
        saved = _shared(counted.spread, device, min(counted.lanes, cores))
        stages[name] = StageCost(seconds - saved, _bytes(code, counted.sizes, table), seconds, counted.work)
    pace = machine.pace(table["yardstick"], device)
    return Cost(stages, f"{table['machine']}; this one takes {pace:.2f} of its time")


def simulation(
    particles: int, substeps: int, mixture: Any, scheme: Any, dtype: torch.dtype, device: str = "cpu"
) -> StageCost:
    """Time and memory of one rollout, forward, on one thread.

    Args:
        particles: how many.
        substeps: of all frames together.
        mixture: from ``material.make_mixture``.
        scheme: ``mpm.Scheme``.
        dtype: torch.float32 or torch.float64.
    """
    work, size = single(particles, substeps, Laws.of_mixture(mixture), scheme, dtype == torch.float64)
    seconds = price(work, str(device))
    return StageCost(seconds, round(size), seconds, work)


def _shared(work: Mapping[str, float], device: str, lanes: int) -> float:
    """Seconds that further threads take off the time of some work."""
    return 0.0 if device.startswith("cuda") else price(work, device) * SHARED * (1 - 1 / lanes)


def _bytes(stage: str, sizes: Mapping[str, float], table: Mapping[str, Any]) -> int:
    """Peak of the process: what it takes by itself and with the code of a stage, and what the stage keeps."""
    factors = table["bytes"]
    return round(factors["process"] + factors[f"stage.{stage}"] + sum(factors[k] * n for k, n in sizes.items() if n))
