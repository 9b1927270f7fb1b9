"""The vocabulary in which objects are drawn: parts, paints, and a sketch that collects primitives."""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from diffuphy.text2gs.shapes import distance as k
from diffuphy.text2gs.shapes.shading import PLAIN

RGB = tuple[float, float, float]
Vec = Sequence[float]
WHITE: RGB = (0.97, 0.96, 0.93)


@dataclass(frozen=True)
class Part:
    """A named piece of an object."""

    name: str
    """What a prompt calls it ("patty")."""
    material: str
    """Material word of the piece when the prompt gives none."""
    colour: RGB
    """Main colour, in [0, 1]."""
    words: tuple[str, ...] = ()
    """Other words for it, singular."""
    feature: bool = False
    """True for small details (eyes, buttons) that must stay readable under a surface tint."""


@dataclass(frozen=True)
class Paint:
    """Up to three colours and how they alternate over a primitive, in the primitive's own frame."""

    colour: RGB
    second: RGB = WHITE
    third: RGB = WHITE
    pattern: int = PLAIN
    """PLAIN: colour. SEGMENTS: `scale` gores about z (colour, third, second, third). NOISE: colour and second mixed by
    noise. WAFFLE: crossing lines. FACES: a colour by axis, third beyond `scale` of the way to an edge. STRIPES: `scale`
    a unit along z. HEIGHT: second below, colour above, over ±`scale`. RIM: colour inside, second near the radius. DOTS:
    second dots, `scale` a unit."""
    scale: float = 1.0
    """Frequency or width of the pattern."""
    grain: float = 0.0
    """Relative brightness of a fine noise."""
    gloss: float = 0.0
    """Strength of the painted-on highlight, in [0, 1]."""
    glow: float = 0.0
    """How far light passes through, in [0, 1]: removes shadow and occlusion."""


