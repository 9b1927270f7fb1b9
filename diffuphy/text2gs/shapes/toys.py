"""Things to play with. Faces look along +x."""

import math

from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.primitives import RGB, Paint, Part, Recipe, Sketch

DARK: RGB = (0.07, 0.06, 0.07)


def eyes(s: Sketch, x: float, y: float, z: float, r: float, part: str = "eyes") -> None:
    """A pair of shining eyes at (x, ±y, z)."""
    for side in (-1, 1):
        s.ball(part, (x, side * y, z), r)
        s.ball(
            part, (x + 0.62 * r, side * y - 0.35 * r, z + 0.52 * r), 0.36 * r, paint=Paint((1.0, 1.0, 1.0), glow=1.0)
        )


def ball(s: Sketch) -> None:
    colours = s.paint("ball", (0.15, 0.42, 0.85), third=(0.99, 0.97, 0.92), pattern=k.SEGMENTS, scale=8.0, gloss=0.5)
    s.ball("ball", (0, 0, 0), 1.0, paint=colours, turn=(25 + s.jitter(20), -20, 0))


def cube(s: Sketch) -> None:
    faces = s.paint("cube", (0.20, 0.52, 0.86), third=(0.99, 0.93, 0.80), pattern=k.FACES, scale=0.74)
    s.box("cube", (0, 0, 0), (1, 1, 1), s.vary(0.24, 0.15), paint=faces)


def duck(s: Sketch) -> None:
    """A bath duck."""
    plain = s.paint("body", gloss=0.35)
    s.ellipsoid("body", (0, 0, -0.22), (0.74, s.vary(0.56, 0.05), 0.42), paint=plain)
    s.limb("body", (-0.48, 0, -0.08), (-0.84, 0, 0.26), 0.26, 0.07, paint=plain, blend=0.22)
    s.ellipsoid("body", (0.26, 0, 0.02), (0.34, 0.34, 0.34), paint=plain, blend=0.25)
    s.ball("body", (0.34, 0, s.vary(0.50, 0.04)), s.vary(0.38, 0.04), paint=plain, blend=0.12)
    s.limb("body", (0.22, 0, 0.84), (0.10, 0, 0.95), 0.07, 0.02, paint=plain, blend=0.08)
    for side in (-1, 1):
        tilt = (12 * side, 14, 6 * side)
        s.ellipsoid(
            "wings", (-0.10, side * 0.52, -0.10), (0.36, 0.11, 0.22), turn=tilt, paint=s.paint("wings", gloss=0.35)
        )
        s.limb(
            "wings",
            (-0.30, side * 0.55, -0.08),
            (-0.54, side * 0.56, 0.05),
            0.13,
            0.04,
            blend=0.10,
            paint=s.paint("wings", gloss=0.35),
        )
    s.ellipsoid("beak", (0.76, 0, 0.44), (0.20, 0.20, 0.055), turn=(0, -12, 0), paint=s.paint("beak", gloss=0.4))
    s.ellipsoid("beak", (0.72, 0, 0.385), (0.16, 0.15, 0.05), turn=(0, 8, 0), paint=s.paint("beak", gloss=0.4))
    eyes(s, 0.625, 0.20, 0.60, 0.068)


def teddy(s: Sketch) -> None:
    """A sitting teddy bear with a bow tie."""
    fur = s.paint("body", tuple(0.80 * c for c in s.parts["body"].colour), pattern=k.NOISE, scale=9.0, grain=0.10)
    belly = Paint((0.94, 0.80, 0.58), (0.88, 0.72, 0.48), pattern=k.NOISE, scale=9.0, grain=0.08)
    s.ellipsoid("body", (0, 0, 0), (0.46, s.vary(0.50, 0.05), 0.54), paint=fur)
    s.ellipsoid("body", (0.25, 0, -0.04), (0.26, 0.33, 0.38), paint=belly)
    s.ellipsoid("head", (0.02, 0, 0.80), (0.44, s.vary(0.48, 0.04), 0.43), paint=fur)
    for side in (-1, 1):
        s.ellipsoid("ears", (-0.02, side * 0.38, 1.15), (0.12, 0.19, 0.19), paint=fur)
        s.ellipsoid("ears", (0.06, side * 0.38, 1.15), (0.08, 0.12, 0.12), paint=belly)
        s.limb("arms", (0.02, side * 0.42, 0.26), (0.34, side * 0.62, -0.12), 0.17, 0.20, paint=fur)
        s.limb("legs", (0.10, side * 0.30, -0.40), (0.62, side * 0.42, -0.42), 0.22, 0.23, paint=fur)
        s.ellipsoid("legs", (0.79, side * 0.43, -0.41), (0.08, 0.16, 0.18), paint=belly, turn=(0, 0, side * 8))
    s.ellipsoid("head", (0.38, 0, 0.70), (0.20, 0.23, 0.17), paint=belly)
    s.ellipsoid("nose", (0.56, 0, 0.77), (0.06, 0.085, 0.06), paint=s.paint("nose", gloss=0.6))
    s.limb("nose", (0.585, 0, 0.72), (0.575, 0, 0.64), 0.016, 0.014)
    eyes(s, 0.405, 0.18, 0.90, 0.062)
    for side in (-1, 1):
        s.limb("bow", (0.41, side * 0.06, 0.37), (0.42, side * 0.24, 0.38), 0.05, 0.125)
    s.ball("bow", (0.45, 0, 0.37), 0.085, paint=Paint((0.68, 0.08, 0.10)))
    s.ball("tail", (-0.48, 0, -0.30), 0.13, paint=fur)


