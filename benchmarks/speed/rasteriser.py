"""Timings of the rasteriser, and how exact its gradient is.

A ball of G Gaussians with every orientation, one view of R x R pixels, loss on colour and coverage. Forward and
backward include projection, bounds and binning. Errors are relative to the dense torch reference in float64.
"""

import statistics
from typing import Any

import torch
from torch import Tensor

from benchmarks.speed.body import now
from benchmarks.speed.prices import Row
from diffuphy.cost.counted import pictures
from diffuphy.render import Dense, Warp, orbit, rasterize
from diffuphy.render.sh import colors
from diffuphy.types import Camera

CASES = ((3_000, 64), (10_000, 64), (3_000, 128), (10_000, 128), (50_000, 128), (10_000, 256), (50_000, 384))


def ball(count: int, dtype: torch.dtype = torch.float32) -> list[Tensor]:
    """Means, quats, scales, opacities, colours of a shell of radius 1; footprints shrink as G^-½, as an object's do."""
    g = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    means = d * (0.7 + 0.3 * torch.rand(count, 1, generator=g))
    scales = 1.2 * count**-0.5 * torch.exp(0.3 * torch.randn(count, 3, generator=g))
    quats, colors = torch.randn(count, 4, generator=g), torch.rand(count, 3, generator=g)
    opacities = torch.sigmoid(1.5 * torch.randn(count, generator=g) + 0.5)
    return [x.to(dtype) for x in (means, quats, scales, opacities, colors)]


def cost(count: int, size: int, backend: Warp, repeats: int, device: str = "cpu") -> dict[str, float]:
    """Median milliseconds of one view: forward, and forward with gradient."""
    operands = [x.to(device).requires_grad_() for x in ball(count)]
    camera = orbit([30.0], 20.0, 3.0, width=size, height=size).to(device)
    forward, both = [], []
    for _ in range(repeats + 3):
        begin = now(device)
        image = rasterize(*operands, camera, backend=backend)
        middle = now(device)
        (image.rgb.sum() + image.alpha.sum()).backward()
        forward.append(middle - begin)
        both.append(now(device) - begin)
    return {"forward": 1e3 * statistics.median(forward[3:]), "both": 1e3 * statistics.median(both[3:])}


def table(repeats: int, device: str, cases: tuple[tuple[int, int], ...] = CASES) -> list[dict[str, Any]]:
    """Both drivers on every case; on a GPU the one that it takes."""
    drivers = ("tile", "pixel") if device == "cpu" else ("pixel",)
    return [
        {"gaussians": g, "size": s, "driver": d} | cost(g, s, Warp(driver=d, threads=1), repeats, device)
        for g, s in cases
        for d in drivers
    ]


def harmonics(repeats: int, device: str, count: int = 10_000, degree: int = 3) -> list[Row]:
    """Timed colours of harmonics, forward, and forward and backward."""
    means, *_ = (x.to(device) for x in ball(count))
    values = torch.zeros(count, (degree + 1) ** 2, 3, device=device).requires_grad_()
    camera = orbit([30.0], 20.0, 3.0, width=8, height=8).to(device)
    F = torch.eye(3, device=device).expand(count, 3, 3)
    forward, both = [], []
    for _ in range(repeats + 1):
        begin = now(device)
        seen = colors(values, means, camera, F)
        forward.append(now(device) - begin)
        seen.sum().backward()
        both.append(now(device) - begin)
    work = {"view.harmonic": float(count * (degree + 1) ** 2)}
    each = [statistics.median(times[1:]) for times in (forward, both)]
    return [(work, each[0]), (work | {"back.view.harmonic": work["view.harmonic"]}, each[1])]


def rows(cases: list[dict[str, Any]], driver: str) -> list[Row]:
    """The same as timed work."""
    found: list[Row] = []
    for r in cases:
        if r["driver"] == driver:
            args = 1, r["gaussians"], r["size"]
            found += [(pictures(*args), 1e-3 * r["forward"]), (pictures(*args, back=True), 1e-3 * r["both"])]
    return found


def error(backend: Warp, dtype: torch.dtype) -> dict[str, float]:
    """Relative error of the gradient with respect to each operand, in two views."""
    camera = orbit([30.0, 200.0], [20.0, -10.0], 3.0, width=48, height=40)
    camera = Camera(camera.viewmats.double(), camera.Ks.double(), 48, 40)
    weight = torch.randn(2, 40, 48, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def gradients(rasteriser: Warp | Dense, kind: torch.dtype) -> list[Tensor]:
        leaves = [x.to(kind).requires_grad_() for x in ball(300, dtype)]
        image = rasterize(*leaves, camera, backend=rasteriser)
        channels = torch.cat([image.rgb, image.alpha[..., None], image.depth[..., None]], dim=-1)
        return list(torch.autograd.grad((channels * weight.to(kind)).sum(), leaves))

    pairs = zip(gradients(backend, dtype), gradients(Dense(), torch.float64), strict=True)
    names = ("means", "quats", "scales", "opacities", "colors")
    return {n: ((a.double() - b).norm() / b.norm()).item() for n, (a, b) in zip(names, pairs, strict=True)}


def errors() -> list[dict[str, Any]]:
    """Of both drivers at both precisions."""
    return [
        {"driver": d, "dtype": str(t).removeprefix("torch.")} | error(Warp(driver=d), t)
        for t in (torch.float64, torch.float32)
        for d in ("tile", "pixel")
    ]