@dataclass(frozen=True)
class Primitive:
    """One row of the table; see `distance.KIND`."""

    kind: int
    part: str
    at: tuple[float, float, float]
    turn: tuple[float, float, float, float]
    a: tuple[float, float, float, float]
    paint: Paint
    group: int
    cut: bool = False
    blend: float = 0.0
    bend: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Ruffle (height of z waves at the rim), ribs (relative scallop of the radius), count of both, droop (fall of z at
    the rim)."""
    reach: float = 0.0
    """1.25 times the largest blend radius k of its group: a smooth union moves the surface only where both distances
    are below 1.25 k."""

    @property
    def _extent(self) -> tuple[float, float]:
        """Radius about the local z axis and half height of the straight primitive."""
        a = self.a
        return {
            k.ELLIPSOID: (max(a[0], a[1]), a[2]),
            k.DOME: (max(a[0], a[1]), a[2]),
            k.FRUSTUM: (max(a[0], a[1]), a[2]),
            k.BOX: (math.hypot(a[0], a[1]), a[2]),
            k.TORUS: (a[0] + a[1], a[1]),
            k.CONE: (max(a[1], a[2]), a[0] + max(a[1], a[2])),
            k.STAR: (a[0], a[2]),
        }[self.kind]

    @property
    def _swelling(self) -> float:
        """How far the bend moves a point of the primitive at most; z moves by (1.2)² of ruffle and droop at the
        farthest."""
        ruffle, ribs, _, droop = self.bend
        return math.hypot(ribs * self._extent[0], 1.44 * (ruffle + abs(droop)))

    @property
    def bound(self) -> float:
        """Radius of a ball about `at` outside which the primitive, bent but not blended, does not reach."""
        wide, high = self._extent
        round_ = self.kind in (k.ELLIPSOID, k.DOME)
        return (max(wide, high) if round_ else math.hypot(wide, high)) + self._swelling

    @property
    def slab(self) -> tuple[float, float, float, float]:
        """Local z axis in the object's frame, and half the thickness of the slab about `at` that holds the
        primitive."""
        x, y, z, w = self.turn
        axis = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        return (*axis, self._extent[1] + self._swelling)

    @property
    def limits(self) -> tuple[float, float, float]:
        """1 / L with L the Lipschitz constant of the map that undoes the bend, the swelling, and where the swollen one
        takes over.

        Ribs scale the radius by g = 1 / (1 + e (2 |cos ½nθ| - 1)): the plane Jacobian is triangular with diagonal
        α = 1/(1 - e) and slope τ ≤ e n α², so L ≤ (τ + √(τ² + 4α²)) / 2. Ruffle and droop shift z by f(x, y):
        L = (|∇f| + √(|∇f|² + 4)) / 2.
        """
        ruffle, ribs, count, droop = self.bend
        alpha = 1 / (1 - ribs)
        tau = ribs * count * alpha**2
        radial = (tau + math.sqrt(tau**2 + 4 * alpha**2)) / 2
        slope = math.hypot(2.4 * (ruffle + abs(droop)), 1.2 * ruffle * count) / self.a[0]
        slow = 1 / (radial * (slope + math.sqrt(slope**2 + 4)) / 2)
        slow = min(slow, 0.8) if slow < 1 else 1.0
        return (slow, self._swelling, 2.5 * self._swelling * slow / (1 - slow) if slow < 1 else 0.0)


def _turned(u: Vec, v: Vec) -> tuple[float, float, float, float]:
    """Quaternion xyzw of the shortest rotation from the direction u to v."""
    nu, nv = math.hypot(*u), math.hypot(*v)
    dot = sum(x * y for x, y in zip(u, v, strict=True)) / (nu * nv)
    if dot < -1 + 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    q = [c / (nu * nv) for c in cross] + [1 + dot]
    norm = math.hypot(*q)
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


def euler(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> tuple[float, float, float, float]:
    """Quaternion xyzw of a rotation about x, then y, then z [degrees]."""
    cx, sx = math.cos(math.radians(x) / 2), math.sin(math.radians(x) / 2)
    cy, sy = math.cos(math.radians(y) / 2), math.sin(math.radians(y) / 2)
    cz, sz = math.cos(math.radians(z) / 2), math.sin(math.radians(z) / 2)
    return (
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
        cx * cy * cz + sx * sy * sz,
    )


class Sketch:
    """Collects the primitives of one object; every method adds one and returns nothing.

    Common keywords: `paint` (the part's plain colour when left out), `turn` (degrees about x, then y, then z), `blend`
    (radius of the smooth union with what was drawn before; 0 starts a new solid), `cut` (remove from the current solid
    instead of adding).

    Args:
        parts: the parts that may be drawn.
        without: names of parts that are left out.
        variant: 0 draws the object as designed, another number a jittered sibling, always the same one.
        name: of the object; with the variant it seeds the jitter.
    """

    def __init__(self, parts: Sequence[Part], without: frozenset[str] = frozenset(), variant: int = 0, name: str = ""):
        self.parts = {p.name: p for p in parts}
        self.without = without
        self.primitives: list[Primitive] = []
        self._random = random.Random(f"{name}/{variant}")
        self._amplitude = 0.0 if variant == 0 else 1.0
        self._group = -1
        self._open = False
        self._hue = {p.name: [self.jitter(0.07) for _ in range(3)] for p in parts}

    def has(self, part: str) -> bool:
        return part not in self.without

    def jitter(self, amount: float) -> float:
        """A number in ±amount; 0 for variant 0."""
        return self._amplitude * amount * self._random.uniform(-1, 1)

    def vary(self, value: float, amount: float = 0.1) -> float:
        """`value` times 1 ± amount."""
        return value * (1 + self.jitter(amount))

    def scatter(self, amount: float = 1.0) -> float:
        """A number in ±amount, for every variant (stones, seeds)."""
        return amount * self._random.uniform(-1, 1)

    def paint(self, part: str, second: RGB | None = None, **settings) -> Paint:
        """The part's colour, with settings of `Paint`."""
        colour = self.parts[part].colour
        return Paint(colour, **({} if second is None else {"second": second}), **settings)

    def add(self, kind, part, at, a, *, paint=None, turn=None, blend=0.0, cut=False, bend=(0.0, 0.0, 0.0, 0.0)) -> None:
        starts = not cut and (blend == 0.0 or not self._open)
        if not self.has(part):
            self._open = self._open and not starts
            return
        if cut and not self._open:
            return
        if starts:
            self._group += 1
            self._open = True
        paint = paint or self.paint(part)
        r, g, b = (min(1.0, max(0.0, c + d)) for c, d in zip(paint.colour, self._hue[part], strict=True))
        turn = (0.0, 0.0, 0.0, 1.0) if turn is None else turn if len(turn) == 4 else euler(*turn)
        a = (*a, *(0.0,) * (4 - len(a)))
        self.primitives.append(
            Primitive(kind, part, tuple(at), turn, a, replace(paint, colour=(r, g, b)), self._group, cut, blend, bend)
        )

    def finished(self) -> list[Primitive]:
        """The primitives, each told how far the blends of its group reach."""
        blends: dict[int, float] = {}
        for p in self.primitives:
            blends[p.group] = max(blends.get(p.group, 0.0), p.blend)
        return [replace(p, reach=1.25 * blends[p.group]) for p in self.primitives]

    def ellipsoid(self, part: str, at: Vec, radii: Vec, **how) -> None:
        self.add(k.ELLIPSOID, part, at, radii, **how)

    def ball(self, part: str, at: Vec, radius: float, **how) -> None:
        self.add(k.ELLIPSOID, part, at, (radius,) * 3, **how)

    def dome(self, part: str, at: Vec, radii: Vec, edge: float = 0.05, **how) -> None:
        """Upper half of an ellipsoid, its rim rounded by `edge`."""
        self.add(k.DOME, part, at, (*radii, edge), **how)

    def disc(self, part: str, at: Vec, radius: float, half: float, edge: float = 0.03, **how) -> None:
        """Cylinder of height 2 half about `at`."""
        self.add(k.FRUSTUM, part, at, (radius, radius, half, edge), **how)

    def frustum(self, part: str, at: Vec, low: float, high: float, half: float, edge: float = 0.02, **how) -> None:
        """Cone frustum with radius `low` at the bottom and `high` at the top."""
        self.add(k.FRUSTUM, part, at, (low, high, half, edge), **how)

    def box(self, part: str, at: Vec, half: Vec, edge: float = 0.03, **how) -> None:
        self.add(k.BOX, part, at, (*half, edge), **how)

    def torus(self, part: str, at: Vec, ring: float, tube: float, **how) -> None:
        self.add(k.TORUS, part, at, (ring, tube), **how)

    def limb(self, part: str, start: Vec, end: Vec, r1: float, r2: float, **how) -> None:
        """Hull of two balls: a capsule, carrot, leg."""
        axis = [e - s for s, e in zip(start, end, strict=True)]
        length = math.hypot(*axis)
        if length <= abs(r1 - r2):
            raise ValueError(
                f"a limb of length {length:.3g} lies inside its thicker end; move the ends {abs(r1 - r2):.3g} apart"
            )
        self.add(k.CONE, part, start, (length, r1, r2), turn=_turned((0, 0, 1), axis), **how)

    def star(self, part: str, at: Vec, radius: float, inner: float, half: float, edge: float, **how) -> None:
        """Five-pointed prism in the local xy plane, a tip along local y."""
        self.add(k.STAR, part, at, (radius, inner, half, edge), **how)


@dataclass(frozen=True)
class Recipe:
    """How an object is called, what it is made of, and how it is drawn."""

    name: str
    """Canonical subject word."""
    words: tuple[str, ...]
    """Other singular words and phrases for it."""
    title: str
    """Noun phrase for an encoder; "{}" takes the material ("stack of {} pancakes")."""
    parts: tuple[Part, ...]
    """The pieces; the first is the main one and its material that of the whole object."""
    draw: object = field(compare=False)
    """Function of a `Sketch` that draws the object with z up, about two units long, at any place."""
    of: str = ""
    """Part that the words after "of" speak about ("mug of honey"); empty: the whole object."""
