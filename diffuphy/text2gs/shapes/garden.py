"""Things that grow."""

import math

from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.food import GOLDEN
from diffuphy.text2gs.shapes.primitives import RGB, Paint, Part, Recipe, Sketch


def apple(s: Sketch) -> None:
    skin = s.paint("flesh", (0.93, 0.62, 0.18), pattern=k.HEIGHT, scale=0.75, gloss=0.5)
    s.ellipsoid("flesh", (0, 0, 0.06), (s.vary(0.80, 0.04), s.vary(0.80, 0.04), 0.72), paint=skin)
    s.ellipsoid("flesh", (0, 0, -0.36), (0.52, 0.52, 0.42), paint=skin, blend=0.30)
    s.ellipsoid("flesh", (0, 0, 0.84), (0.20, 0.20, 0.26), paint=skin, cut=True, blend=0.36)
    s.ellipsoid("flesh", (0, 0, -0.86), (0.16, 0.16, 0.16), paint=skin, cut=True, blend=0.15)
    s.limb("stem", (0, 0, 0.48), (0.07, 0.05, 0.98), 0.03, 0.045)
    leaf = s.paint("leaf", gloss=0.25)
    s.ellipsoid("leaf", (-0.10, 0.24, 0.88), (0.13, 0.26, 0.035), paint=leaf, turn=(22, 8, 25 + s.jitter(30)))


def pumpkin(s: Sketch) -> None:
    skin = s.paint("flesh", (0.80, 0.36, 0.06), pattern=k.HEIGHT, scale=0.9, gloss=0.2)
    s.ellipsoid("flesh", (0, 0, 0), (s.vary(0.92, 0.03), 0.92, s.vary(0.70, 0.08)), paint=skin, bend=(0, 0.07, 10, 0))
    s.ellipsoid("flesh", (0, 0, 0.80), (0.22, 0.22, 0.20), paint=skin, cut=True, blend=0.25)
    s.limb("stem", (0, 0, 0.50), (0.06, 0.05, 0.82), 0.12, 0.075, bend=(0, 0.12, 5, 0))
    s.limb("stem", (0.06, 0.05, 0.82), (0.18, 0.12, 0.95), 0.078, 0.065, blend=0.05)


def mushroom(s: Sketch) -> None:
    s.frustum(
        "stalk",
        (0, 0, 0.40),
        s.vary(0.34, 0.1),
        0.24,
        0.42,
        0.10,
        paint=s.paint("stalk", (0.90, 0.84, 0.72), pattern=k.HEIGHT, scale=0.4),
    )
    s.torus("stalk", (0, 0, 0.62), 0.26, 0.045, blend=0.05, bend=(0.02, 0.0, 8, 0.03))
    top = s.vary(0.62, 0.08)
    s.disc("gills", (0, 0, 0.83), 0.78, 0.05, 0.04)
    s.dome("cap", (0, 0, 0.82), (0.90, 0.90, top), 0.10, paint=s.paint("cap", gloss=0.5))
    for i in range(15):
        rho, theta = 0.86 * math.sqrt((i + 0.3) / 15), GOLDEN * i
        x, y, h = rho * math.cos(theta), rho * math.sin(theta), math.sqrt(1 - rho * rho)
        tilt = math.degrees(math.atan2(rho / 0.9, h / top))
        size = 0.12 - 0.05 * rho
        s.ellipsoid(
            "spots",
            (0.89 * x, 0.89 * y, 0.82 + 0.99 * h * top),
            (size, size, 0.035),
            turn=(0, tilt, math.degrees(theta)),
        )


def cactus(s: Sketch) -> None:
    skin = s.paint("cactus", (0.20, 0.46, 0.22), pattern=k.NOISE, scale=3.0)
    ribs = (0, 0.05, 9, 0)
    s.limb("cactus", (0, 0, 0.40), (0, 0, s.vary(1.55, 0.05)), 0.25, 0.23, paint=skin, bend=ribs)
    high = s.vary(0.95, 0.05)
    s.limb("cactus", (0, 0.20, high - 0.15), (0, 0.48, high), 0.12, 0.13, paint=skin, blend=0.08)
    s.limb("cactus", (0, 0.48, high), (0, 0.50, high + 0.40), 0.135, 0.12, paint=skin, blend=0.08)
    s.limb("cactus", (0, -0.20, high + 0.10), (0, -0.44, high + 0.22), 0.11, 0.115, paint=skin, blend=0.08)
    s.limb("cactus", (0, -0.44, high + 0.22), (0, -0.46, high + 0.50), 0.115, 0.105, paint=skin, blend=0.08)
    for x, y, z in ((0.0, 0.0, 1.80), (0.0, 0.50, high + 0.53)):
        for i in range(5):
            a = 2 * math.pi * i / 5
            s.ellipsoid("flower", (x + 0.07 * math.cos(a), y + 0.07 * math.sin(a), z), (0.065, 0.065, 0.045))
        s.ball("flower", (x, y, z + 0.03), 0.05, paint=Paint((1.0, 0.86, 0.25)))
    s.frustum("pot", (0, 0, 0.10), 0.32, 0.44, 0.30, 0.03)
    s.disc("pot", (0, 0, 0.40), 0.50, 0.085, 0.03)
    s.disc("soil", (0, 0, 0.46), 0.43, 0.05, 0.02)


CLAY: RGB = (0.80, 0.42, 0.26)
RECIPES = (
    Recipe(
        "apple",
        (),
        "{} apple",
        (
            Part("flesh", "apple", (0.84, 0.12, 0.10), ("skin", "fruit")),
            Part("stem", "wood", (0.42, 0.27, 0.14), ("stalk",), feature=True),
            Part("leaf", "lettuce", (0.36, 0.66, 0.20), feature=True),
        ),
        apple,
    ),
    Recipe(
        "pumpkin",
        ("gourd",),
        "{} pumpkin",
        (
            Part("flesh", "apple", (0.95, 0.53, 0.10), ("skin",)),
            Part("stem", "wood", (0.42, 0.46, 0.20), ("stalk",), feature=True),
        ),
        pumpkin,
    ),
    Recipe(
        "mushroom",
        ("toadstool",),
        "{} mushroom",
        (
            Part("cap", "sponge", (0.86, 0.14, 0.12), ("hat", "top")),
            Part("stalk", "sponge", (0.98, 0.95, 0.87), ("stem", "foot")),
            Part("gills", "sponge", (0.92, 0.84, 0.70), ("gill",)),
            Part("spots", "sponge", (0.99, 0.97, 0.93), ("spot", "dot"), feature=True),
        ),
        mushroom,
    ),
    Recipe(
        "cactus",
        (),
        "{} cactus",
        (
            Part("cactus", "apple", (0.32, 0.62, 0.28), ("plant", "stem")),
            Part("flower", "lettuce", (0.96, 0.42, 0.62), ("blossom", "bloom"), feature=True),
            Part("pot", "stone", CLAY, ("flowerpot", "vase")),
            Part("soil", "sand", (0.30, 0.20, 0.13), ("earth",)),
        ),
        cactus,
    ),
)
