"""Stand-ins for the trained scenes of PhysGaussian: objects drawn, covered with Gaussians, written as the original code
leaves them."""

import dataclasses
import math
import random
from pathlib import Path

import torch

from diffuphy.render.scenes import ply
from diffuphy.render.scenes.placement import Placement
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.params import nearest_distance
from diffuphy.text2gs.shapes import shading as k
from diffuphy.text2gs.shapes.primitives import Paint, Part, Recipe, Sketch
from diffuphy.text2gs.shapes.shape import Shape
from diffuphy.text2gs.surface import FLATNESS, SPREAD, from_z
from diffuphy.types import Gaussians


def ficus(s: Sketch) -> None:
    """A pot below z = −0.22, a trunk, and a crown of leaves on twigs."""
    s.frustum("pot", (0, 0, -0.36), 0.13, 0.18, 0.14)
    s.disc("soil", (0, 0, -0.225), 0.165, 0.015)
    s.limb("trunk", (0, 0, -0.25), (0.02, 0.0, 0.12), 0.034, 0.026)
    draw = random.Random(3)
    for i in range(44):
        a, h = 2.399963 * i, (i + 0.5) / 44
        r = 0.24 * math.sqrt(max(0.0, 1 - (2 * h - 1) ** 2)) + 0.02
        tip = (0.02 + r * math.cos(a), r * math.sin(a), 0.04 + 0.43 * h)
        s.limb("trunk", (0.015, 0, -0.02 + 0.2 * h), tip, 0.012, 0.007)
        tilt = (draw.uniform(-30, 30), draw.uniform(-30, 30), math.degrees(a))
        green = Paint((0.20 + draw.uniform(0, 0.12), 0.46 + draw.uniform(-0.1, 0.1), 0.14), gloss=0.2)
        s.ellipsoid("leaves", tip, (0.085, 0.045, 0.014), turn=tilt, paint=green)


def wolf(s: Sketch) -> None:
    """It sits and howls."""
    fur = s.paint("fur", (0.72, 0.56, 0.34), pattern=k.NOISE, scale=6.0, grain=0.06)
    s.limb("fur", (-0.16, 0, -0.30), (0.10, 0, 0.10), 0.19, 0.15, paint=fur)
    s.limb("fur", (0.10, 0, 0.10), (0.17, 0, 0.30), 0.13, 0.10, paint=fur, blend=0.08)
    s.limb("fur", (0.17, 0, 0.30), (0.33, 0, 0.46), 0.10, 0.040, paint=fur, blend=0.05)
    for y in (-0.09, 0.09):
        s.limb("fur", (0.14, y, 0.02), (0.20, 1.1 * y, -0.46), 0.065, 0.045, paint=fur, blend=0.05)
        s.limb("fur", (0.20, 1.1 * y, -0.465), (0.28, 1.1 * y, -0.47), 0.045, 0.035, paint=fur, blend=0.03)
        s.ellipsoid("fur", (-0.10, 1.7 * y, -0.36), (0.19, 0.08, 0.13), paint=fur, blend=0.05)
        s.limb("fur", (0.09, 0.8 * y, 0.34), (0.02, 0.9 * y, 0.46), 0.045, 0.015, paint=fur, blend=0.03)
    s.limb("fur", (-0.28, 0, -0.42), (-0.56, 0.06, -0.44), 0.07, 0.03, paint=fur, blend=0.05)


def pillow(s: Sketch) -> None:
    """A bed below z = −0.12 and two cushions in the air."""
    s.box("bed", (0, 0, -0.30), (0.42, 0.34, 0.05), 0.03)
    s.box("bed", (0, 0, -0.20), (0.40, 0.32, 0.07), 0.05, paint=Paint((0.44, 0.52, 0.66)))
    for x, y in ((-0.38, -0.30), (-0.38, 0.30), (0.38, -0.30), (0.38, 0.30)):
        s.limb("bed", (x, y, -0.30), (x, y, -0.48), 0.035, 0.025)
    stripes = Paint((0.93, 0.90, 0.82), (0.80, 0.32, 0.24), pattern=k.SEGMENTS, scale=8.0)
    for part, at, turn in (("cushion", (0.04, 0.0, 0.19), (0, 0, 10)), ("pillow", (-0.05, 0.03, 0.44), (0, 0, -25))):
        how = {"paint": stripes} if part == "cushion" else {}
        s.box(part, at, (0.23, 0.17, 0.045), 0.045, turn=turn, **how)
        s.ellipsoid(part, at, (0.21, 0.155, 0.075), turn=turn, blend=0.06, **how)


