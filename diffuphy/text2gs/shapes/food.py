"""Things to eat."""

import math

from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.primitives import RGB, Paint, Part, Recipe, Sketch

GOLDEN = 2.399963
"""Golden angle [rad]: successive multiples spread points evenly over a disc or dome (Vogel 1979)."""
CRUMB: RGB = (0.97, 0.83, 0.58)


def burger(s: Sketch) -> None:
    """Bun, patty, cheese, lettuce, tomato, bun, sesame, stacked on whatever of them is there."""
    r = s.vary(0.80, 0.06)
    z = _bun_and_patty(s, r)
    z = _cheese_and_salad(s, r, z)
    top = s.vary(0.50, 0.15)
    if s.has("bun"):
        s.disc("bun", (0, 0, z + 0.035), r * 0.95, 0.035, 0.03, paint=Paint(CRUMB))
        crust = s.paint("bun", (0.95, 0.72, 0.40), pattern=k.HEIGHT, scale=0.12, gloss=0.25)
        s.dome("bun", (0, 0, z + 0.03), (r * 1.02, r * 1.02, top), 0.16, paint=crust)
        _seeds(s, z + 0.03, r * 1.02, top)


def _bun_and_patty(s: Sketch, r: float) -> float:
    """The lower half of a burger of radius r; returns its height."""
    z = 0.0
    half = s.vary(0.14, 0.2)
    if s.has("bun"):
        crust = s.paint("bun", (0.93, 0.72, 0.42), pattern=k.HEIGHT, scale=0.1)
        s.disc("bun", (0, 0, z + half), r * 0.97, half, 0.12, paint=crust)
        s.disc("bun", (0, 0, z + 2 * half - 0.02), r * 0.93, 0.03, 0.02, paint=Paint(CRUMB))
        z += 2 * half
    half = s.vary(0.12, 0.25)
    if s.has("patty"):
        brown = s.paint("patty", (0.22, 0.10, 0.05), pattern=k.NOISE, scale=7.0, grain=0.12)
        s.disc("patty", (0, 0, z + half), r * 1.04, half, 0.09, paint=brown, bend=(0.0, 0.015, 9, 0.0))
        z += 2 * half - 0.01
    return z


def _cheese_and_salad(s: Sketch, r: float, z: float) -> float:
    """Cheese, lettuce and tomato of a burger of radius r, from height z on; returns the height reached."""
    turn = s.jitter(40)
    if s.has("cheese"):
        half = (r * 0.93, r * 0.93, 0.032)
        s.box("cheese", (0, 0, z + 0.035), half, 0.025, turn=(0, 0, 30 + turn), bend=(0, 0, 0, 0.10))
        z += 0.05
    turn = s.jitter(40)
    if s.has("lettuce"):
        leaf = s.paint("lettuce", (0.62, 0.86, 0.36), pattern=k.RIM, scale=1.0)
        for up, wide, half, angle, bend in (
            (0.05, 1.12, 0.035, turn, (0.075, 0.03, 9, 0.04)),
            (0.07, 1.04, 0.03, 23 + turn, (0.06, 0.03, 7, 0.0)),
        ):
            s.disc("lettuce", (0, 0, z + up), r * wide, half, 0.03, paint=leaf, turn=(0, 0, angle), bend=bend)
        z += 0.10
    if s.has("tomato"):
        slice_ = s.paint("tomato", (0.95, 0.42, 0.30), pattern=k.RIM, scale=1.0, gloss=0.3)
        for i in range(3):
            at = (0.36 * r * math.cos(GOLDEN + 2.1 * i), 0.36 * r * math.sin(GOLDEN + 2.1 * i), z + 0.035)
            s.disc("tomato", at, 0.56 * r, 0.045, 0.03, paint=slice_)
        z += 0.07
    return z


def _seeds(s: Sketch, z: float, r: float, top: float) -> None:
    """Sesame on the dome, each lying flat and pointing its own way."""
    for i in range(34):
        rho = 0.80 * math.sqrt((i + 0.6) / 34)
        theta = GOLDEN * i + s.scatter(0.25)
        x, y = rho * math.cos(theta), rho * math.sin(theta)
        h = math.sqrt(1 - rho * rho)
        n = (x / r, y / r, h / top)
        tilt, spin = math.degrees(math.atan2(math.hypot(n[0], n[1]), n[2])), math.degrees(theta)
        s.ellipsoid("sesame", (x * r, y * r, z + h * top), (0.042, 0.026, 0.018), turn=(s.scatter(15), tilt, spin))


