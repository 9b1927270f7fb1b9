"""Things to eat."""

import math

from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.primitives import RGB, Paint, Part, Recipe, Sketch

GOLDEN = 2.399963
"""Golden angle [rad]: successive multiples spread points evenly over a disc or dome (Vogel 1979)."""


def burger(s: Sketch) -> None:
    """Bun, patty, cheese, lettuce, tomato, bun, sesame, stacked on whatever of them is there."""
    r, z = s.vary(0.80, 0.06), 0.0
    crumb: RGB = (0.97, 0.83, 0.58)
    half = s.vary(0.14, 0.2)
    if s.has("bun"):
        s.disc(
            "bun",
            (0, 0, z + half),
            r * 0.97,
            half,
            0.12,
            paint=s.paint("bun", (0.93, 0.72, 0.42), pattern=k.HEIGHT, scale=0.1),
        )
        s.disc("bun", (0, 0, z + 2 * half - 0.02), r * 0.93, 0.03, 0.02, paint=Paint(crumb))
        z += 2 * half
    half = s.vary(0.12, 0.25)
    if s.has("patty"):
        brown = s.paint("patty", (0.22, 0.10, 0.05), pattern=k.NOISE, scale=7.0, grain=0.12)
        s.disc("patty", (0, 0, z + half), r * 1.04, half, 0.09, paint=brown, bend=(0.0, 0.015, 9, 0.0))
        z += 2 * half - 0.01
    turn = s.jitter(40)
    if s.has("cheese"):
        s.box(
            "cheese",
            (0, 0, z + 0.035),
            (r * 0.93, r * 0.93, 0.032),
            0.025,
            turn=(0, 0, 30 + turn),
            bend=(0, 0, 0, 0.10),
        )
        z += 0.05
    turn = s.jitter(40)
    if s.has("lettuce"):
        leaf = s.paint("lettuce", (0.62, 0.86, 0.36), pattern=k.RIM, scale=1.0)
        s.disc(
            "lettuce",
            (0, 0, z + 0.05),
            r * 1.12,
            0.035,
            0.03,
            paint=leaf,
            turn=(0, 0, turn),
            bend=(0.075, 0.03, 9, 0.04),
        )
        s.disc(
            "lettuce",
            (0, 0, z + 0.07),
            r * 1.04,
            0.03,
            0.03,
            paint=leaf,
            turn=(0, 0, 23 + turn),
            bend=(0.06, 0.03, 7, 0.0),
        )
        z += 0.10
    if s.has("tomato"):
        for i in range(3):
            at = (0.36 * r * math.cos(GOLDEN + 2.1 * i), 0.36 * r * math.sin(GOLDEN + 2.1 * i), z + 0.035)
            s.disc(
                "tomato",
                at,
                0.56 * r,
                0.045,
                0.03,
                paint=s.paint("tomato", (0.95, 0.42, 0.30), pattern=k.RIM, scale=1.0, gloss=0.3),
            )
        z += 0.07
    top = s.vary(0.50, 0.15)
    if s.has("bun"):
        s.disc("bun", (0, 0, z + 0.035), r * 0.95, 0.035, 0.03, paint=Paint(crumb))
        crust = s.paint("bun", (0.95, 0.72, 0.40), pattern=k.HEIGHT, scale=0.12, gloss=0.25)
        s.dome("bun", (0, 0, z + 0.03), (r * 1.02, r * 1.02, top), 0.16, paint=crust)
        _seeds(s, z + 0.03, r * 1.02, top)


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
        s.limb(
            "syrup",
            (0.42 * c, 0.42 * sn, z + 0.005),
            (0.80 * c, 0.80 * sn, z - 0.005),
            0.07,
            0.06,
            paint=gold,
            blend=0.06,
        )
        s.limb(
            "syrup",
            (0.80 * c, 0.80 * sn, z - 0.005),
            (far * c, far * sn, z - fall),
            0.055,
            0.07,
            paint=gold,
            blend=0.06,
        )
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


