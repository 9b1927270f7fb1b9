"""B2c: from which time step on an explicit step is unstable."""

import dataclasses
from functools import lru_cache

import torch

from benchmarks.verification.bodies import Body, at_rest, block, stored
from benchmarks.verification.case import Check, Setting, at_least, case, near, within
from diffuphy.material import make_mixture
from diffuphy.mpm.engine.solver import Solver
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.scene import STABLE
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import REAL, make_matter

DX = 0.05
STEPS = 400
"""Substeps of a trial: what grows by 4 % a substep grows by 1e6 in them."""
WIDTH = 0.02
"""To what the number is found."""


def bursts(s: Setting, body: Body, cfl: float) -> bool:
    """Whether noise of 1e-4 c in a free cube has more than twice its energy, or broke off, after 400 substeps of
    cfl Δx/c. The clock would refuse most of them, so the solver is driven without it."""
    laws = ((body.elastic,), (body.plastic,), REAL[body.x.dtype], ())
    mixture, field = make_mixture(*laws), body.field
    extent = body.x.amin(0).tolist(), body.x.amax(0).tolist()
    solver = Solver(
        mixture, (), (0.0, 0.0, 0.0), body.x.dtype, "cpu", particles=len(body.x), dx=DX, extent=extent,
        scheme=s.scheme, grad=False,
    )  # fmt: skip
    noise = torch.randn(body.x.shape, generator=torch.Generator().manual_seed(5), dtype=body.x.dtype)
    start = dataclasses.replace(at_rest(s, body), v=1e-4 * body.c * noise)
    matter = make_matter(field, body.vol, mixture.params, body.x.dtype, grad=False)
    grid = Grid.around([a - DX for a in extent[0]], [a + DX for a in extent[1]], DX, s.scheme.order, solver.shift)
    span = Span(grid, 0.0, cfl * DX / body.c, STEPS, body.c, s.scheme.retain, s.scheme.half_kick)
    end, status, _ = solver.advance(start, matter, span)
    if any(status):
        return True
    first = float(0.5 * (body.m * (start.v**2).sum(1)).sum())
    last = float(0.5 * (body.m * (end.v**2).sum(1)).sum() + (body.vol * stored(body, end.F)).sum())
    return not last < 2 * first


@lru_cache
def limit(s: Setting, nu: float, phase: float = 0.0) -> float:
    """Middle of the last interval of a bisection between a CFL number that is stable and one that is not, for particles
    ``phase`` cells beside the middles of the quarters of their cells."""
    body = block((4, 4, 4), DX, (phase * DX,) * 3, nu=nu)
    low, high = 0.4, 2.0
    while high - low > WIDTH:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if bursts(s, body, middle) else (middle, high)
    return 0.5 * (low + high)


@case("B2c", "Largest stable time step")
def largest(s: Setting) -> list[Check]:
    """First unstable c Δt/Δx of a free cube with noise, by bisection; c = √((λ + 2μ)/ρ).

    An independent code has 0.92 and 0.78 for ν = 0.3 and 0.49 with classic forces and quadratic splines, 1.19 and 1.01
    with cubic ones, on a lattice that fits the grid: to 5 % (two steps of the bisections). The default must be stable
    with every step that the clock lets pass, 0.75 of the present stretch, wherever particles lie in their cells and up
    to ν = 0.4999; plain APIC is not, where particles lie on nodes.
    """
    if s.name == "default":
        lattices = (0.0, 0.25, 0.5)
        worst = {nu: min(limit(s, nu, phase) for phase in lattices) for nu in (0.0, 0.3, 0.4999)}
        checks = [at_least(f"quadratic, ν = {nu}, worst of three lattices", v, STABLE) for nu, v in worst.items()]
        return [*checks, at_least("cubic, ν = 0.4999", limit(s.cubic(), 0.4999), STABLE)]
    checks = []
    for nu, quadratic, cubic in ((0.3, 0.92, 1.19), (0.49, 0.78, 1.01)):
        for what, found, reference in (
            ("quadratic", limit(s, nu), quadratic), ("cubic", limit(s.cubic(), nu), cubic),
        ):  # fmt: skip
            if s.name == "apic":
                checks.append(near(f"{what}, ν = {nu}", found, reference, 0.05 * reference))
            else:  # "slightly higher"
                checks.append(within(f"{what}, ν = {nu}", found, reference, 1.25 * reference, reference))
    return checks
