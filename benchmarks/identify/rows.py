"""Results on disk, one row a run: an interrupted study goes on where it stopped. Rates with their intervals."""

import json
import math
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch


class Rows:
    """A JSON file of rows, each with the fields of its key; written after every row."""

    def __init__(self, path: Path, key: Sequence[str]):
        self.path, self.key = path, tuple(key)
        self.rows: list[dict[str, Any]] = json.loads(path.read_text())["rows"] if path.exists() else []
        self._known = {self._of(r) for r in self.rows}

    def _of(self, row: dict[str, Any]) -> tuple:
        return tuple(row[k] for k in self.key)

    def has(self, **key: Any) -> bool:
        return self._of(key) in self._known

    def add(self, **row: Any) -> None:
        self.rows.append(row)
        self._known.add(self._of(row))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        whole = self.path.with_suffix(".part")
        whole.write_text(json.dumps({"machine": machine(), "rows": self.rows}, indent=1))
        whole.replace(self.path)
        print("  ".join(f"{k} {_short(v)}" for k, v in row.items()), flush=True)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "[" + ", ".join(map(_short, value)) + "]" if isinstance(value, list) else str(value)


def machine() -> str:
    return f"{os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}"


class Stopwatch:
    """Seconds of processor time since it was made: what else the machine does is not in it."""

    def __init__(self) -> None:
        self._start = time.process_time()

    @property
    def seconds(self) -> float:
        return round(time.process_time() - self._start, 2)


def wilson(successes: int, runs: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a success rate, of 95 % by default.

        (p + z²/2n ± z √(p (1 − p)/n + z²/4n²)) / (1 + z²/n)

    Wilson (1927), J. Am. Stat. Assoc. 22; it keeps its level for few runs and rates near 0 and 1.
    """
    if not 0 <= successes <= runs or runs == 0:
        raise ValueError(f"a rate needs 0 ≤ successes ≤ runs and runs > 0, got {successes} of {runs}")
    p, s = successes / runs, z * z / runs
    middle, half = p + s / 2, z * math.sqrt(p * (1 - p) / runs + s / (4 * runs))
    return max(0.0, (middle - half) / (1 + s)), min(1.0, (middle + half) / (1 + s))


def rate(right: Sequence[bool]) -> str:
    """9/10, 60–98 %: how many, and the interval of the rate."""
    lo, hi = wilson(sum(right), len(right))
    return f"{sum(right)}/{len(right)}, {100 * lo:.0f}–{100 * hi:.0f} %"
