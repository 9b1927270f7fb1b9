"""Mechanics and gradients against closed forms, conservation laws and manufactured solutions: docs/verification.md.

python -m benchmarks verification                       # every case under the default transfer
python -m benchmarks verification B2 B3 --scheme all    # two of them under every transfer
python -m benchmarks verification --tier 0              # those of the daily tests
"""

from benchmarks.verification import (
    adjoints,
    contracts,
    extremes,
    flows,
    free,
    friction,
    gradients,
    heaps,
    impact,
    invariance,
    laws,
    manufactured,
    points,
    timestep,
    waves,
)
from benchmarks.verification.case import CASES, SETTINGS, Case, Check, Setting
from benchmarks.verification.report import main

__all__ = [
    "CASES", "SETTINGS", "Case", "Check", "Setting", "adjoints", "contracts", "extremes", "flows", "free", "friction",
    "gradients", "heaps", "impact", "invariance", "laws", "main", "manufactured", "points", "timestep", "waves",
]  # fmt: skip