def pancakes(s: Sketch) -> None:
    z, r = 0.0, 0.85
    for _ in range(6):
        half, wide = s.vary(0.075, 0.15), s.vary(r, 0.03) * (1 + s.scatter(0.02))
        face = s.paint("pancake", (0.97, 0.84, 0.58), pattern=k.RIM, scale=1.0)
        at = (s.scatter(0.035), s.scatter(0.035), z + half)
        s.disc("pancake", at, wide, half, 0.07, paint=face, bend=(0.012, 0.0, 3, 0.0), turn=(0, 0, s.scatter(180)))
        z += 2 * half - 0.012
    gold = s.paint("syrup", gloss=0.8, glow=0.15)
    s.disc("syrup", (0, 0, z + 0.005), 0.56, 0.03, 0.028, paint=gold, bend=(0.0, 0.10, 6, 0.0))
    for i in range(6):
        theta = 2 * math.pi * i / 6 + s.scatter(0.3)
        c, sn = math.cos(theta), math.sin(theta)
        far, fall = 0.875 + s.scatter(0.01), 0.22 + 0.18 * abs(s.scatter())
        rim = (0.80 * c, 0.80 * sn, z - 0.005)
        s.limb("syrup", (0.42 * c, 0.42 * sn, z + 0.005), rim, 0.07, 0.06, paint=gold, blend=0.06)
        s.limb("syrup", rim, (far * c, far * sn, z - fall), 0.055, 0.07, paint=gold, blend=0.06)
    pat = s.paint("butter", gloss=0.3)
    s.box("butter", (0.02, 0, z + 0.10), (0.20, 0.20, 0.08), 0.04, paint=pat, turn=(s.jitter(4), 4, 25 + s.jitter(40)))


def jelly(s: Sketch) -> None:
    """A ribbed mould turned out on nothing: wide skirt, two tiers, a dimpled crown."""
    ribs, n = s.vary(0.075, 0.2), 12
    clear = s.paint("jelly", (0.99, 0.36, 0.34), pattern=k.HEIGHT, scale=0.5, gloss=0.7, glow=0.2)
    s.frustum("jelly", (0, 0, 0.12), s.vary(0.95, 0.04), 0.88, 0.14, 0.10, paint=clear, bend=(0, ribs, n, 0))
    s.frustum(
        "jelly", (0, 0, 0.52), 0.86, s.vary(0.62, 0.06), 0.34, 0.12, paint=clear, bend=(0, ribs, n, 0), blend=0.06
    )
    s.frustum("jelly", (0, 0, 0.92), 0.56, 0.46, 0.16, 0.12, paint=clear, bend=(0, ribs, n, 0), blend=0.10)
    s.ball("jelly", (0, 0, 1.22), 0.26, paint=clear, cut=True, blend=0.10)


RECIPES = (
    Recipe(
        "burger",
        ("hamburger", "cheeseburger", "cheese burger"),
        "{} burger",
        (
            Part("bun", "bun", (0.86, 0.52, 0.20), ("bread",)),
            Part("patty", "patty", (0.40, 0.20, 0.10), ("meat", "beef", "steak")),
            Part("cheese", "cheese", (1.00, 0.74, 0.12), ("cheddar",)),
            Part("lettuce", "lettuce", (0.36, 0.70, 0.18), ("salad", "leaf")),
            Part("tomato", "apple", (0.88, 0.18, 0.12), ("ketchup",)),
            Part("sesame", "bun", (0.99, 0.92, 0.72), ("seed", "sesame seed"), feature=True),
        ),
        burger,
    ),
    Recipe(
        "pancakes",
        ("pancake", "pancake stack", "stack of pancake", "pile of pancake"),
        "stack of {} pancakes",
        (
            Part("pancake", "pancake", (0.80, 0.50, 0.20)),
            Part("syrup", "syrup", (0.58, 0.26, 0.04), ("maple syrup", "sauce", "honey")),
            Part("butter", "butter", (1.00, 0.90, 0.45), ("pat", "pat of butter")),
        ),
        pancakes,
    ),
    Recipe(
        "jelly",
        ("jello", "gelatin", "jelly pudding", "pudding", "jelly mould", "jelly mold"),
        "{} jelly pudding",
        (Part("jelly", "jelly", (0.93, 0.16, 0.22)),),
        jelly,
    ),
)
