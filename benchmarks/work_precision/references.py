"""References of the cases without a closed form: three fine grids, extrapolated, by two schemes.

    u = u_f + (u_f − u_m)/(r^p − 1),   r^p = |u_m − u_c|/|u_f − u_m|,   r = Δx_c/Δx_m = Δx_m/Δx_f,   1 ≤ p ≤ 2

Richardson's limit with the default transfer is the reference; how far that of plain APIC is from it, which shares
neither forces, walls, nor time integration, is what it is known to. Errors below that tell how fast a scheme converges,
and no longer which of two is right. Kept beside the code, made again by
``python -m benchmarks work_precision --references``.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

FILE = Path(__file__).with_name("references.json")

Observe = Callable[[list[Tensor]], Tensor]
"""What is compared, from positions at frames to shape (frames, Q)."""


@lru_cache
def kept() -> dict[str, dict]:
    """What the file holds, by case."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}


@dataclass(frozen=True)
class Against:
    """Error against the kept reference of a case: rms over frames and quantities, over the largest change of one."""

    case: str
    observe: Observe

    def __call__(self, x: list[Tensor]) -> float:
        if self.case not in kept():
            raise ValueError(
                f"no reference of {self.case} in {FILE.name}; run: python -m benchmarks work_precision --references"
            )
        return distance(self.observe(x), torch.tensor(kept()[self.case]["values"], dtype=torch.float64))


def uncertainty(case: str) -> float | None:
    """To what a reference is known, in the norm of its errors; None for a closed form."""
    return kept()[case]["uncertainty"] if case in kept() else None


def distance(found: Tensor, exact: Tensor) -> float:
    """rms difference over the largest distance that a quantity covers."""
    scale = float((exact.amax(0) - exact.amin(0)).max())
    return math.sqrt(float((found - exact).square().mean())) / scale


def limit(values: Sequence[Tensor], cells: Sequence[int]) -> tuple[Tensor, float]:
    """Richardson's limit of three grids, coarse to fine, in a constant ratio; and the order observed."""
    coarse, middle, fine = values
    r = cells[2] / cells[1]
    if not math.isclose(cells[1] / cells[0], r):
        raise ValueError(f"three grids in a constant ratio are needed, got {tuple(cells)} cells")
    gain = float((middle - coarse).norm() / (fine - middle).norm())
    p = min(max(math.log(gain) / math.log(r), 1.0), 2.0)
    return fine + (fine - middle) / (r**p - 1), p


def reference(values: dict[str, Sequence[Tensor]], cells: Sequence[int]) -> dict:
    """What is kept of a case, from what two schemes observe on three grids: those of the default first."""
    (first, p), *others = (limit(v, cells) for v in values.values())
    return {
        "cells": list(cells),
        "orders": {name: round(q, 2) for name, (_, q) in zip(values, [(first, p), *others], strict=True)},
        "uncertainty": float(f"{max(distance(other, first) for other, _ in others):.3g}"),
        "values": [[float(f"{x:.9g}") for x in row] for row in first.tolist()],
    }


def keep(found: dict[str, dict]) -> None:
    """Write the file with these cases replaced."""
    text = json.dumps(kept() | found, indent=1)
    FILE.write_text(text + "\n", encoding="utf-8")
    kept.cache_clear()
