"""W7: error of a picture against the time it takes, by what the rasteriser leaves out and how it is laid out.

A shell of Gaussians, one view; the reference is the same sum in float64 with nothing left out: no least opacity, no
least transmittance. Errors are rms over colours and coverage, 1/255 = 3.9e-3 is one step of an 8-bit image.
"""

import dataclasses
import math
import time
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from benchmarks.work_precision.problem import Sample
from benchmarks.work_precision.sweep import BUDGET, QUICK_BUDGET, Entry, Swept, swept
from diffuphy.render import Dense, Warp, orbit, rasterize

TITLE, NORM = "Rasteriser", "rms error of rgb and coverage"
GAUSSIANS = 4000
SIZES, QUICK = (64, 128, 256), (64,)
WHOLE = Warp(driver="tile", alpha_min=1e-12, T_min=0.0, threads=1)
"""Nothing left out."""
DEFAULT = Warp(threads=1)
FINE = dataclasses.replace(DEFAULT, alpha_min=1e-4, T_min=0.0)
SERIES: tuple[tuple[str, str, Warp | Dense, torch.dtype], ...] = (
    ("default", "default", DEFAULT, torch.float32),
    *(
        (f"α ≥ 1/{round(1 / a)}", "alpha_min", dataclasses.replace(DEFAULT, alpha_min=a), torch.float32)
        for a in (1 / 32, 1 / 100, 1 / 1000, 1 / 10000)
    ),
    *((f"T ≥ {t:g}", "T_min", dataclasses.replace(DEFAULT, T_min=t), torch.float32) for t in (1e-2, 1e-3, 0.0)),
    *((f"tile of {s} px", "tile", dataclasses.replace(DEFAULT, tile=s), torch.float32) for s in (8, 16, 64)),
    ("a thread a pixel", "driver", dataclasses.replace(DEFAULT, driver="pixel"), torch.float32),
    ("float64", "precision", DEFAULT, torch.float64),
    ("α ≥ 1/10000, T ≥ 0, float64", "precision", FINE, torch.float64),
    ("dense, torch", "peer", Dense(), torch.float32),
)
"""Name, what is varied, rasteriser, precision."""
QUICK_SERIES = ("default", "α ≥ 1/32", "α ≥ 1/1000", "a thread a pixel")
DENSE_MOST = 128
"""Widest picture of the dense one [px]."""


@lru_cache
def shell() -> tuple[Tensor, ...]:
    """Means, quats, scales, opacities and colours of an object's skin, in float64; footprints of about two pixels at
    128."""
    g = torch.Generator().manual_seed(0)
    rand = lambda *k: torch.randn(*k, generator=g, dtype=torch.float64)  # noqa: E731
    means = torch.nn.functional.normalize(rand(GAUSSIANS, 3), dim=1) * (0.9 + 0.05 * rand(GAUSSIANS, 1))
    scales = 1.2 * GAUSSIANS**-0.5 * torch.exp(0.3 * rand(GAUSSIANS, 3))
    opacities, colors = torch.sigmoid(1.5 * rand(GAUSSIANS) + 0.5), torch.sigmoid(rand(GAUSSIANS, 3))
    return means, rand(GAUSSIANS, 4), scales, opacities, colors


@lru_cache
def reference(size: int) -> Tensor:
    """rgb and coverage of the whole sum, shape (size, size, 4)."""
    image = rasterize(*shell(), orbit([30.0], 20.0, 3.0, width=size, height=size), backend=WHOLE)
    return torch.cat([image.rgb, image.alpha[..., None]], -1)[0]


class Picture:
    """One view under one rasteriser."""

    rounds = 1

    def __init__(self, size: int, backend: Warp | Dense, dtype: torch.dtype):
        self.size, self.backend = size, backend
        self.operands = [t.to(dtype) for t in shell()]
        self.camera = orbit([30.0], 20.0, 3.0, width=size, height=size)
        self.particles = GAUSSIANS
        self.image: Any = None

    def run(self) -> Sample:
        """Draw it."""
        cpu, wall = time.process_time(), time.perf_counter()
        with torch.no_grad():
            self.image = rasterize(*self.operands, self.camera, backend=self.backend)
        return Sample(time.process_time() - cpu, time.perf_counter() - wall)

    def error(self) -> float:
        """rms over colours and coverage."""
        found = torch.cat([self.image.rgb, self.image.alpha[..., None]], -1)[0].double()
        return math.sqrt(float((found - reference(self.size)).square().mean()))


def sweep(*, quick: bool) -> Swept:
    """All runs of W7."""
    entries = []
    for name, axis, backend, dtype in SERIES:
        if quick and name not in QUICK_SERIES:
            continue
        for size in QUICK if quick else SIZES:
            if isinstance(backend, Dense) and size > DENSE_MOST:
                continue
            known = {
                "case": "W7", "series": name, "axis": axis, "cells": size, "dx": 2.0 / size, "cfl": math.nan,
                "precision": str(dtype).removeprefix("torch."), "order": 0, "force": "", "per": math.nan,
            }  # fmt: skip
            entries.append(Entry(Picture(size, backend, dtype), known))
    return swept(entries, QUICK_BUDGET if quick else BUDGET)
