"""Rows of runs as means over seeds, and who is ahead of whom."""

import csv
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Mean:
    """A number over seeds."""

    value: float
    """Mean; NaN without a number."""
    spread: float
    """Sample standard deviation; NaN for fewer than two."""
    count: int
    """Runs that gave a number."""
    failed: int = 0
    """Runs that gave none because they could not be simulated."""

    @classmethod
    def of(cls, rows: Iterable[Row], metric: str) -> "Mean":
        """Of the rows of one cell."""
        rows = list(rows)
        values = [r[metric] for r in rows if isinstance(r.get(metric), float) and math.isfinite(r[metric])]
        failed = sum("why" in r for r in rows)
        mean = statistics.fmean(values) if values else math.nan
        return cls(mean, statistics.stdev(values) if len(values) > 1 else math.nan, len(values), failed)

    def shown(self, scale: float = 1.0, digits: int = 2) -> str:
        """Mean to so many digits ± spread to as many places; how many failed."""
        if not self.count:
            return "diverged" if self.failed else "–"
        value, s = scale * self.value, scale * self.spread
        places = 0 if value == 0 else max(0, digits - 1 - math.floor(math.log10(abs(value))))
        spread = f" ± {s:.{places}f}" if self.count > 1 else ""
        return f"{value:.{places}f}{spread}" + (f" ({self.failed} diverged)" if self.failed else "")


def cells(rows: Sequence[Row], metric: str) -> dict[tuple[str, str], Mean]:
    """The mean of every (variant, prompt)."""
    keys = dict.fromkeys((r["variant"], r["prompt"]) for r in rows)
    return {k: Mean.of((r for r in rows if (r["variant"], r["prompt"]) == k), metric) for k in keys}


def across(rows: Sequence[Row], metric: str, variant: str) -> Mean:
    """Mean over prompts and seeds of one variant; its spread is that of the seeds' means over prompts."""
    own = [r for r in rows if r["variant"] == variant]
    failed = sum("why" in r for r in own)
    each = [Mean.of((r for r in own if r["seed"] == s), metric) for s in dict.fromkeys(r["seed"] for r in own)]
    values = [m.value for m in each if m.count]
    spread = statistics.stdev(values) if len(values) > 1 else math.nan
    return Mean(statistics.fmean(values) if values else math.nan, spread, len(values), failed)


def ahead(ours: Mean, theirs: Mean) -> int:
    """+1 if ours is lower by more than the seeds' spreads together, −1 if it is higher by as much, else 0.

    |Δ| > √(s² + s'²);  a method of which every run failed is behind
    """
    if not (ours.count and theirs.count):
        return (ours.count > 0) - (theirs.count > 0)
    spread = math.hypot(*(0.0 if math.isnan(m.spread) else m.spread for m in (ours, theirs)))
    gap = theirs.value - ours.value
    return 0 if abs(gap) <= spread else int(math.copysign(1, gap))


def write(rows: Sequence[Row], path: Path) -> None:
    """All rows as CSV, one column for every number that any row has."""
    names = list(dict.fromkeys(name for r in rows for name in r))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in r.items()} for r in rows)


def read(path: Path) -> list[dict[str, Any]]:
    """Rows of ``write``; numbers are numbers again, empty cells are left out."""

    def parsed(name: str, text: str) -> Any:
        if name in ("prompt", "variant", "why", "film"):
            return text
        return int(text) if name == "seed" else float(text)

    with path.open(encoding="utf-8", newline="") as file:
        return [{k: parsed(k, v) for k, v in r.items() if v != ""} for r in csv.DictReader(file)]
