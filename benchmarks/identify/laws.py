"""Is the right plastic law found? The product's scan, forward only, against clips of four laws."""

from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.identify.bodies import Reference
from benchmarks.identify.recover import fitting
from benchmarks.identify.rows import Rows, Stopwatch
from benchmarks.identify.specimens import Specimen
from benchmarks.identify.trained import case_of
from diffuphy.losses.takes import Take
from diffuphy.types import SimulationDiverged, Trajectory

LAWS = ("identity", "von_mises", "drucker_prager", "fluid")
E = torch.linspace(4.0, 6.0, 5, dtype=torch.float64)
"""Grid of the scan [log10 Pa]."""
KNOWN = {"E": 1e5, "nu": 0.3, "yield_stress": 6e3, "friction_angle": 30.0, "cohesion": 0.0}
"""What the table says; E is scanned, the others may be wrong."""
READ = {"identity": (), "von_mises": ("yield_stress",), "drucker_prager": ("friction_angle", "cohesion"), "fluid": ()}


def specimen(law: str, **theta: float) -> Specimen:
    known = {"E": KNOWN["E"], "nu": KNOWN["nu"], **{n: KNOWN[n] for n in READ[law]}}
    return Specimen(law, "hencky", law, known | theta, 1200.0, {"E": (10**4.3, 10**5.7)}, {"E": (0.1, "dex")})


@cache
def hypotheses() -> list[tuple[str, float, Trajectory]]:
    """The drops of all laws and stiffnesses that can be simulated."""
    found = []
    for law in LAWS:
        matter = specimen(law)
        for log_E in E:
            try:
                found.append((law, float(log_E), fitting(matter).drop(matter, log_E[None])))
            except SimulationDiverged:
                continue
    return found


def truth(law: str, number: int) -> tuple[Specimen, Tensor]:
    """A material of the law: stiffness off the grid; yield stress and friction angle that are not the table's."""
    generator = torch.Generator().manual_seed(500 + number)
    u = torch.rand(3, generator=generator, dtype=torch.float64).tolist()
    other = {"yield_stress": 6e3 * 2 ** (2 * u[1] - 1), "friction_angle": 20 + 20 * u[2]}
    q = torch.tensor([4.3 + 1.4 * u[0]], dtype=torch.float64)
    return specimen(law, **{n: v for n, v in other.items() if n in READ[law]}), q


def study(out: Path, truths: int, references: tuple[Reference, ...] = ("fine", "same")) -> Rows:
    """So many truths of each law, seen in clips of each kind."""
    rows = Rows(out / "identify_laws.json", ("law", "number", "reference"))
    for number in range(truths):
        for law in LAWS:
            for reference in references:
                if not rows.has(law=law, number=number, reference=reference):
                    _row(rows, law, number, reference)
    return rows


def _row(rows: Rows, law: str, number: int, reference: Reference) -> None:
    matter, q = truth(law, number)
    case = case_of(matter, q, reference, 1 + number)
    case.cond.prepare(Take.whole(case.bench.probe.frames))  # the reference is not part of the scan
    drops, watch = hypotheses(), Stopwatch()
    scores = [case.cond.score(drop, "x0") for _, _, drop in drops]
    order = sorted(range(len(scores)), key=scores.__getitem__)
    ranked = list(dict.fromkeys(drops[i][0] for i in order))
    rows.add(
        law=law, number=number, reference=reference, log10_E=float(q[0]), found=ranked[0],
        log10_E_found=drops[order[0]][1], right=ranked[0] == law, place=1 + ranked.index(law), seconds=watch.seconds,
    )  # fmt: skip
