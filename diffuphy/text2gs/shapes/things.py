"""Things that stand, lie about or fall apart."""

import math

from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.food import GOLDEN
from diffuphy.text2gs.shapes.primitives import RGB, Paint, Part, Recipe, Sketch
from diffuphy.text2gs.shapes.toys import DARK


def snowman(s: Sketch) -> None:
    snow = s.paint("body", (0.88, 0.92, 0.98), pattern=k.NOISE, scale=4.0, grain=0.03)
    s.ellipsoid("body", (0, 0, 0), (s.vary(0.60, 0.06), 0.60, 0.54), paint=snow)
    s.ellipsoid("body", (0, 0, 0.70), (s.vary(0.44, 0.06), 0.44, 0.41), paint=snow, blend=0.06)
    s.ellipsoid("body", (0, 0, 1.25), (0.32, 0.32, 0.31), paint=snow, blend=0.06)
    s.limb(
        "nose",
        (0.28, 0, 1.24),
        (0.62, 0, 1.21),
        0.07,
        0.015,
        paint=s.paint("nose", (0.85, 0.38, 0.05), pattern=k.STRIPES, scale=9.0),
    )
    for side in (-1, 1):
        s.ball("eyes", (0.275, side * 0.12, 1.36), 0.045)
        s.limb("arms", (0.05, side * 0.36, 0.80), (0.12, side * 0.82, 1.06), 0.034, 0.026)
        s.limb("arms", (0.10, side * 0.68, 0.98), (0.20, side * 0.80, 1.18), 0.024, 0.018)
    for i in range(5):
        a = math.radians(-48 + 24 * i)
        s.ball("eyes", (0.28 * math.cos(a * 0.8), 0.15 * math.sin(a), 1.145 + 0.045 * (1 - math.cos(a)) * 2), 0.024)
    for x, z in ((0.43, 0.82), (0.435, 0.64), (0.565, 0.18)):
        s.ball("buttons", (x, 0, z), 0.048)
    s.disc("hat", (0, 0, 1.50), 0.38, 0.03, 0.025)
    s.frustum("hat", (0, 0, 1.72), 0.24, 0.27, 0.22, 0.03)
    s.disc("hat", (0, 0, 1.57), 0.25, 0.05, 0.01, paint=Paint((0.80, 0.12, 0.14)))
    s.torus("scarf", (0, 0, 1.01), 0.28, 0.085, paint=s.paint("scarf", (0.97, 0.90, 0.80), pattern=k.PLAIN))
    s.limb("scarf", (0.27, 0.14, 0.97), (0.42, 0.22, 0.62), 0.075, 0.085)


def mug(s: Sketch) -> None:
    glaze = s.paint("mug", gloss=0.5)
    s.frustum("mug", (0, 0, 0), s.vary(0.66, 0.06), 0.72, s.vary(0.80, 0.06), 0.08, paint=glaze)
    s.torus("mug", (0, -0.78, 0.0), 0.40, 0.115, turn=(0, 90, 0), paint=glaze, blend=0.10)
    s.frustum("mug", (0, 0, 0.16), 0.56, 0.61, 0.84, 0.08, paint=Paint((0.97, 0.95, 0.90)), cut=True, blend=0.03)
    band = s.paint("band", (0.20, 0.46, 0.72))
    s.frustum("band", (0, 0, 0.05), 0.702, 0.716, 0.20, 0.01, paint=band)
    s.disc("band", (0, 0, 0.05), 0.60, 0.40, 0.01, cut=True)
    s.disc("drink", (0, 0, 0.30), 0.60, 0.14, 0.01, paint=s.paint("drink", gloss=0.3))


