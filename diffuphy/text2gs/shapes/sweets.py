"""Sweets."""

import math

from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.food import GOLDEN
from diffuphy.text2gs.shapes.primitives import RGB, Paint, Part, Recipe, Sketch


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
            Part("icing", "butter", (0.97, 0.56, 0.70), ("frosting", "glaze", "topping")),
            Part("sprinkles", "chocolate", (0.98, 0.90, 0.35), ("sprinkle",), feature=True),
        ),
        donut,
    ),
)
