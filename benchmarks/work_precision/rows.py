"""What a run took and how wrong it was, as a row of a table on disk."""

import csv
import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Row:
    """One run of one case, settings included."""

    case: str
    series: str
    """Name of its settings."""
    axis: str
    """What they vary of the default."""
    cells: float
    """Resolution, as the case counts it."""
    dx: float
    """Grid spacing [m]; of pictures the side of a pixel."""
    cfl: float
    precision: str
    order: int
    force: str
    per: float
    """Particles along each axis of a cell [-]."""
    particles: int
    rounds: int
    """Exchanges between particles and grid."""
    error: float
    seconds: float
    """Processor time, the median [s]."""
    low: float
    """Lower quartile [s]."""
    high: float
    """Upper quartile [s]."""
    wall: float
    """Median by the clock on the wall [s]."""
    compiling: float | None
    """What the first run of these settings took more [s]; empty where another one had compiled already."""
    samples: str
    """Processor times in the order in which they were taken [s]."""
    megabytes: float | None = None
    """Memory for the backward pass [MB]."""
    forward: float | None = None
    """Processor time of the forward pass that goes with a backward one [s]."""

    @property
    def work(self) -> float:
        """Particle-substeps."""
        return float(self.particles) * self.rounds


def write(path: Path, rows: Iterable[Row]) -> None:
    """Numbers in full precision would change in every digit from run to run: five that mean something are kept."""
    names = [f.name for f in dataclasses.fields(Row)]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(names)
        for row in rows:
            table.writerow([shown(getattr(row, n)) for n in names])


def shown(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.5g}"
    return "" if value is None else value


def read(path: Path) -> list[Row]:
    """The rows of a file that :func:`write` made."""
    kinds = {f.name: str(f.type) for f in dataclasses.fields(Row)}
    with path.open(newline="", encoding="utf-8") as file:
        return [Row(**{k: parsed(v, kinds[k]) for k, v in line.items()}) for line in csv.DictReader(file)]  # type: ignore[arg-type]


def parsed(text: str, kind: str) -> object:
    if "float" in kind:
        return float(text) if text else None
    return int(text) if "int" in kind else text
