"""W6: error of a gradient against the time of the backward pass: how the motion of a bar depends on its stiffness.

    v = V cos ωt,  ω = (π/L) √(E/ρ):   d ln v/d ln E = −(w/2) tan w,  w = ωt

at w = 2π + 1, after more than a period, so that errors of phase and of damping have had time to grow. Strains are 1e-5:
the formula is that of linear elasticity.
"""

import dataclasses
import math
import time
from typing import Any

import torch

from benchmarks.verification.bodies import at_rest
from benchmarks.verification.case import Setting
from benchmarks.verification.waves import SPEED, C, L, bar
from benchmarks.work_precision.choice import DEFAULT, Choice, named
from benchmarks.work_precision.problem import Sample
from benchmarks.work_precision.sweep import BUDGET, QUICK_BUDGET, Entry, Swept, settings, swept
from diffuphy.mpm import State, simulate
from diffuphy.mpm.engine.solver import backward_bytes

TITLE, NORM = "Gradient", "relative error of d ln v/d ln E"
W = 2 * math.pi + 1
EXACT = -0.5 * W * math.tan(W)
FRAMES = 4
RESOLUTIONS, QUICK = (8, 16, 32, 64), (8, 16)
SERIES = (
    "default", "plain MLS", "plain APIC", "no sharpening", "no retention", "no half kick", "cubic", "classic force",
    "CFL 0.1", "CFL 0.2", "CFL 0.7", "float64",
)  # fmt: skip
QUICK_SERIES = ("default", "plain MLS", "float64")
CHECKPOINTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("a checkpoint a substep", {"segment": 1}),
    ("every 8 substeps", {"segment": 8}),
    ("every 32 substeps", {"segment": 32}),
    ("every substep kept", {"keep": True}),
)
"""What the backward pass keeps, and its options; the default chooses the segment by memory."""


class Gradient:
    """The bar at one resolution under one choice."""

    def __init__(self, n: int, choice: Choice, **options: Any):
        self.choice, self.options = choice, options
        setting = Setting(choice.series, choice.scheme)
        body = bar(n).to(choice.dtype)
        self.body, self.dx = body, L / n
        self.particles, seconds = len(body.x), W * L / (math.pi * C)
        self.per = math.ceil(seconds / FRAMES / (choice.cfl * self.dx / C))
        self.rounds = (self.per + choice.scheme.half_kick) * FRAMES
        self.dt = seconds / FRAMES / self.per
        self.scene = setting.scene(dx=self.dx, fps=FRAMES / seconds)
        X = body.x[:, 0]
        self.shape = torch.cos(math.pi * X / L)
        v, grad = torch.zeros_like(body.x), torch.zeros(len(X), 3, 3, dtype=X.dtype)
        v[:, 0], grad[:, 0, 0] = SPEED * self.shape, -SPEED * math.pi / L * torch.sin(math.pi * X / L)
        self.start = at_rest(setting, body, v=v, C=grad)
        self.megabytes = backward_bytes(self.start, FRAMES, self.rounds // FRAMES, **options) / 1e6
        self.forward, self.value = math.nan, math.nan

    def run(self) -> Sample:
        """Forward and backward; what is timed is the latter."""
        field = self.body.field
        E = field.theta["E"].clone().requires_grad_()
        field = dataclasses.replace(field, theta=field.theta | {"E": E})
        cpu = time.process_time()
        end: State
        *_, end = simulate(
            self.scene, self.body.x, self.body.vol, field, frames=FRAMES, dt=self.dt * (1 + 1e-6), state=self.start,
            grad=True, threads=1, **self.options,
        )  # fmt: skip
        v = (end.v[:, 0].double() * self.shape).sum()
        self.forward = time.process_time() - cpu
        cpu, wall = time.process_time(), time.perf_counter()
        (bar_,) = torch.autograd.grad(v, [E])
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        self.value = float((bar_.double() * E.detach().double()).sum() / v.detach())
        return Sample(cpu, wall)

    def error(self) -> float:
        """Relative error of the derivative."""
        return abs(self.value / EXACT - 1)


def sweep(*, quick: bool) -> Swept:
    """All runs of W6."""
    entries = []
    for choice in named(*(QUICK_SERIES if quick else SERIES)):
        for n in QUICK if quick else RESOLUTIONS:
            entries.append(entry(n, choice, choice.series, choice.axis))
    for name, options in CHECKPOINTS[-1:] if quick else CHECKPOINTS:
        for n in QUICK if quick else RESOLUTIONS:
            entries.append(entry(n, DEFAULT, name, "checkpoints", **options))
    return swept(entries, QUICK_BUDGET if quick else BUDGET)


def entry(n: int, choice: Choice, series: str, axis: str, **options: Any) -> Entry:
    runner = Gradient(n, choice, **options)
    known = {"case": "W6", "cells": n, "dx": runner.dx} | settings(choice) | {"series": series, "axis": axis}
    return Entry(runner, known)
