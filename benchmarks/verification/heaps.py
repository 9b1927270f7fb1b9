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


@lru_cache
def glided(s: Setting, angle: float, friction: float = 31.0) -> float:
    """Friction tan θ − a/(g cos θ) that the middle of a layer of sand shows on an incline [-]: 5 cells deep, on a floor
    that sticks, a being its mean acceleration from 0.2 to 0.4 s after it was set free.

    It is twenty depths long: the free ends slump, for a layer as steep as its floor has no slope left to rest at, and
    what they take along comes inward by √(g h) = 0.7 m/s, 28 cells in that time. One of eight depths is in extension
    all along, σ_xx = 0.7 σ_zz, and shows 0.40. Five cells wide, so that both sides are mirrors.
    """
    cells, length, wide, dx, step = 5, 100, 5, 0.01, 0.02
    theta = {"friction_angle": friction, "cohesion": 0.0}
    sand = {"elastic": "hencky", "plastic": "drucker_prager_plane_strain", "theta": theta}
    body = block((length, wide, cells), dx, rho=1500.0, **sand)
    walls = (
        HalfSpace(kind="sticky"),
        HalfSpace(kind="slip", normal=(0.0, 1.0, 0.0)),
        HalfSpace(kind="slip", point=(0.0, wide * dx, 0.0), normal=(0.0, -1.0, 0.0)),
    )
    a = math.radians(angle)
    scene = {"dx": dx, "gravity": (G * math.sin(a), 0.0, -G * math.cos(a)), "boundaries": walls}
    per = math.ceil(step / (0.4 * dx / (body.c + 0.5)))
    states = run(s, body, step / per, per, 20, scene=scene)
    middle = (body.x[:, 0] / dx - length / 2).abs() < 6
    early, late = (float(states[k].v[middle, 0].mean()) for k in (10, 20))
    return math.tan(a) - (late - early) / (10 * step) / (G * math.cos(a))


@case("C8b", "Layer of sand on an incline", tier=1, schemes=("default",))
def layer(s: Setting) -> list[Check]:
    """a = g (sin θ − q cos θ), q = 3 tan φ/√(9 + 12 tan² φ) = 0.494 (26.3°) at φ = 31° in plane strain; a = 0 below.

    With the flow of constant volume σ_xx = σ_yy = σ_zz in simple shear, so that τ_xz/σ_zz = 3α/√2 = q on the cone.
    Half a cell at the floor or at the surface, a tenth of the depth, is not resolved: q to 10 %. At 24° the layer keeps
    its velocity to 1 % of g cos θ, less than a quarter of what it would gain with q = 0.40.
    """
    q = 3 * math.tan(math.radians(31.0)) / math.sqrt(9 + 12 * math.tan(math.radians(31.0)) ** 2)
    rests = math.tan(math.radians(24.0))
    return [
        near("friction it needs at 24°, at rest tan θ", glided(s, 24.0), rests, 0.01),
        near("friction it shows at 30°", glided(s, 30.0), q, 0.1 * q),
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