def cake(s: Sketch) -> None:
    """Two sponge layers with a filling, icing that runs down, whipped rosettes, cherries and candles."""
    r, h = 0.80, s.vary(0.19, 0.1)
    crumb = s.paint("sponge", (0.98, 0.84, 0.58), pattern=k.NOISE, scale=11.0, grain=0.10)
    s.disc("sponge", (0, 0, h), r, h, 0.04, paint=crumb)
    s.disc("filling", (0, 0, 2 * h + 0.035), r * 1.01, 0.05, 0.045)
    s.disc("sponge", (0, 0, 3 * h + 0.07), r, h, 0.04, paint=crumb)
    z = 4 * h + 0.07
    icing = s.paint("icing", gloss=0.35)
    s.disc("icing", (0, 0, z), r * 1.035, 0.07, 0.065, paint=icing)
    for i in range(15):
        theta = 2 * math.pi * i / 15
        c, sn = 0.79 * math.cos(theta), 0.79 * math.sin(theta)
        s.limb(
            "icing",
            (c, sn, z - 0.02),
            (c, sn, z - 0.20 - 0.16 * abs(s.scatter())),
            0.075,
            0.065,
            paint=icing,
            blend=0.06,
        )
    for i in range(8):
        theta = 2 * math.pi * (i + 0.5) / 8
        c, sn = 0.58 * math.cos(theta), 0.58 * math.sin(theta)
        s.dome("cream", (c, sn, z + 0.06), (0.13, 0.13, 0.10), 0.03, bend=(0, 0.12, 6, 0))
        s.limb("cream", (c, sn, z + 0.11), (c, sn, z + 0.20), 0.07, 0.015, blend=0.05)
        s.ball("cherry", (c, sn, z + 0.24), 0.085, paint=s.paint("cherry", gloss=0.8))
    for i in range(5):
        theta = 2 * math.pi * i / 5 + 0.3
        c, sn = 0.25 * math.cos(theta), 0.25 * math.sin(theta)
        stripe = s.paint("candle", ((0.93, 0.35, 0.45), (0.35, 0.62, 0.90))[i % 2], pattern=k.STRIPES, scale=9.0)
        s.disc("candle", (c, sn, z + 0.25), 0.036, 0.21, 0.012, paint=stripe)
        s.limb("flame", (c, sn, z + 0.52), (c, sn, z + 0.60), 0.042, 0.008, paint=s.paint("flame", glow=1.0))


def ice_cream(s: Sketch) -> None:
    """A waffle cone with three scoops, a wafer of chocolate sauce and a cherry."""
    waffle = s.paint("cone", (0.72, 0.44, 0.18), pattern=k.WAFFLE, scale=12.0)
    s.frustum("cone", (0, 0, 0.55), 0.05, 0.47, 0.56, 0.04, paint=waffle)
    s.torus("cone", (0, 0, 1.09), 0.45, 0.05, paint=Paint((0.83, 0.56, 0.27)))
    pink: RGB = (0.98, 0.66, 0.72)
    brown: RGB = (0.48, 0.29, 0.18)
    vanilla = s.parts["scoop"].colour
    places = ((0.20, -0.12, 1.30, pink), (-0.19, 0.14, 1.32, brown), (0.02, 0.02, 1.74, vanilla))
    for x, y, z, colour in places:
        r = s.vary(0.42, 0.05)
        paint = Paint(colour, tuple(0.93 * c for c in colour), pattern=k.NOISE, scale=6.0, grain=0.04)
        s.ball("scoop", (x, y, z), r, paint=paint)
        s.torus("scoop", (x, y, z - 0.19), r * 0.93, 0.065, paint=paint, blend=0.10, bend=(0, 0.04, 9, 0))
    sauce = s.paint("sauce", gloss=0.6)
    s.dome("sauce", (0.02, 0.02, 1.84), (0.39, 0.39, 0.345), 0.03, paint=sauce)
    for i in range(8):
        theta = 2 * math.pi * i / 8
        c, sn = math.cos(theta), math.sin(theta)
        low = 1.76 - 0.14 * abs(s.scatter())
        s.limb(
            "sauce",
            (0.36 * c + 0.02, 0.36 * sn + 0.02, 1.88),
            (0.42 * c + 0.02, 0.42 * sn + 0.02, low),
            0.055,
            0.05,
            paint=sauce,
            blend=0.05,
        )
    s.ball("cherry", (0.02, 0.02, 2.27), 0.13, paint=s.paint("cherry", gloss=0.8))
    s.limb("stem", (0.02, 0.02, 2.36), (0.09, 0.08, 2.50), 0.015, 0.015)


