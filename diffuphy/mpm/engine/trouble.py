"""What goes wrong in a frame, and the message that says so: a bad frame is run again, slowly, to find out where."""

import math
from dataclasses import dataclass, fields
from typing import Any

import torch

from diffuphy.mpm.engine.clock import Clock
from diffuphy.mpm.engine.solver import Solver
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import Bars, Matter, State
from diffuphy.mpm.substep.adjoint import Needs
from diffuphy.mpm.substep.kernels import FAST, INVERTED, LEFT, SQUEEZED
from diffuphy.types import SimulationDiverged

GONE = "left every block of nodes"
"""What a particle did that got further in a frame than was to be foreseen."""


FLAT = "was squeezed to nothing"
"""What a particle did whose volume is lost in the rounding of its deformation."""


@dataclass(frozen=True)
class Trouble:
    """Something that one particle did."""

    what: str
    """What it did, in words."""
    particle: int
    """Its index."""
    quantity: str
    """What was out of range, with its value and its limit."""


def trouble_of(end: State, status: list[int], span: Span, left: bool = False) -> Trouble | None:
    """What is wrong with a state that was reached with steps of ``span``.

    Args:
        left: whether it counts that a particle left the block of nodes.
    """
    if status[INVERTED]:
        p = status[INVERTED] - 1
        det = float(torch.linalg.det(end.He[p].double() + torch.eye(3).to(end.He.device).double()))
        if not det > 0.0:
            return Trouble("was turned inside out (det F ≤ 0)", p, f"det F = {det:.4g}, must be positive")
        least = SQUEEZED * torch.finfo(end.He.dtype).eps
        return Trouble(FLAT, p, f"det F = {det:.4g}, at least {least:.2g}, of which {end.He.dtype} knows 1 %")
    if status[FAST]:
        p = status[FAST] - 1
        cells = float(end.v[p].norm()) * span.dt / span.grid.dx
        return Trouble("crossed more than one cell in a substep", p, f"|v| Δt/Δx = {cells:.4g}, at most 1")
    for name in ("x", "v", "C", "He", "H", "memory", "HN"):
        t = getattr(end, name)
        if t is None:
            continue
        finite = torch.isfinite(t).reshape(len(t), -1).all(1)
        if not bool(finite.all()):
            p = int((~finite).nonzero()[0])
            return Trouble("is not finite", p, f"{name} = {t[p].flatten().tolist()}, must be finite")
    if left and status[LEFT]:
        p, grid = status[LEFT] - 1, span.grid
        high = [a + n * grid.dx for a, n in zip(grid.low, grid.shape, strict=True)]
        where = f"x = {_text(end.x[p])} m, nodes reach from {_text(grid.low)} to {_text(high)} m"
        return Trouble(GONE, p, where)
    return None


def blame(clock: Clock, start: State, matter: Matter, span: Span, frame: int, known: Trouble) -> SimulationDiverged:
    """The exception for a frame that came to ``known``: run again, one round at a time, in the memory of one state, to
    the first round at which something is wrong."""
    found, s, end = known, span.steps - 1, start
    for s, status, end in clock.solver.watch(start, matter, span):  # noqa: B007, the last ones are wanted
        if (trouble := trouble_of(end, status, span, left=status[LEFT] > 0)) is not None:
            found = trouble
            break
    p, t = found.particle, min(span.start + (s + 1) * span.dt, span.end)
    c, speed = float(clock.rest[p]), float(end.v[p].norm())
    before = float(start.v[p].norm())
    courant = span.dt * (c + (speed if math.isfinite(speed) else before)) / span.grid.dx
    if found.what == GONE:
        remedy = "raise fps, so that blocks are made for the speeds of a shorter time, or keep it in with walls"
    elif found.what == FLAT:
        remedy = "no law stops it at that speed: slow it down or make it stiffer"
    elif clock.dt is not None:
        remedy = f"lower dt below {span.dt:.3g} s, or leave it out"
    else:
        below = courant if 0.0 < courant < clock.scene.cfl else 0.5 * clock.scene.cfl
        remedy = f"shorter substeps did not help: slow it down, make it stiffer, or lower cfl below {below:.3g}"
    return SimulationDiverged(
        f"particle {p} {found.what} in frame {frame} (substep {min(s, span.n_sub - 1)} of {span.n_sub}, "
        f"t = {t:.6g} s): {found.quantity}; x = {_text(end.x[p])} m, |v| = {speed:.3g} m/s, at the start of the "
        f"frame x = {_text(start.x[p])} m, |v| = {before:.3g} m/s; Δt = {span.dt:.3g} s, CFL = {courant:.2f}; {remedy}"
    )


def unbounded(bars: Bars) -> tuple[str, int | None] | None:
    """Name of the first gradient with something in it that is not finite, and its first such particle."""
    for f in fields(bars):
        t = getattr(bars, f.name)
        if t is not None and not bool(torch.isfinite(t).all()):
            if f.name in ("walls", "gravity"):
                return f.name, None
            return f.name, int((~torch.isfinite(t)).reshape(len(t), -1).any(1).nonzero()[0])
    return None


def blame_gradient(
    solver: Solver, start: State, matter: Matter, span: Span, bars: Bars, needs: Needs, **wanted: Any
) -> SimulationDiverged:
    """The exception for a frame whose gradient is not finite: run again, one round backwards at a time."""
    when = f"t = {span.start:.6g} … {span.end:.6g} s"
    if (bad := unbounded(bars)) is not None:
        return SimulationDiverged(
            f"the gradient that reaches the end of the frame {when} is not finite already: in {bad[0]} of particle "
            f"{bad[1]}; what the loss, or a later frame, makes of that state has no derivative there: mend the loss"
        )
    found: list[tuple[int, str, int | None]] = []

    def look(s: int, now: Bars) -> None:
        if not found and (bad := unbounded(now)) is not None:
            found.append((s, *bad))

    solver.advance_adjoint(start, matter, span, bars, needs, watch=look, **wanted)
    if not found:
        raise AssertionError("a gradient was not finite once and is finite now: the backward pass is not deterministic")
    s, name, p = found[0]
    who = "" if p is None else f" of particle {p} ({laws_of(solver, matter, p)})"
    return SimulationDiverged(
        f"the gradient in {name}{who} is not finite from substep {s} of {span.steps} on, backwards, in the frame "
        f"{when}; it grows by the same factor in every substep before: cut it with window=1, or shorten the film"
    )


def laws_of(solver: Solver, matter: Matter, p: int) -> str:
    """Names of the laws that a particle follows."""
    mix = solver.mixture
    names = []
    for laws, w in ((mix.laws_e, matter.w_e), (mix.laws_p, matter.w_p)):
        names += [law for law, share in zip(laws, w[p].tolist(), strict=True) if share != 0.0]
    return ", ".join(str(name) for name in (*names, *mix.branches))


def _text(x: Any) -> str:
    return "(" + ", ".join(f"{float(a):.4g}" for a in x) + ")"