def bunny(s: Sketch) -> None:
    fur = s.paint("body", tuple(0.92 * c for c in s.parts["body"].colour), pattern=k.NOISE, scale=8.0, grain=0.05)
    s.ellipsoid("body", (0, 0, 0), (0.56, s.vary(0.50, 0.05), 0.50), paint=fur)
    s.ellipsoid("body", (0.22, 0, 0.22), (0.36, 0.38, 0.36), paint=fur, blend=0.2)
    s.ellipsoid("head", (0.36, 0, 0.66), (0.38, 0.40, 0.36), paint=fur)
    for side in (-1, 1):
        s.ellipsoid("head", (0.58, side * 0.17, 0.56), (0.17, 0.19, 0.15), paint=fur, blend=0.12)
        lean = side * (0.24 + s.jitter(0.06))
        s.limb("ears", (0.22, side * 0.16, 0.92), (0.06, lean, s.vary(1.62, 0.05)), 0.10, 0.13, paint=fur)
        s.limb("ears", (0.31, side * 0.165, 0.98), (0.15, lean, 1.58), 0.06, 0.085, paint=Paint((0.98, 0.70, 0.72)))
        s.ellipsoid("feet", (0.44, side * 0.32, -0.40), (0.32, 0.17, 0.14), paint=fur)
        s.ellipsoid("feet", (-0.10, side * 0.42, -0.22), (0.34, 0.20, 0.30), paint=fur)
        s.limb("feet", (0.44, side * 0.20, 0.12), (0.58, side * 0.16, -0.30), 0.12, 0.13, paint=fur)
    s.ellipsoid("nose", (0.755, 0, 0.63), (0.05, 0.07, 0.045))
    eyes(s, 0.655, 0.20, 0.76, 0.062)
    s.ball("tail", (-0.60, 0, -0.14), 0.19, paint=Paint((1.0, 1.0, 1.0), grain=0.06))


def tower(s: Sketch) -> None:
    """Four coloured blocks, a little out of line, and a roof."""
    colours = ((0.88, 0.22, 0.18), (0.98, 0.78, 0.16), (0.20, 0.55, 0.88), (0.34, 0.70, 0.30))
    z, shift = 0.0, int(abs(s.jitter(3.99)))
    for i in range(4):
        h = 0.30 - 0.012 * i
        at = (s.scatter(0.06), s.scatter(0.06), z + h)
        c = colours[(i + shift) % 4]
        paint = Paint(c, tuple(0.86 * x for x in c), third=(0.99, 0.93, 0.80), pattern=k.FACES, scale=0.74)
        s.box("block", at, (h, h, h), 0.045, paint=paint, turn=(0, 0, s.scatter(18)))
        z += 2 * h
    s.frustum("block", (0.02, 0, z + 0.17), 0.34, 0.04, 0.18, 0.03, paint=Paint((0.93, 0.50, 0.16)))


def rocket(s: Sketch) -> None:
    white = s.paint("hull", gloss=0.5)
    s.ellipsoid("hull", (0, 0, 0.72), (0.36, 0.36, s.vary(0.98, 0.04)), paint=white)
    s.box("hull", (0, 0, -0.33), (0.6, 0.6, 0.30), 0.01, paint=white, cut=True, blend=0.04)
    s.dome("nose", (0, 0, 1.30), (0.292, 0.292, 0.42), 0.02, paint=s.paint("nose", gloss=0.5))
    s.disc("hull", (0, 0, 1.27), 0.31, 0.028, 0.02, paint=Paint((0.75, 0.77, 0.80)))
    for i in range(3):
        theta = 2 * math.pi * i / 3 + 0.5
        c, sn = math.cos(theta), math.sin(theta)
        s.ellipsoid(
            "fins",
            (0.36 * c, 0.36 * sn, 0.16),
            (0.30, 0.05, 0.34),
            turn=(0, 0, math.degrees(theta)),
            paint=s.paint("fins", gloss=0.3),
        )
        s.limb(
            "fins",
            (0.52 * c, 0.52 * sn, 0.10),
            (0.62 * c, 0.62 * sn, -0.24),
            0.07,
            0.045,
            blend=0.12,
            paint=s.paint("fins", gloss=0.3),
        )
    s.torus("window", (0.355, 0, 0.90), 0.125, 0.035, turn=(0, 90, 0), paint=Paint((0.70, 0.72, 0.76), gloss=0.5))
    s.ellipsoid("window", (0.335, 0, 0.90), (0.05, 0.12, 0.12), paint=s.paint("window", gloss=0.8))
    s.frustum("nozzle", (0, 0, -0.02), 0.24, 0.17, 0.10, 0.02)
    s.limb("flame", (0, 0, -0.16), (0, 0, -0.52), 0.15, 0.02, paint=s.paint("flame", glow=1.0))