def donut(s: Sketch) -> None:
    s.torus("dough", (0, 0, 0), 0.62, 0.34, paint=s.paint("dough", (0.95, 0.78, 0.50), pattern=k.HEIGHT, scale=0.25))
    icing = s.paint("icing", gloss=0.6)
    s.torus("icing", (0, 0, 0.07), 0.62, 0.325, paint=icing, bend=(0.035, 0.0, 9, 0.0))
    colours = ((0.98, 0.90, 0.35), (0.40, 0.75, 0.95), (0.98, 0.98, 0.98), (0.55, 0.85, 0.45), (0.95, 0.35, 0.35))
    for i in range(54):
        theta, phi = GOLDEN * i, math.radians(90 + s.scatter(62))
        ring = 0.62 + 0.325 * math.cos(phi)
        x, y, z = ring * math.cos(theta), ring * math.sin(theta), 0.07 + 0.33 * math.sin(phi)
        spin = s.scatter(3.14)
        away = (math.cos(theta) * math.cos(phi), math.sin(theta) * math.cos(phi), math.sin(phi))
        side, up = (-math.sin(theta), math.cos(theta), 0.0), _cross(away, (-math.sin(theta), math.cos(theta), 0.0))
        d = [0.05 * (math.cos(spin) * a + math.sin(spin) * b) for a, b in zip(side, up, strict=True)]
        ends = [(x + sign * d[0], y + sign * d[1], z + 0.015 + sign * d[2]) for sign in (-1, 1)]
        s.limb("sprinkles", *ends, 0.022, 0.022, paint=Paint(colours[i % 5]))


def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


RED: RGB = (0.85, 0.12, 0.12)
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
    Recipe(
        "cake",
        ("birthday cake", "layer cake", "sponge cake", "gateau"),
        "{} birthday cake",
        (
            Part("sponge", "cake", (0.90, 0.68, 0.36), ("layer", "base")),
            Part("filling", "cream", (0.92, 0.30, 0.38), ("jam",)),
            Part("icing", "cream", (1.00, 0.80, 0.84), ("frosting", "glaze", "topping")),
            Part("cream", "cream", (1.00, 0.97, 0.92), ("rosette", "whipped cream")),
            Part("cherry", "apple", RED, ("berry", "fruit"), feature=True),
            Part("candle", "wax", (0.98, 0.96, 0.92), feature=True),
            Part("flame", "wax", (1.00, 0.78, 0.20), ("fire",), feature=True),
        ),
        cake,
    ),
    Recipe(
        "ice cream",
        ("icecream", "ice cream cone", "icecream cone", "gelato", "sundae", "soft serve"),
        "{} ice cream cone",
        (
            Part("scoop", "icecream", (0.99, 0.92, 0.76), ("ball", "top")),
            Part("cone", "bread", (0.90, 0.66, 0.34), ("waffle", "wafer", "waffle cone")),
            Part("sauce", "chocolate", (0.36, 0.18, 0.10), ("topping", "syrup")),
            Part("cherry", "apple", RED, feature=True),
            Part("stem", "apple", (0.40, 0.30, 0.14), ("cherry stem",), feature=True),
        ),
        ice_cream,
    ),
    Recipe(
        "donut",
        ("doughnut",),
        "{} donut",
        (
            Part("dough", "cake", (0.80, 0.50, 0.22), ("ring", "base")),
            Part("icing", "chocolate", (0.97, 0.56, 0.70), ("frosting", "glaze", "topping")),
            Part("sprinkles", "chocolate", (0.98, 0.90, 0.35), ("sprinkle",), feature=True),
        ),
        donut,
    ),
)
