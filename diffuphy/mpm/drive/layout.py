"""Drives as data: a bit mask for each particle, and one row of numbers for each drive and substep.

    Impulse, Acceleration   0–2 b
    Attractor               0–2 c, 3 A/s, 4 1/s², 5 −(p+1)/2
    Vortex                  0–2 c, 3–5 a, 6 A/s, 7 1/s², 8 −(p+1)/2
    Drag                    0–2 velocity of the medium, 3 1 − E, 4 q κ, 5 1/Δt
    region                  9–11 low or centre, 12–14 high, or 12 radius
    Held                    0–2 V, 3–5 c, 6–14 A row by row, 15 one while it acts
    Release                 0 time in TICKs

Lengths are from the lowest node of the grid. What acts during a part of a substep acts with that part of its strength,
so that nothing depends on where substeps begin. In a tag the lowest bits are the drives. If one of them holds, the next
bit says whether the particle is one piece with held matter, and if there is a ``Release`` the time at which it lets the
particle go follows, in TICKs.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from diffuphy.mpm.boundary.motion import pose, rotation_increment
from diffuphy.mpm.drive.drives import (
    HOLDING,
    Acceleration,
    Attractor,
    Drag,
    Drive,
    Held,
    Impulse,
    Release,
    Vortex,
    check_drives,
)
from diffuphy.mpm.drive.select import attached, chosen
from diffuphy.mpm.grid import Grid

Signature = tuple[tuple[str, str], ...]
"""Kind and kind of region ("" for none) of each drive."""

N_DRIVE = 16
"""Numbers that describe a drive to a kernel."""

TICK = 2.0**-13
"""Resolution of a time of release [s], 0.12 ms."""

TICK_BITS = 24
"""Most bits of such a time: a float32 counts no further."""


def drive_signature(drives: Sequence[Drive]) -> Signature:
    """What is compiled into the kernels; everything else is data."""
    return tuple((type(d).__name__, type(r).__name__ if (r := getattr(d, "region", None)) else "") for d in drives)


def tags(drives: Sequence[Drive], x: Tensor, m: Tensor, dx: float, scenes: int = 1) -> Tensor:
    """For each particle the drives that act on it, shape (N,) int32.

    Args:
        x: positions at the beginning, shape (N, 3) [m].
        m: masses, shape (N,) [kg].
        dx: node spacing; what is nearer to held matter is one piece with it [m].
        scenes: scenes one after the other, which do not touch.

    Raises:
        ValueError: a drive that selects no particle, or a release that is too late to be counted.
    """
    check_drives(drives)
    x = x.detach()
    out = torch.zeros(len(x), dtype=torch.int64, device=x.device)
    latest = torch.zeros(len(x), dtype=torch.int64, device=x.device)
    joins = torch.zeros(len(x), dtype=torch.bool, device=x.device)
    for k, d in enumerate(drives):
        mask = chosen(d.where, x)
        if not bool(mask.any()) or not float(m.detach()[mask].sum()) > 0.0:
            raise ValueError(
                f"drives[{k}], {type(d).__name__}, selects none of the {len(x)} particles: where = {d.where}"
            )
        out |= mask.long() << k
        joins |= mask & (isinstance(d, HOLDING) and d.attached)
        if isinstance(d, Release):
            ahead = ((x - x.new_tensor(d.point)) @ x.new_tensor(d.normal)).double().clamp_min(0.0)
            ticks = ((d.start + ahead / d.speed) / TICK).ceil().clamp_max(2.0**62).long()
            latest = torch.where(mask, torch.maximum(latest, ticks), latest)
    if bool(joins.any()):
        parts = zip(joins.chunk(scenes), x.chunk(scenes), strict=True)
        out |= torch.cat([attached(each, at, dx) for each, at in parts]).long() << len(drives)
    if any(isinstance(d, Release) for d in drives):
        bits = min(TICK_BITS, 30 - len(drives))
        if int(latest.max()) >= 2**bits:
            raise ValueError(
                f"particle {int(latest.argmax())} would be released after {float(latest.max()) * TICK:.3g} s, with "
                f"{len(drives)} drives {2**bits * TICK:.3g} s can be counted; move the plane faster or use fewer drives"
            )
        out |= latest << (len(drives) + 1)
    return out.to(torch.int32)


def mass_of(k: int, m: Tensor, tags: Tensor) -> float:
    """Mass of the particles that drive k acts on [kg]."""
    return float(m.detach()[(tags >> k & 1).bool()].double().sum())


def mass_gradient(drives: Sequence[Drive], m: Tensor, tags: Tensor, pushed: Tensor) -> Tensor:
    """Gradient in the masses by way of the rows of impulses, shape (N,): b = J/(M duration), so that

        m̄_q = −(1/M) Σ_p b̄_p · b   for every particle q that shares J,   M = Σ_q m_q

    Args:
        m: masses, shape (N,) [kg].
        tags: from :func:`tags`.
        pushed: Σ over substeps of b̄_p · b for each impulse, shape (N, impulses).
    """
    out = torch.zeros_like(m)
    which = [k for k, d in enumerate(drives) if isinstance(d, Impulse)]
    for total, k in zip(pushed.sum(0), which, strict=True):
        out -= total / mass_of(k, m, tags) * (tags >> k & 1)
    return out


def drive_rows(
    drives: Sequence[Drive],
    grid: Grid,
    starts: np.ndarray,
    dts: np.ndarray | float,
    m: Tensor,
    tags: Tensor,
    kicks: np.ndarray | None = None,
) -> np.ndarray:
    """The drives as data, shape (steps, drives, N_DRIVE) float64, lengths from the lowest node of ``grid`` [m].

    Args:
        starts: time at which each substep begins [s], shape (steps,).
        dts: how long particles move in each [s], shape (steps,) or one for all.
        kicks: time over which forces act in each [s], shape (steps,), from the first start on without gaps, so that an
            impulse is exact; ``dts`` if None.
        m: masses, shape (N,) [kg].
        tags: from :func:`tags`.
    """
    starts = np.asarray(starts, dtype=np.float64)
    dts = np.broadcast_to(np.asarray(dts, dtype=np.float64), starts.shape)
    kicks = dts if kicks is None else kicks
    edges = starts[0] + np.concatenate([[0.0], np.cumsum(kicks)])
    low = np.asarray(grid.low)
    out = np.zeros((len(starts), len(drives), N_DRIVE))
    for k, d in enumerate(drives):
        row = out[:, k]
        if isinstance(d, Held):
            _hold(d, low, starts, dts, row)
        elif isinstance(d, Release):
            row[:, 0] = starts / TICK
        elif isinstance(d, Impulse):
            mass = mass_of(k, m, tags)
            share = np.diff(np.clip((edges - d.start) / d.duration, 0.0, 1.0))
            row[:, :3] = (share / (mass * kicks))[:, None] * np.asarray(d.impulse)
        else:
            _field(d, low, np.diff(np.clip(edges, d.start, d.end)), kicks, row)
    return out


def _hold(d: Held, low: np.ndarray, starts: np.ndarray, dts: np.ndarray, row: np.ndarray) -> None:
    at = (d.center, d.velocity, d.angular_velocity, d.schedule, d.start)
    now = pose(*at, starts)
    row[:, 3:6] = now.place - low
    if d.schedule is None:
        row[:, :3] = d.velocity
        chord = rotation_increment(dts[:, None] * np.asarray(d.angular_velocity)) / dts[:, None, None]
    else:
        then = pose(*at, starts + dts)
        row[:, :3] = (then.place - now.place) / dts[:, None]
        turn = then.rotation @ np.swapaxes(now.rotation, 1, 2) - np.eye(3)
        chord = turn / dts[:, None, None]
    row[:, 6:15] = chord.reshape(-1, 9)
    row[:, 15] = (starts >= d.start) & (starts < d.end)


def _field(
    d: Acceleration | Attractor | Vortex | Drag, low: np.ndarray, active: np.ndarray, dts: np.ndarray, row: np.ndarray
) -> None:
    part = active / dts
    if d.region is not None:
        row[:, 9:15] = d.region.numbers(low)
    if isinstance(d, Acceleration):
        row[:, :3] = part[:, None] * np.asarray(d.acceleration)
    elif isinstance(d, Drag):
        lost = -np.expm1(-active / d.time)
        kappa = active if d.time == math.inf else d.time * lost
        row[:, :3] = d.velocity
        row[:, 3], row[:, 4], row[:, 5] = lost, d.quadratic * kappa, 1.0 / dts
    else:
        row[:, :3] = np.asarray(d.center) - low
        at = 3
        if isinstance(d, Vortex):
            row[:, 3:6], at = d.axis, 6
        row[:, at] = part * d.strength / d.radius
        row[:, at + 1], row[:, at + 2] = d.radius**-2, -0.5 * (d.falloff + 1.0)