def star(s: Sketch) -> None:
    s.star(
        "star",
        (0, 0, 0),
        1.0,
        s.vary(0.52, 0.08),
        s.vary(0.26, 0.1),
        0.14,
        turn=(90, 0, 90),
        paint=s.paint("star", gloss=0.5),
    )
    eyes(s, 0.245, 0.15, 0.10, 0.07)
    for side in (-1, 1):
        s.ellipsoid("cheeks", (0.235, side * 0.30, -0.05), (0.04, 0.075, 0.05))
    for i in range(5):
        at = [
            (0.262, 0.11 * math.sin(math.radians(-60 + 30 * j)), -0.02 - 0.10 * math.cos(math.radians(-60 + 30 * j)))
            for j in (i, i + 1)
        ]
        if i < 4:
            s.limb("eyes", *at, 0.018, 0.018)


RECIPES = (
    Recipe(
        "ball",
        ("beach ball", "beachball", "sphere", "orb"),
        "{} ball",
        (Part("ball", "rubber", (0.90, 0.18, 0.15)),),
        ball,
    ),
    Recipe(
        "cube",
        ("box", "block", "brick", "dice", "toy block"),
        "{} cube",
        (Part("cube", "rubber", (0.90, 0.24, 0.20)),),
        cube,
    ),
    Recipe(
        "duck",
        ("duckling", "bath duck", "duckie", "ducky"),
        "{} toy duck",
        (
            Part("body", "rubber", (1.00, 0.82, 0.10), ("head",)),
            Part("wings", "rubber", (0.99, 0.74, 0.06), ("wing",)),
            Part("beak", "rubber", (0.98, 0.45, 0.06), ("bill",), feature=True),
            Part("eyes", "rubber", DARK, ("eye",), feature=True),
        ),
        duck,
    ),
    Recipe(
        "teddy bear",
        ("teddy", "bear", "stuffed bear", "plush bear"),
        "{} teddy bear",
        (
            Part("body", "plush", (0.72, 0.47, 0.24), ("belly", "tummy")),
            Part("head", "plush", (0.72, 0.47, 0.24)),
            Part("ears", "plush", (0.72, 0.47, 0.24), ("ear",)),
            Part("arms", "plush", (0.72, 0.47, 0.24), ("arm",)),
            Part("legs", "plush", (0.72, 0.47, 0.24), ("leg", "foot", "feet")),
            Part("tail", "plush", (0.72, 0.47, 0.24)),
            Part("nose", "plush", DARK, feature=True),
            Part("eyes", "plush", DARK, ("eye",), feature=True),
            Part("bow", "plush", (0.86, 0.14, 0.16), ("bow tie", "tie"), feature=True),
        ),
        teddy,
    ),
    Recipe(
        "bunny",
        ("rabbit", "bunny rabbit", "hare"),
        "{} bunny",
        (
            Part("body", "plush", (0.93, 0.88, 0.82)),
            Part("head", "plush", (0.93, 0.88, 0.82)),
            Part("ears", "plush", (0.93, 0.88, 0.82), ("ear",)),
            Part("feet", "plush", (0.93, 0.88, 0.82), ("foot", "leg", "paw")),
            Part("tail", "plush", (1.00, 1.00, 1.00)),
            Part("nose", "plush", (0.95, 0.45, 0.52), feature=True),
            Part("eyes", "plush", DARK, ("eye",), feature=True),
        ),
        bunny,
    ),
    Recipe(
        "tower",
        (
            "stack",
            "tower of block",
            "block tower",
            "stack of block",
            "stack of cube",
            "tower of cube",
            "building block",
        ),
        "tower of {} blocks",
        (Part("block", "wood", (0.90, 0.62, 0.20), ("brick", "cube", "roof")),),
        tower,
        of="block",
    ),
    Recipe(
        "rocket",
        ("spaceship", "space ship"),
        "{} toy rocket",
        (
            Part("hull", "metal", (0.95, 0.95, 0.96), ("body",)),
            Part("nose", "metal", (0.88, 0.16, 0.16), ("tip", "cone")),
            Part("fins", "metal", (0.88, 0.16, 0.16), ("fin", "wing")),
            Part("window", "glass", (0.40, 0.72, 0.95), feature=True),
            Part("nozzle", "metal", (0.32, 0.33, 0.36), ("engine",), feature=True),
            Part("flame", "jelly", (1.00, 0.62, 0.12), ("fire",), feature=True),
        ),
        rocket,
    ),
    Recipe(
        "star",
        (),
        "{} star",
        (
            Part("star", "jelly", (1.00, 0.80, 0.16)),
            Part("eyes", "jelly", DARK, ("eye", "mouth", "smile", "face"), feature=True),
            Part("cheeks", "jelly", (0.98, 0.52, 0.45), ("cheek",), feature=True),
        ),
        star,
    ),
)