def pile(s: Sketch) -> None:
    """A cone of stones at about the angle of repose, 37°."""
    base, top = 1.0, s.vary(0.74, 0.08)
    s.frustum("stone", (0, 0, 0.46 * top), 0.86 * base, 0.05, 0.46 * top, 0.04, paint=Paint((0.34, 0.32, 0.30)))
    greys = (
        (0.62, 0.60, 0.57),
        (0.50, 0.49, 0.48),
        (0.70, 0.66, 0.60),
        (0.55, 0.48, 0.42),
        (0.44, 0.44, 0.46),
        (0.74, 0.70, 0.64),
    )
    n = 150
    for i in range(n):
        rho = math.sqrt((i + 0.5) / n) * (1 + s.scatter(0.04))
        theta = GOLDEN * i + s.scatter(0.3)
        size = 0.115 * (1 + s.scatter(0.38))
        x, y = base * 0.92 * rho * math.cos(theta), base * 0.92 * rho * math.sin(theta)
        z = max(top * (1 - rho) * (1 + s.scatter(0.06)), 0.6 * size)
        grey = greys[int(abs(s.scatter(5.999)))]
        paint = Paint(grey, tuple(0.84 * c for c in grey), pattern=k.NOISE, scale=9.0, grain=0.10)
        turn = (s.scatter(180), s.scatter(90), s.scatter(180))
        flat = [size * (1 + s.scatter(0.3)) for _ in range(3)]
        if i % 3:
            s.box("stone", (x, y, z), flat, 0.62 * min(flat), paint=paint, turn=turn)
        else:
            s.ellipsoid("stone", (x, y, z), flat, paint=paint, turn=turn)


def mound(s: Sketch) -> None:
    """A heap of something fine, poured from above: a cone at about 35° with a soft tip and foot."""
    grain = s.paint("heap", tuple(0.86 * c for c in s.parts["heap"].colour), pattern=k.NOISE, scale=5.0, grain=0.16)
    top = s.vary(0.62, 0.1)
    s.frustum("heap", (0, 0, 0.5 * top), 0.98, 0.12, 0.5 * top, 0.10, paint=grain)
    for i in range(9):
        theta = GOLDEN * i
        at = (0.78 * math.cos(theta), 0.78 * math.sin(theta), 0.08)
        s.ellipsoid("heap", at, (0.24, 0.24, 0.12 + s.scatter(0.03)), paint=grain, blend=0.16)


def castle(s: Sketch) -> None:
    """Four towers, walls with merlons, a keep, a gate and flags."""
    sand = s.paint("walls", tuple(0.88 * c for c in s.parts["walls"].colour), pattern=k.NOISE, scale=6.0, grain=0.14)
    s.box("walls", (0, 0, 0.25), (0.62, 0.62, 0.27), 0.03, paint=sand)
    for side in (-1, 1):
        for i in range(4):
            u = 0.24 * (i - 1.5)
            s.box("walls", (side * 0.56, u, 0.57), (0.06, 0.06, 0.08), 0.02, paint=sand)
            s.box("walls", (u, side * 0.56, 0.57), (0.06, 0.06, 0.08), 0.02, paint=sand)
    s.frustum("keep", (0, 0, 0.72), 0.34, 0.30, s.vary(0.34, 0.1), 0.02, paint=sand)
    s.frustum("roofs", (0, 0, 1.27), 0.37, 0.03, 0.24, 0.02)
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        h = s.vary(0.46, 0.06)
        s.frustum("keep", (0.62 * x, 0.62 * y, h), 0.25, 0.21, h, 0.02, paint=sand)
        s.frustum("roofs", (0.62 * x, 0.62 * y, 2 * h + 0.17), 0.27, 0.02, 0.19, 0.02)
        s.box("windows", (0.62 * x + 0.20 * x, 0.62 * y, 1.3 * h), (0.04, 0.04, 0.085), 0.03)
    s.box("windows", (0.61, 0, 0.12), (0.03, 0.14, 0.16), 0.02)
    s.limb("windows", (0.595, 0, 0.28), (0.645, 0, 0.28), 0.13, 0.13)
    s.limb("flag", (0, 0, 1.45), (0, 0, 1.78), 0.018, 0.018, paint=Paint((0.45, 0.30, 0.18)))
    s.box("flag", (0, 0.15, 1.70), (0.02, 0.14, 0.085), 0.015)