def jam(s: Sketch) -> None:
    """What came out of a jar: a ribbed block."""
    red = s.paint("jam", (0.74, 0.10, 0.16), pattern=k.NOISE, scale=5.0, gloss=0.6, glow=0.4)
    s.frustum("jam", (0, 0, 0), 0.19, 0.17, 0.25, 0.04, paint=red, bend=(0, 0.04, 12, 0))


def can(s: Sketch) -> None:
    """A tin with a label."""
    tin = s.paint("tin", gloss=0.7)
    s.disc("tin", (0, 0, 0), 0.15, 0.23, 0.02, paint=tin)
    s.torus("tin", (0, 0, 0.235), 0.135, 0.015, paint=tin)
    s.torus("tin", (0, 0, -0.235), 0.135, 0.015, paint=tin)
    s.disc("label", (0, 0, 0), 0.154, 0.17, 0.004, paint=Paint((0.80, 0.14, 0.12), (0.95, 0.90, 0.82), pattern=k.DOTS,
                                                               scale=9.0))  # fmt: skip


def _recipe(draw, *parts: Part) -> Recipe:
    return Recipe(draw.__name__, (), draw.__name__, parts, draw)


RECIPES = {
    r.name: r
    for r in (
        _recipe(ficus, Part("pot", "stone", (0.78, 0.42, 0.28)), Part("soil", "sand", (0.28, 0.19, 0.13)),
                Part("trunk", "wood", (0.45, 0.32, 0.20)), Part("leaves", "lettuce", (0.25, 0.5, 0.15))),
        _recipe(wolf, Part("fur", "sand", (0.82, 0.66, 0.42))),
        _recipe(pillow, Part("bed", "wood", (0.36, 0.24, 0.17)), Part("cushion", "sponge", (0.93, 0.90, 0.82)),
                Part("pillow", "sponge", (0.86, 0.62, 0.30))),
        _recipe(jam, Part("jam", "honey", (0.56, 0.05, 0.10))),
        _recipe(can, Part("tin", "metal", (0.72, 0.73, 0.76)), Part("label", "metal", (0.80, 0.14, 0.12))),
    )
}  # fmt: skip
"""The objects by the name of their scene file."""


def gaussians(name: str, count: int, seed: int = 0) -> Gaussians:
    """Flat Gaussians evenly over the surface of an object, longest side 2, z up."""
    shape = Shape(RECIPES[name])
    points, rgb = shape.surface(count, torch.Generator().manual_seed(seed))
    normals, _ = shape.look(points)
    # of points spread evenly, n for each area, the third neighbour's distance has E[d²] = 3/(π n)
    spread = SPREAD * math.sqrt(float(nearest_distance(points, k=3).square().mean()) * math.pi / 3)
    sizes = torch.tensor([spread, spread, spread / FLATNESS]).log()
    return Gaussians(
        means=points,
        quats=from_z(normals.double()).float(),
        log_scales=sizes.expand(count, 3).clone(),
        logit_opacities=torch.full((count,), 0.95).logit(),
        sh=from_rgb(rgb),
    )


LENGTH = 1.6
"""Longest side in the files: trained scenes are in lengths of their own. That of the bed fits into its ``sim_area``."""


def write(folder: Path, name: str, count: int, up: ply.Up = "z_up") -> Path:
    """An object as a trained scene in the layout of the original code; returns its folder."""
    inside = folder / "point_cloud/iteration_30000"
    inside.mkdir(parents=True, exist_ok=True)
    scene = Placement.turns(())
    scene = dataclasses.replace(scene, scale=LENGTH / 2)(gaussians(name, count))
    ply.write(inside / "point_cloud.ply", scene, up=up)
    return folder
