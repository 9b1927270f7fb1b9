"""One object of the library: where it is, what it is made of, what it looks like."""

import copy
import functools
from dataclasses import replace

import torch
import warp as wp
from torch import Tensor

from diffuphy.text2gs.shapes import tracer
from diffuphy.text2gs.shapes.distance import CUT, UNION
from diffuphy.text2gs.shapes.primitives import Part, Primitive, Recipe, Sketch
from diffuphy.text2gs.shapes.tints import parse_surface, tinted
from diffuphy.types import Camera

RADIUS = 1.2
"""Largest distance of the surface from the origin: the default cameras, 3.4 away with 40°, see a ball of 1.16 whole."""

MEASURE = 44
"""Cells along the longest side of the grid that finds the extent of a drawing and the cells its surface crosses."""

VIEWS_AT_ONCE = 16
"""Views traced by one launch; bounds the memory of the tile lists."""


class Shape:
    """A union of primitives in the object frame: bounding box centred on 0, z up, longest side 2.

    It is smaller where a corner would leave the ball of ``RADIUS``.

    Args:
        recipe: how to draw it.
        without: names of parts to leave out.
        variant: 0 is the object as designed, other numbers are jittered siblings.

    Raises:
        ValueError: when a part is unknown or nothing would be left.
    """

    def __init__(self, recipe: Recipe, without: frozenset[str] = frozenset(), variant: int = 0):
        names = [p.name for p in recipe.parts]
        if unknown := without - set(names):
            raise ValueError(f"{recipe.name} has no part {sorted(unknown)[0]!r}; its parts are: {', '.join(names)}")
        wp.init()
        sketch = Sketch(recipe.parts, without, variant, recipe.name)
        recipe.draw(sketch)
        primitives = sketch.finished()
        drawn = {p.part for p in primitives}
        if not drawn:
            raise ValueError(
                f"nothing is left of {recipe.name} without {', '.join(sorted(without))}; keep at least one part"
            )
        self.name = recipe.name
        self.parts: tuple[Part, ...] = tuple(p for p in recipe.parts if p.name in drawn)
        self.primitives: tuple[Primitive, ...] = tuple(primitives)
        index = {p.name: i for i, p in enumerate(self.parts)}
        self._part = torch.tensor([index[p.part] for p in self.primitives] + [-1])
        self._tables: dict[str, Tensor] = {}
        self._frame = (0.0, 0.0, 0.0, 1.0)
        self._frame = self._measured()

    def tinted(self, surface: str) -> "Shape":
        """The same shape in other colours.

        Args:
            surface: `Look.surface`: material or colour words, of the whole or of parts ("sand, hat=gold").

        Raises:
            ValueError: when a part is unknown or a word changes no colours.
        """
        tints = parse_surface(surface)
        named = {p.name: p for p in self.parts}
        if unknown := set(tints) - set(named) - {""}:
            raise ValueError(f"{self.name} has no part {sorted(unknown)[0]!r}; its parts are: {', '.join(named)}")
        rows = []
        for row in self.primitives:
            part = named[row.part]
            if part.name in tints:
                row = replace(row, paint=tinted(row.paint, tints[part.name], part.colour, feature=False))
            elif "" in tints:
                row = replace(row, paint=tinted(row.paint, tints[""], self.parts[0].colour, part.feature))
            rows.append(row)
        other = copy.copy(self)
        other.primitives, other._tables = tuple(rows), {}
        return other

    # ------------------------------------------------------------------ questions
    @property
    def crowd(self) -> float:
        """Bounding balls of primitives that a ray through the ball of ``RADIUS`` meets on average, Σ r²/``RADIUS``²."""
        return sum(((p.bound + p.reach) * self._frame[3] / RADIUS) ** 2 for p in self.primitives)

    def sdf(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distance (n,), a lower bound of the Euclidean one, negative inside; and the index of the nearest part
        (n,).

        Args:
            points: (n, 3), object frame.
        """
        d, owner = self._query(points)
        return d, self._part.to(points.device)[owner.long()]

    def part_of(self, points: Tensor) -> Tensor:
        """Index into `parts` of the part nearest to each point, shape (n,), int64."""
        return self.sdf(points)[1]

    def look(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Unit gradient of the distance (n, 3) and shaded colour (n, 3) at points near the surface."""
        points = points.to(torch.float32).contiguous()
        normals, colours = torch.empty_like(points), torch.empty_like(points)
        device = wp.device_from_torch(points.device)
        args = [_wrap(t, wp.vec3) for t in (points, normals, colours)]
        wp.launch(
            tracer.look,
            dim=len(points),
            inputs=[*self._scene(points.device), self._all(points.device), *args],
            device=device,
        )
        return normals, colours

    def surface(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
        """n points uniform on the outer surface (n, 3) and their shaded colours (n, 3).

        Points of a thin shell |d| < ε |∇d| are uniform in volume, hence in area to first order in ε; they are then
        moved onto the surface along the gradient. Faces where two solids touch are no surface: there d falls again
        beyond them.
        """
        centres, cell = self._cells()
        found: list[Tensor] = []
        eps = 0.25 * cell
        while sum(map(len, found)) < n:
            pick = torch.randint(len(centres), (4096 + 4 * n,), generator=generator)
            p = centres[pick] + cell * (torch.rand(len(pick), 3, generator=generator) - 0.5)
            d, _ = self._query(p)
            p, d = p[d.abs() < eps], d[d.abs() < eps]
            normals, _ = self.look(p)
            slope = (self._query(p + eps * normals)[0] - d) / eps
            keep = (slope > 0.2) & (d.abs() < eps * slope)
            p = p[keep] - (d / slope)[keep, None] * normals[keep]
            found.append(self._settled(p, 2))
        points = torch.cat(found)[:n]
        return points, self.look(points)[1]

    def render(self, camera: Camera, aa: int = 2) -> tuple[Tensor, Tensor]:
        """Premultiplied colours (C, H, W, 3) and coverage (C, H, W), from aa × aa rays a pixel."""
        device = camera.viewmats.device
        out = torch.empty(len(camera), camera.height, camera.width, 4, device=device)
        columns, rows = -(-camera.width // tracer.TILE), -(-camera.height // tracer.TILE)
        scene = self._scene(device)
        views = camera.viewmats.to(torch.float32).contiguous()
        Ks = camera.Ks.to(torch.float32).contiguous()
        for c in range(0, len(camera), VIEWS_AT_ONCE):
            v, K, image = (
                _wrap(t[c : c + VIEWS_AT_ONCE], kind) for t, kind in ((views, wp.mat44), (Ks, wp.mat33), (out, wp.vec4))
            )
            ids = torch.empty(2 * len(v) * rows * columns * len(self.primitives), dtype=torch.int32, device=device)
            spans = torch.empty(len(v), rows * columns, 4, device=device)
            lists = [_wrap(ids, wp.int32), _wrap(spans, wp.vec4)]
            shared = [*scene, v, K, columns, *lists]
            wp.launch(tracer.cull, dim=(len(v), rows * columns), inputs=shared, device=v.device)
            wp.launch(tracer.trace, dim=image.shape, inputs=[*shared, aa, image], device=v.device)
        return out[..., :3], out[..., 3]

    # ------------------------------------------------------------------ the table
    def _scene(self, device: torch.device) -> tuple[wp.array, wp.vec4]:
        """The table on a device, made once, and the frame."""
        if str(device) not in self._tables:
            rows = [
                [
                    [p.kind, p.group, CUT if p.cut else UNION, p.blend],
                    [*p.at, p.bound],
                    p.slab,
                    p.turn,
                    p.a,
                    p.bend,
                    [*p.limits, p.reach],
                    [*p.paint.colour, p.paint.pattern],
                    [*p.paint.second, p.paint.scale],
                    [*p.paint.third, p.paint.grain],
                    [p.paint.gloss, p.paint.glow, 0.0, 0.0],
                ]
                for p in self.primitives
            ]
            self._tables[str(device)] = torch.tensor(rows, dtype=torch.float32, device=device)
        return _wrap(self._tables[str(device)], wp.vec4), wp.vec4(*self._frame)

    def _all(self, device: torch.device) -> wp.array:
        return _wrap(torch.arange(len(self.primitives), dtype=torch.int32, device=device), wp.int32)

    def _query(self, points: Tensor) -> tuple[Tensor, Tensor]:
        points = points.to(torch.float32).contiguous()
        d = torch.empty(len(points), device=points.device)
        owner = torch.empty(len(points), dtype=torch.int32, device=points.device)
        device = wp.device_from_torch(points.device)
        args = [
            *self._scene(points.device),
            self._all(points.device),
            _wrap(points, wp.vec3),
            _wrap(d, wp.float32),
            _wrap(owner, wp.int32),
        ]
        wp.launch(tracer.query, dim=len(points), inputs=args, device=device)
        return d, owner

    def _settled(self, p: Tensor, steps: int) -> Tensor:
        """Points moved to the surface by Newton steps p - d n."""
        for _ in range(steps):
            p = p - self._query(p)[0][:, None] * self.look(p)[0]
        return p

    def _cells(self) -> tuple[Tensor, float]:
        """Centres (m, 3) and side of the cubes of a regular grid that the surface may cross."""
        cx, cy, cz, s = self._frame
        at = torch.tensor([p.at for p in self.primitives])
        reach = torch.tensor([p.bound + p.reach for p in self.primitives])[:, None]
        offset = torch.tensor([cx, cy, cz])
        lo, hi = (at - reach).amin(0) * s + offset, (at + reach).amax(0) * s + offset
        cell = float((hi - lo).max()) / MEASURE
        axes = [torch.arange(float(a) + cell / 2, float(b) + cell / 2, cell) for a, b in zip(lo, hi, strict=True)]
        centres = torch.cartesian_prod(*axes)
        d, _ = self._query(centres)
        return centres[d.abs() < 0.87 * cell], cell

    def _measured(self) -> tuple[float, float, float, float]:
        """The frame that centres the bounding box and makes its longest side 2, or less where a corner would leave the
        ball of ``RADIUS`` that cameras see whole.

        Surface points found on a grid climb along each axis by steps of a shrinking length, each followed by a return
        to the surface.
        """
        centres, cell = self._cells()
        p = self._settled(centres, 4)
        lo, hi = [], []
        for axis in range(3):
            for sign, ends in ((-1.0, lo), (1.0, hi)):
                q = p[(sign * p[:, axis]).topk(min(8, len(p))).indices]
                step = torch.zeros(3)
                step[axis] = sign * 0.5 * cell
                top = (sign * q[:, axis]).max()
                for i in range(12):
                    q = self._settled(q + step * 0.75**i, 2)
                    top = torch.maximum(top, (sign * q[:, axis]).max())
                ends.append(sign * float(top))
        radius = (p - torch.tensor([(a + b) / 2 for a, b in zip(lo, hi, strict=True)])).norm(dim=1).max()
        scale = min(2 / max(b - a for a, b in zip(lo, hi, strict=True)), RADIUS / float(radius))
        return (*(-scale * (a + b) / 2 for a, b in zip(lo, hi, strict=True)), scale)


def _wrap(t: Tensor, dtype) -> wp.array:
    return wp.from_torch(t, dtype=dtype)


@functools.lru_cache(maxsize=64)
def shape(recipe: Recipe, without: frozenset[str] = frozenset(), surface: str = "", variant: int = 0) -> Shape:
    """The shape of these arguments, made once."""
    return shape(recipe, without, "", variant).tinted(surface) if surface else Shape(recipe, without, variant)