def sofa(s: Sketch) -> None:
    fabric = s.paint("frame", grain=0.06)
    seat = s.paint("cushions", grain=0.06)
    s.box("frame", (0, 0, 0.20), (0.42, 0.98, 0.14), 0.07, paint=fabric)
    s.box("frame", (-0.36, 0, 0.52), (0.13, 0.95, 0.42), 0.10, paint=fabric, turn=(0, -8, 0))
    for side in (-1, 1):
        s.box("frame", (0.02, side * 0.90, 0.36), (0.42, 0.12, 0.28), 0.10, paint=fabric)
        s.limb("frame", (-0.36, side * 0.90, 0.62), (0.38, side * 0.90, 0.62), 0.145, 0.145, paint=fabric, blend=0.06)
        s.box("cushions", (0.08, side * 0.39, 0.41), (0.36, 0.375, 0.11), 0.09, paint=seat)
        s.box("cushions", (-0.20, side * 0.39, 0.72), (0.10, 0.36, 0.25), 0.09, paint=seat, turn=(0, -10, 0))
        s.box(
            "pillow",
            (-0.02, side * 0.58, 0.68),
            (0.075, 0.20, 0.20),
            0.07,
            turn=(side * 20, -14, side * -12 + s.jitter(10)),
        )
        for x in (-0.32, 0.32):
            s.frustum("legs", (x, side * 0.82, 0.0), 0.035, 0.055, 0.09, 0.01)


SAND: RGB = (0.88, 0.72, 0.46)
RECIPES = (
    Recipe(
        "snowman",
        ("snow man", "frosty"),
        "{} snowman",
        (
            Part("body", "snow", (0.97, 0.98, 1.00), ("head", "ball")),
            Part("hat", "plastic", (0.13, 0.13, 0.17), ("top hat",), feature=True),
            Part("scarf", "plush", (0.84, 0.16, 0.18), feature=True),
            Part("nose", "apple", (0.98, 0.50, 0.10), ("carrot", "carrot nose"), feature=True),
            Part("eyes", "stone", DARK, ("eye", "mouth", "face", "coal"), feature=True),
            Part("buttons", "stone", DARK, ("button",), feature=True),
            Part("arms", "wood", (0.40, 0.26, 0.14), ("arm", "stick", "hand"), feature=True),
        ),
        snowman,
    ),
    Recipe(
        "mug",
        ("cup", "coffee mug", "tea cup", "teacup", "coffee cup"),
        "{} mug",
        (
            Part("mug", "stone", (0.94, 0.93, 0.90), ("wall", "handle")),
            Part("band", "stone", (0.22, 0.50, 0.78), ("stripe",), feature=True),
            Part("drink", "water", (0.33, 0.19, 0.10), ("coffee", "tea", "liquid", "cocoa"), feature=True),
        ),
        mug,
        of="drink",
    ),
    Recipe(
        "gravel pile",
        ("pile", "heap", "gravel heap", "pile of gravel", "heap of gravel"),
        "pile of {} stones",
        (Part("stone", "gravel", (0.60, 0.58, 0.55), ("rock", "pebble", "boulder")),),
        pile,
        of="stone",
    ),
    Recipe(
        "mound",
        ("dune", "hill", "hillock", "sand dune"),
        "mound of {}",
        (Part("heap", "sand", SAND, ("grain",)),),
        mound,
    ),
    Recipe(
        "castle",
        ("sandcastle", "sand castle", "fortress", "fort"),
        "{} castle",
        (
            Part("walls", "sand", SAND, ("wall",)),
            Part("keep", "sand", SAND, ("tower", "turret")),
            Part("roofs", "sand", (0.78, 0.50, 0.28), ("roof",)),
            Part("windows", "sand", (0.35, 0.24, 0.14), ("window", "gate", "door"), feature=True),
            Part("flag", "plastic", (0.86, 0.16, 0.16), feature=True),
        ),
        castle,
    ),
    Recipe(
        "sofa",
        ("couch", "settee"),
        "{} sofa",
        (
            Part("frame", "foam", (0.20, 0.46, 0.52), ("arm", "back", "base")),
            Part("cushions", "foam", (0.26, 0.56, 0.60), ("cushion", "seat")),
            Part("pillow", "foam", (0.97, 0.72, 0.24)),
            Part("legs", "wood", (0.45, 0.28, 0.15), ("leg", "foot", "feet"), feature=True),
        ),
        sofa,
    ),
)
