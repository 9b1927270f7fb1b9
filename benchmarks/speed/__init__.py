"""How fast every stage is, what it keeps, and the prices from which a plan predicts both.

python -m benchmarks speed                    # this machine: tables, and the prices in diffuphy/cost/coefficients.json
python -m benchmarks speed --device cuda      # the same of a GPU
python -m benchmarks speed --films            # ten films: predicted against measured
python -m benchmarks speed --quick            # to see that it runs; keeps nothing

Times are processor times of one thread, on a GPU those of the clock: the best of some turns for a table of throughput,
medians for pictures. One JSON file a machine; docs/numerics/speed.md is made from all of them.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import torch

from benchmarks.speed import films, network, page, prices, rasteriser, simulation
from benchmarks.speed.body import CASES, SCHEMES, describe
from diffuphy.cost import COEFFICIENTS, machine

ROOT = Path(__file__).resolve().parents[2]
MACHINES = "docs/benchmarks/machines"

SIZES = (1_000, 20_000)
LARGE = (100_000, 1_000_000)
"""Particles of which one case is timed; of the last its forward pass only, whose backward pass would keep 3 GB."""

FILLS = (1.0, 0.5, 0.25, 0.1, 0.03)
"""Shares of the box that the body occupies."""

CARED_FOR = 40_000
"""Particles up to which every turn is made; larger bodies take proportionally fewer, at least two."""


def turns(repeat: int, particles: int) -> int:
    """How often something of this size is timed."""
    return max(2, min(repeat, repeat * CARED_FOR // particles))


def tables(repeat: int, device: str, quick: bool) -> dict[str, Any]:
    """What the page shows."""
    sizes = (2_000,) if quick else SIZES
    cases = list(CASES)[:1] if quick else list(CASES)
    throughput = [
        simulation.throughput(case, scheme, n, torch.float32, turns(repeat, n), device)
        for n in sizes
        for case in cases
        for scheme in SCHEMES
    ]
    if not quick:
        throughput.append(simulation.throughput("neo-Hookean", "default", 20_000, torch.float64, repeat, device))
        throughput += [simulation.throughput("neo-Hookean", s, LARGE[0], torch.float32, 2, device) for s in SCHEMES]
        throughput.append(simulation.large("neo-Hookean", "default", LARGE[1], device))
    n, fills = (2_000, FILLS[::4]) if quick else (20_000, FILLS)
    occupied = [simulation.occupied(n, fill, repeat, device) for fill in fills]
    shown = rasteriser.CASES[:1] if quick else rasteriser.CASES
    return {
        "throughput": throughput,
        "occupied": occupied,
        "rasteriser": rasteriser.table(repeat, device, shown),
        "gradient": [] if quick else rasteriser.errors(),
        "network": network.networks(repeat, device, quick),
        "rays": network.rays(repeat, device),
    }


def coefficients(
    found: dict[str, Any], made: list[dict[str, Any]], repeat: int, device: str, quick: bool
) -> dict[str, Any]:
    """Prices of all units, and how well they fit what they were learnt from.

    Args:
        found: ``tables``.
        made: films to learn from.
    """
    forward, backward = simulation.rows(repeat, device, quick)
    known = prices.fit(forward) | prices.fit(backward)
    known |= prices.fit(simulation.frames(repeat, device), known)
    known |= prices.fit(rasteriser.rows(found["rasteriser"], "tile" if device == "cpu" else "pixel"))
    known |= prices.fit(rasteriser.harmonics(repeat, device))
    for rows in network.rows(found["network"], found["rays"]):
        known |= prices.fit(rows)
    known |= prices.fit(network.labels(repeat, device))
    worst = max(map(abs, prices.errors([*forward, *backward], known)))
    table = {"machine": describe(device), "yardstick": machine.measure(device), "worst_of_a_rollout": round(worst, 3)}
    if not made:
        return table | {"seconds": known, "bytes": {}}
    return table | {"seconds": known | prices.of_stages(made, known), "bytes": prices.memory(made)}


def measured(options: argparse.Namespace) -> None:
    """Time this machine; write its file, and of a whole run the prices."""
    found = tables(options.repeat, options.device, options.quick)
    stored(options, found, {})
    made = [] if options.quick or options.device != "cpu" else [films.run(film) for film in films.LEARN]
    table = coefficients(found, made, options.repeat, options.device, options.quick)
    kind = options.device.partition(":")[0]
    if not options.quick:
        known = json.loads(COEFFICIENTS.read_text(encoding="utf-8")) if COEFFICIENTS.exists() else {}
        if kind != "cpu":  # stages are not learnt on a GPU: theirs are the reference's until somebody does
            seconds = known["cpu"]["seconds"] | table["seconds"]
            table |= {"seconds": seconds, "bytes": known["cpu"]["bytes"]}
        COEFFICIENTS.write_text(json.dumps(known | {kind: table}, indent=1) + "\n", encoding="utf-8")
    stored(options, found, table)


def stored(options: argparse.Namespace, found: dict[str, Any], prices_of_units: dict[str, Any]) -> None:
    """Write the file of this machine."""
    kind = options.device.partition(":")[0]
    folder = options.out / MACHINES
    folder.mkdir(parents=True, exist_ok=True)
    content = {"machine": describe(options.device), "device": kind, "prices": prices_of_units, **found}
    (folder / f"{page.slug(machine.name(options.device))}-{kind}.json").write_text(json.dumps(content, indent=1))


def tested(options: argparse.Namespace) -> None:
    """Make the films of the test; write what was predicted and what was measured."""
    results = [{"expected": films.expected(film), "measured": films.run(film)} for film in films.TEST]
    (options.out / "docs/benchmarks").mkdir(parents=True, exist_ok=True)
    (options.out / "docs/benchmarks/cost.json").write_text(
        json.dumps({"machine": describe(), "films": results}, indent=1)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small, and nothing is kept")
    parser.add_argument("--films", action="store_true", help="ten films, predicted and measured")
    parser.add_argument("--page", action="store_true", help="only write the page from the files that are there")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--out", type=Path, default=ROOT, help="folder that has, or gets, docs/")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.quick:
        options.repeat = 2
        with tempfile.TemporaryDirectory() as folder:
            options.out = Path(folder)
            measured(options)
            print(page.text(options.out))
        return
    if not options.page:
        (tested if options.films else measured)(options)
    target = options.out / "docs/numerics/speed.md"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page.text(options.out), encoding="utf-8")
