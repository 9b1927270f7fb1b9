"""W1 … W5, W8: problems whose answer is known, exactly or from a finer grid, at any resolution."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, block
from benchmarks.verification.friction import STIFF, G
from benchmarks.verification.manufactured import WAVE, A, Compact
from benchmarks.work_precision.choice import CHOICES
from benchmarks.work_precision.nonlinear_bar import displacement
from benchmarks.work_precision.problem import Positions, Problem
from benchmarks.work_precision.references import Against, Observe
from diffuphy.mpm import HalfSpace

Build = Callable[[int, float], Problem]
"""From cells and particles along the axis of a cell to the problem."""


@dataclass(frozen=True)
class Case:
    """One problem, the resolutions it is swept over, and what is swept."""

    id: str
    title: str
    norm: str
    """What the error is."""
    unit: str
    """What ``cells`` are counted along."""
    build: Build
    resolutions: tuple[int, ...]
    """Cells, coarse to fine, about a factor ten in work from one end to the other."""
    quick: tuple[int, ...]
    """The few that tell whether it runs."""
    leave_out: tuple[str, ...] = ()
    """Series that cannot matter to it."""
    peers: tuple[str, ...] = ("taichi",)
    """Other codes that can run it."""
    reference: tuple[int, ...] = ()
    """Resolutions whose extrapolation is the reference; none if the answer is known in closed form."""

    @property
    def middle(self) -> int:
        """The resolution at which settings other than Δx are varied in quick forms."""
        return self.resolutions[len(self.resolutions) // 2]


WALLS = ("elastic contact", "no mirror")
"""Series that need a wall."""

FASTEST = ("CFL 0.7", "cubic, CFL 0.7", "plain MLS, CFL 0.7", "plain APIC, CFL 0.7")
"""Series whose step, which is pinned, is refused where a body becomes stiffer or faster on the way."""

ALL_BUT_SPLINES = tuple(
    c.series for c in CHOICES if c.axis not in ("default", "order", "force") and c.series != "plain MLS"
)
"""All series but those of splines and forces, and the plain scheme to compare with."""


def rms(u: Tensor) -> float:
    """Root of the mean square length of vectors, shape (N, 3)."""
    return float(u.square().sum(1).mean().sqrt())


BAR_C, BAR_V = 10.0, 0.1
"""Wave speed √(E/ρ) [m/s] and the velocity of the ends [m/s]: strains of 1 %."""


def bar(n: int, per: float = 2) -> Problem:
    """W1: a free bar of length 1 and n × 2 × 2 cells rings for two periods in its first mode, strains of 1 %.

    Its ends move by n/314 cells: the finer the grid, the more particles sit where the quadrature of a cell was not
    exact for them at the start. W1b is the same bar where they do not.
    """
    return ringing(n, per, BAR_V)


def faint(n: int, per: float = 2) -> Problem:
    """W1b: the bar of W1 with a tenth of its amplitude: particles hardly leave their places in a cell, and what is
    left is the error of the grid."""
    return ringing(n, per, BAR_V / 10)


def ringing(n: int, per: float, speed: float) -> Problem:
    """A free bar whose ends start at ``speed`` [m/s]."""
    body = block((n, 2, 2), 1 / n, per=per, nu=0.0)  # type: ignore[arg-type]
    X = body.x[:, 0]
    k, period, frames = math.pi, 2.0 / BAR_C, 8
    v, grad = torch.zeros_like(body.x), torch.zeros(len(X), 3, 3, dtype=X.dtype)
    v[:, 0], grad[:, 0, 0] = speed * torch.cos(k * X), -speed * k * torch.sin(k * X)
    times = tuple(2 * period * (i + 1) / frames for i in range(frames))

    def error(x: Positions) -> float:
        exact = displacement(X, times, speed, BAR_C)
        worst = 0.0
        for i in range(frames // 2, frames):
            u = x[i + 1] - x[0]
            worst = max(worst, rms(torch.cat([(u[:, 0] - exact[i])[:, None], u[:, 1:]], 1)))
        return worst * k * BAR_C / speed

    return Problem(body, 1 / n, n, 2 * period, frames, BAR_C + speed, error, v, grad)


def manufactured(n: int, per: float = 2) -> Problem:
    """W2: the unit cube in the motion of B1, driven by the body force that makes it exact, strains of 20 %."""
    body = block((n, n, n), 1 / n, per=per)  # type: ignore[arg-type]
    exact = Compact(body.x)
    v, grad = exact.velocity()
    T = 0.35 / WAVE

    def error(x: Positions) -> float:
        return rms(x[1] - x[0] - exact.u(T)) / abs(A[0])

    speed = float(v.norm(dim=1).max())
    return Problem(body, 1 / n, n, T, 1, body.c + speed, error, v, grad, force=lambda t: exact.force(body, t))


def sides(width: float) -> tuple[HalfSpace, HalfSpace]:
    """Two walls to slip along, 0 ≤ y ≤ width: plane strain."""
    return (
        HalfSpace(kind="slip", normal=(0.0, 1.0, 0.0)),
        HalfSpace(kind="slip", point=(0.0, width, 0.0), normal=(0.0, -1.0, 0.0)),
    )


def cantilever(n: int, per: float = 2) -> Problem:
    """W3: a soft strip of 100 × 20 mm, clamped at one end, falls under gravity in plane strain to its lowest point; n
    cells through its height, five between the sides, the least that two mirrors need."""
    h, E = 0.02, 1.6e5
    dx = h / n
    body = block((5 * n, 5, n), dx, per=per, E=E, nu=0.4)  # type: ignore[arg-type]
    tip = body.x[:, 0] > 4.5 * h
    seconds, frames = 0.11, 8

    def observe(x: Positions) -> Tensor:
        """Mean displacement of the last tenth along x and z, shape (frames, 2) [m]."""
        return torch.stack([(a - x[0])[tip].mean(0)[[0, 2]] for a in x[1:]])

    walls = (HalfSpace(kind="sticky", normal=(1.0, 0.0, 0.0)), *sides(5 * dx))
    return Problem(
        body, dx, n, seconds, frames, body.c + 1.0, Against("W3", observe), gravity=(0.0, 0.0, -G), walls=walls
    )


def incline(n: int, per: float = 2) -> Problem:
    """W4: a block of 320 × 120 × 80 mm, n cells high, slides down 35° with μ = 0.3 for half a second, let go
    unloaded."""
    dx, angle, mu, T, frames = 0.08 / n, math.radians(35.0), 0.3, 0.5, 8
    body = block((4 * n, 1.5 * n, n), dx, per=per, E=STIFF)  # type: ignore[arg-type]
    a = G * (math.sin(angle) - mu * math.cos(angle))

    def error(x: Positions) -> float:
        squares = 0.0
        for i in range(1, frames + 1):
            t = T * i / frames
            squares += (float((x[i] - x[0])[:, 0].mean()) - a * t * t / 2) ** 2
        return math.sqrt(squares / frames) / (a * T * T / 2)

    gravity = (G * math.sin(angle), 0.0, -G * math.cos(angle))
    return Problem(
        body, dx, n, T, frames, body.c + a * T, error, gravity=gravity, walls=(HalfSpace(friction=mu),)
    )  # fmt: skip


DAM_A, DAM_K = 0.05715, 4e5
"""Width of the column [m] and bulk modulus [Pa]: sound ten times as fast as the front."""


def dam(n: int, per: float = 2) -> Problem:
    """W5: a column of water, n cells wide and twice as high, between slip walls, collapses (Martin & Moyce 1952)."""
    dx, g = DAM_A / n, G
    theta = {"bulk_modulus": DAM_K, "gamma": 7.0}
    body = block((n, 2, 2 * n), dx, per=per, elastic="fluid_eos", plastic="fluid", theta=theta)  # type: ignore[arg-type]
    c, seconds, frames = math.sqrt(DAM_K / body.rho), 2.5 * math.sqrt(DAM_A / (2 * g)), 8
    walls = (HalfSpace(kind="slip"), HalfSpace(kind="slip", normal=(1.0, 0.0, 0.0)), *sides(2 * dx))
    return Problem(
        body, dx, n, seconds, frames, c + 2.0, Against("W5", reach), gravity=(0.0, 0.0, -g), walls=walls
    )  # fmt: skip


def reach(x: Positions) -> Tensor:
    """How far 95 % of the matter reaches along x and z, shape (frames, 2) [m]; less noisy than its last grain."""
    share = torch.tensor([0.95], dtype=torch.float64)
    return torch.stack([torch.cat([torch.quantile(a[:, k], share) for k in (0, 2)]) for a in x[1:]])


def drop(n: int, per: float = 2) -> Problem:
    """W8: a ball of 100 mm and 0.1 MPa, n cells across, falls 100 mm and bounces: a film in small."""
    d, drop_, E = 0.1, 0.1, 1e5
    dx, seconds, frames = d / n, 0.36, 9
    whole = block((n, n, n), dx, per=per, E=E)  # type: ignore[arg-type]
    inside = (whole.x - d / 2).norm(dim=1) < d / 2
    vol = whole.vol[inside]
    body = Body(whole.x[inside] + whole.x.new_tensor([0.0, 0.0, drop_]), vol * (math.pi * d**3 / 6 / vol.sum()), E=E)
    speed = math.sqrt(2 * G * drop_)
    return Problem(
        body, dx, n, seconds, frames, body.c + 1.5 * speed, Against("W8", outline), gravity=(0.0, 0.0, -G),
        walls=(HalfSpace(friction=0.5),),
    )  # fmt: skip


def outline(x: Positions) -> Tensor:
    """Height of the centre, and root mean square width and height about it, shape (frames, 3) [m]."""
    rows = []
    for a in x[1:]:
        q = a - a.mean(0)
        width = q[:, :2].square().sum(1).mean().sqrt()
        rows.append(torch.stack([a[:, 2].mean(), width, q[:, 2].square().mean().sqrt()]))
    return torch.stack(rows)


CASES = {
    c.id: c
    for c in (
        Case(
            "W1", "Free bar", "largest rms error of u in the second period / amplitude", "length", bar,
            (8, 16, 32, 64, 128), (8, 16), WALLS, ("taichi", "svd", "newton"),
        ),
        Case(
            "W1b", "Faint bar", "largest rms error of u in the second period / amplitude", "length", faint,
            (16, 32, 64), (16,), ALL_BUT_SPLINES, (),
        ),
        Case(
            "W2", "Manufactured solution", "rms error of u / 40 mm at t = 0.35 L/c", "edge", manufactured,
            (6, 8, 12, 16, 24), (6, 8), WALLS, ("taichi", "svd"),
        ),
        Case(
            "W3", "Cantilever", "rms error of the tip / its largest displacement", "height", cantilever,
            (2, 3, 4, 6), (2,), (), ("taichi", "svd"), (4, 6, 9),
        ),
        Case(
            "W4", "Coulomb friction", "rms error of the way down the incline / way", "height", incline,
            (2, 4, 6), (2,), ("no mirror",), ("taichi", "svd"),
        ),
        Case(
            "W5", "Dam break", "rms error of the 95 % reach along x and z / its largest change", "width", dam,
            (6, 8, 12, 16), (6,), FASTEST, ("taichi",), (12, 18, 27),
        ),
        Case(
            "W8", "Bouncing ball", "rms error of height, width and centre / largest change", "diameter", drop,
            (6, 8, 12, 16), (6,), ("no mirror", *FASTEST), ("taichi", "svd"), (8, 12, 18),
        ),
    )
}  # fmt: skip
"""The problems that move; W6 and W7 measure gradients and pictures."""

__all__ = ["CASES", "Against", "Case", "Observe"]
