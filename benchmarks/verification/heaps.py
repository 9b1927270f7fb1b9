"""C8, C14: what piles up, slides and slumps: heaps and layers of sand, and Bingham fluids."""

import math
from functools import lru_cache

import torch

from benchmarks.verification.bodies import Body, block, run
from benchmarks.verification.case import Check, Setting, at_least, at_most, case, near, within
from benchmarks.verification.flows import collapsed
from diffuphy.mpm import HalfSpace

G = 9.81


def repose(s: Setting, angle: float) -> float:
    """Mean slope of the middle 70 % of a heap [deg], from the highest grain in every centimetre; ``angle`` of friction
    [deg]."""
    end, way = collapsed(s, 0.3, angle)
    x, z, length = end.x[:, 0], end.x[:, 2], 0.1 * (1 + way)
    edges = torch.arange(0.15 * length, 0.85 * length, 0.01, dtype=x.dtype)
    tops = torch.stack([z[(a <= x) & (x < a + 0.01)].amax() for a in edges])
    off = edges - edges.mean()
    return math.degrees(math.atan(-float((off * tops).sum() / (off * off).sum())))


@case("C8", "Angle of repose", tier=1, schemes=("default",))
def heap(s: Setting) -> list[Check]:
    """A heap at rest is no steeper than its angle of friction, and the steeper the larger that is.

    φ = 20°, 31° and 40° in plane strain, the columns of C7 after their collapse, whose inertia makes them flatter: at
    least 0.55 φ at φ = 31° (20 … 24° in an independent code), at most φ + 2° (a slope of one cell in thirty).
    """
    slopes = [repose(s, angle) for angle in (20.0, 31.0, 40.0)]
    return [
        at_most("slope at φ = 20°", slopes[0], 22.0, "°"),
        within("slope at φ = 31°", slopes[1], 0.55 * 31.0, 33.0, unit="°"),
        at_most("slope at φ = 40°", slopes[2], 42.0, "°"),
        at_least(
            "least growth of the slope, 20° to 31° to 40°", min(slopes[1] - slopes[0], slopes[2] - slopes[1]), 0.0
        ),
    ]


def slumped(t: float) -> float:
    """Fall of a cylinder over its height, s' = 1 − 2t' (1 − ln 2t'), t' = τ_Y/(ρ g H) (Pashias et al. 1996, eq. 8)."""
    return 1 - 2 * t * (1 - math.log(2 * t))


@lru_cache
def slump(s: Setting, t: float, kind: str) -> float:
    """Fall over height of a quarter of a cylinder of Bingham fluid, H = D = 10 cm, eight cells, on a floor of ``kind``
    after one second.

    In uniaxial stress matter of the yield stress σ_Y = 2 τ_Y stops where it bears σ_Y, as in the formula; with
    η = 100 Pa s, ρ √(gH) H/η = 1, inertia does not carry it on.
    """
    H, cells = 0.1, 4
    dx = 0.5 * H / cells
    box = block((cells, cells, 2 * cells), dx)
    inside = box.x[:, :2].norm(dim=1) < 0.5 * H
    theta = {"yield_stress": 2 * t * 1000.0 * G * H, "viscosity": 100.0}
    body = Body(box.x[inside], box.vol[inside], elastic="hencky", plastic="viscoplastic", theta=theta)
    walls = (
        HalfSpace(kind=kind),  # type: ignore[arg-type]
        HalfSpace(kind="slip", normal=(1.0, 0.0, 0.0)),
        HalfSpace(kind="slip", normal=(0.0, 1.0, 0.0)),
    )
    per = math.ceil(0.2 / (0.4 * dx / (body.c + 1.0)))
    scene = {"dx": dx, "gravity": (0.0, 0.0, -G), "boundaries": walls}
    end = run(s, body, 0.2 / per, per, 5, scene=scene)[-1]
    top = (body.x[:, 2] > H - dx / 2) & (body.x[:, :2].norm(dim=1) < 0.25 * H)
    return 1 - (float(end.x[top, 2].mean()) + dx / 4) / H


@lru_cache
def channel(s: Setting, time: float = 0.08) -> tuple[float, float]:
    """Relative L2 error of the profile of velocity, and of the plug, in the middle of a sheet of Bingham fluid that a
    body force drives between plates.

    Half of it, 8 cells from the plate to the plane of symmetry, 32 long with free ends.
    """
    b, cells, length, eta = 0.08, 8, 32, 100.0
    dx, y0, top = b / cells, 0.3 * b, 0.25
    push = 2 * eta * top / (b - y0) ** 2  # ρ G
    theta = {"yield_stress": math.sqrt(3.0) * push * y0, "viscosity": eta}
    body = block((length, 2, cells), dx, E=8e5, elastic="hencky", plastic="viscoplastic", theta=theta)
    walls = (HalfSpace(kind="sticky"), HalfSpace(kind="slip", point=(0.0, 0.0, b), normal=(0.0, 0.0, -1.0)))
    per = math.ceil(time / (0.4 * dx / (body.c + 2 * top)))
    scene = {"dx": dx, "gravity": (push / body.rho, 0.0, 0.0), "boundaries": walls}
    end = run(s, body, time / per, per, 1, scene=scene)[-1]
    middle = (body.x[:, 0] / dx - length / 2).abs() < 2
    y = (b - end.x[middle, 2]).clamp_min(y0)
    exact = top * (1 - ((y - y0) / (b - y0)) ** 2)
    u = end.v[middle, 0]
    return float((u - exact).norm() / exact.norm()), float(u.max()) / top - 1


@case("C14", "Bingham fluid between plates", schemes=("default",))
def plates(s: Setting) -> list[Check]:
    """u = ρG/(2η) [(b − y0)² − (|y| − y0)²], a plug in |y| < y0 = τ_Y/(ρG), τ_Y = σ_Y/√3, between sticky plates at ±b.

    Eight cells in b, y0 = 0.3 b, after 80 ms, six times the constant ρ (2 (b − y0)/π)²/η in which it comes to speed.
    To 5 %: the plug begins a cell early or late, and the ends are free.
    """
    profile, plug = channel(s)
    return [
        at_most("L2 error of the profile over its norm", profile, 0.05),
        within("velocity of the plug over the exact one − 1", plug, -0.05, 0.05, 0.0),
    ]


@case("C14b", "Slump of a Bingham fluid", tier=1, schemes=("default",))
def slumps(s: Setting) -> list[Check]:
    """s' = 1 − 2t' (1 − ln 2t'), t' = τ_Y/(ρ g H): what a cylinder sinks until every slice bears what is above it.

    Pashias et al., J. Rheol. 40 (1996). Slices do not hold each other, so the floor slips; to 0.05, the accuracy of
    their measurements. A floor that sticks carries a part, and less sinks.
    """
    checks = [near(f"s' at t' = {t}", slump(s, t, "slip"), slumped(t), 0.05) for t in (0.1, 0.2)]
    sticks = slump(s, 0.1, "sticky") / slump(s, 0.1, "slip")
    return [*checks, within("s' on a floor that sticks over that, t' = 0.1", sticks, 0.5, 1.0)]
