"""The library of objects: distances, surfaces, pictures, and the references component."""

import math

import pytest
import torch

from diffuphy.render import orbit
from diffuphy.text2gs.shapes import RECIPES, Library, Shape, find
from diffuphy.text2gs.shapes.catalogue import WORDS, plural
from diffuphy.text2gs.shapes.distance import HIT
from diffuphy.text2gs.shapes.primitives import Part, Recipe, Sketch
from diffuphy.text2gs.shapes.shape import RADIUS, shape
from diffuphy.text2gs.shapes.tints import TINTS, tint_of
from diffuphy.types import Look

NAMES = tuple(RECIPES)
PARTS = (Part("a", "rubber", (0.8, 0.2, 0.2)), Part("b", "rubber", (0.2, 0.2, 0.8)))


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def views(n: int = 2, size: int = 48):
    return orbit([30.0 + 360 * i / n for i in range(n)], 20.0, 5.0, fov=40.0, width=size, height=size)


def cloud(n: int, seed: int = 0) -> torch.Tensor:
    return 1.6 * (2 * torch.rand(n, 3, generator=generator(seed)) - 1)


def drawn(draw) -> Shape:
    return Shape(Recipe("test", (), "{} test", PARTS, draw))


def own_frame(s: Shape, p: torch.Tensor) -> torch.Tensor:
    """Points of the drawing in the frame of the shape, which is centred and scaled."""
    x, y, z, k = s._frame
    return k * p + torch.tensor([x, y, z])


# ---------------------------------------------------------------------- distances
@pytest.mark.parametrize(
    ("draw", "exact"),
    [
        (lambda s: s.ball("a", (0, 0, 0), 0.7), lambda p: p.norm(dim=1) - 0.7),
        (
            lambda s: s.box("a", (0, 0, 0), (0.8, 0.5, 0.3), 0.0),
            lambda p: (q := p.abs() - torch.tensor([0.8, 0.5, 0.3])).clamp(min=0).norm(dim=1) + q.amax(1).clamp(max=0),
        ),
        (
            lambda s: s.disc("a", (0, 0, 0), 0.6, 0.4, 0.0),
            lambda p: (
                (q := torch.stack([p[:, :2].norm(dim=1) - 0.6, p[:, 2].abs() - 0.4], 1)).clamp(min=0).norm(dim=1)
                + q.amax(1).clamp(max=0)
            ),
        ),
        (
            lambda s: s.torus("a", (0, 0, 0), 0.7, 0.2),
            lambda p: torch.stack([p[:, :2].norm(dim=1) - 0.7, p[:, 2]], 1).norm(dim=1) - 0.2,
        ),
        (
            lambda s: s.limb("a", (0, 0, -0.5), (0, 0, 0.5), 0.3, 0.3),
            lambda p: (p - torch.stack([p[:, 0] * 0, p[:, 0] * 0, p[:, 2].clamp(-0.5, 0.5)], 1)).norm(dim=1) - 0.3,
        ),
    ],
    ids=["ball", "box", "disc", "torus", "capsule"],
)
def test_primitives_have_their_closed_form_outside(draw, exact):
    """d(p) = k d_exact(p / k); float32 keeps 1e-6 of lengths near 1, and the bounds never exceed the distance."""
    s = drawn(draw)
    p = cloud(4000)
    d_exact = exact(p)
    d, _ = s.sdf(own_frame(s, p))
    out = d_exact > 0
    torch.testing.assert_close((d / s._frame[3])[out], d_exact[out], rtol=0, atol=5e-6)
    assert ((d < 0) == (d_exact < 0)).all()


@pytest.mark.parametrize("name", NAMES)
def test_distance_never_exceeds_that_to_the_surface(name):
    """|d(p)| ≤ min_q |p - q| over points q of the surface; q carries the float32 error of the Newton step and of d."""
    s = shape(RECIPES[name])
    q, _ = s.surface(3000, generator())
    p = torch.cat([cloud(1500), q[:1500] + 0.05 * torch.randn(1500, 3, generator=generator(1))])
    d, _ = s.sdf(p)
    slack = 2 * s.sdf(q)[0].abs().max()
    assert (d.abs() <= torch.cdist(p, q).amin(1) + slack + 1e-5).all()


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"apple", "duck", "ice cream", "rocket", "teddy bear", "cactus"}))
def test_distance_is_1_lipschitz(name):
    """|d(p) - d(q)| ≤ |p - q|: exact primitives, smooth unions and cuts keep it; the left-out objects have thin
    ellipsoids, whose first-order distance is a lower bound but steeper far away. Float32 leaves 2e-6 over steps of
    1e-2 and more."""
    s = shape(RECIPES[name])
    p = cloud(8000)
    step = torch.randn(len(p), 3, generator=generator(1))
    q = p + step / step.norm(dim=1, keepdim=True) * torch.linspace(0.01, 0.3, len(p))[:, None]
    slope = (s.sdf(p)[0] - s.sdf(q)[0]).abs() / (p - q).norm(dim=1)
    assert slope.max() < 1.01


def test_bent_primitives_stay_lower_bounds_at_strong_bends():
    """The Lipschitz constant of the bend, not luck, keeps rays from stepping through ribs and ruffles."""
    s = drawn(lambda k: k.disc("a", (0, 0, 0), 0.9, 0.08, 0.03, bend=(0.12, 0.10, 9, 0.1)))
    q, _ = s.surface(6000, generator())
    p = torch.cat([cloud(2000), q[:3000] + 0.1 * torch.randn(3000, 3, generator=generator(1))])
    assert (s.sdf(p)[0].abs() <= torch.cdist(p, q).amin(1) + 2 * s.sdf(q)[0].abs().max() + 1e-5).all()


def test_smooth_union_sinks_below_the_minimum_by_a_quarter_of_k_at_most():
    """min(a, b) - k/4 ≤ d ≤ min(a, b), with equality on the left where a = b."""
    apart, k = 0.5, 0.3

    def balls(blend):
        def draw(s: Sketch) -> None:
            s.ball("a", (-apart, 0, 0), 0.4)
            s.ball("a", (apart, 0, 0), 0.4, blend=blend)

        return drawn(draw)

    hard, smooth = balls(0.0), balls(k)
    p = cloud(3000)
    p[0] = torch.tensor([0.0, 0.2, 0.0])
    a, b = hard.sdf(own_frame(hard, p))[0] / hard._frame[3], smooth.sdf(own_frame(smooth, p))[0] / smooth._frame[3]
    assert (b <= a + 1e-5).all() and (b >= a - k / 4 - 1e-5).all()
    assert b[0].item() == pytest.approx(a[0].item() - k / 4, abs=1e-5)


def test_cut_removes_what_it_covers():
    """d = max(a, -b)."""

    def draw(s: Sketch) -> None:
        s.ball("a", (0, 0, 0), 1.0)
        s.ball("a", (0, 0, 1.0), 0.5, cut=True)

    s = drawn(draw)
    d, _ = s.sdf(own_frame(s, torch.tensor([[0.0, 0.0, 0.9], [0.0, 0.0, 0.4], [0.0, 0.0, -0.5]])))
    assert d[0] > 0 and d[1] < 0 and d[2] < 0


def test_look_gives_the_gradient():
    """On a ball the unit gradient is p / |p|; a difference of 1.5e-3 on float32 distances leaves 1e-3."""
    s = drawn(lambda k: k.ball("a", (0, 0, 0), 1.0))
    p = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator()), dim=1)
    normals, colours = s.look(p)
    torch.testing.assert_close(normals, p, rtol=0, atol=2e-3)
    assert ((colours >= 0) & (colours <= 1)).all()


# ---------------------------------------------------------------------- frame, parts, surface
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("variant", [0, 1])
def test_objects_are_centred_and_fill_the_frame(name, variant):
    """Bounding box centred on 0 with longest side 2, or a corner 1.2 from the origin.

    The climb to the extremes ends within 2e-3, random points fall short of them.
    """
    s = shape(RECIPES[name], variant=variant)
    p, _ = s.surface(4000, generator())
    lo, hi = p.amin(0), p.amax(0)
    assert (hi - lo).max() <= 2 + 5e-3
    assert (hi - lo).max() > 1.9 or p.norm(dim=1).max() > 1.15
    assert ((lo + hi) / 2).abs().max() < 0.06
    assert p.norm(dim=1).max() < 1.2 + 5e-3
    inside = (x := cloud(20000))[s.sdf(x)[0] < 0]
    assert inside.mean(0).norm() < 0.45


@pytest.mark.parametrize("name", NAMES)
def test_every_part_shows(name):
    """Points of the surface are nearest to each part somewhere, so that none is buried in another."""
    s = shape(RECIPES[name])
    assert tuple(p.name for p in s.parts) == tuple(p.name for p in RECIPES[name].parts)
    p, _ = s.surface(20000, generator())
    seen = set(s.part_of(p).tolist())
    assert seen == set(range(len(s.parts))), {s.parts[i].name for i in set(range(len(s.parts))) - seen}


def test_surface_points_are_uniform():
    """On a ball the z of uniform points is uniform (Archimedes): variance 1/3, standard error 4/(3 √(5 n)) ... < 0.005
    at n = 20000."""
    s = drawn(lambda k: k.ball("a", (0, 0, 0), 1.0))
    p, _ = s.surface(20000, generator())
    assert (p.norm(dim=1) - 1).abs().max() < 1e-3
    assert p[:, 2].square().mean().item() == pytest.approx(1 / 3, abs=5 * math.sqrt(4 / 45 / 20000))
    assert p.mean(0).abs().max() < 5 * math.sqrt(1 / 3 / 20000)


def test_touching_faces_are_no_surface():
    """Two boxes that make a cube, face to face: no point on the plane between them, except on the cube's sides."""

    def draw(s: Sketch) -> None:
        s.box("a", (0, 0, -0.5), (1, 1, 0.5), 0.0)
        s.box("b", (0, 0, 0.5), (1, 1, 0.5), 0.0)

    p, _ = drawn(draw).surface(4000, generator())
    half = RADIUS / math.sqrt(3)  # of the cube whose corners lie on the ball that cameras see whole
    assert ((p[:, 2].abs() > 0.05) | (p[:, :2].abs().amax(1) > 0.99 * half)).all()


def test_surface_is_determined_by_the_generator():
    s = shape(RECIPES["burger"])
    a, b, c = s.surface(500, generator(3)), s.surface(500, generator(3)), s.surface(500, generator(4))
    assert torch.equal(a[0], b[0]) and torch.equal(a[1], b[1]) and not torch.equal(a[0], c[0])


# ---------------------------------------------------------------------- pictures
@pytest.mark.parametrize("name", NAMES)
def test_pictures_are_premultiplied_and_show_the_solid(name):
    """0 ≤ rgb ≤ alpha ≤ 1; coverage 1 where a ray through the pixel's centre goes deeper than the pixel is wide, 0
    where it stays away."""
    s = shape(RECIPES[name])
    camera = views()
    rgb, alpha = s.render(camera)
    assert rgb.shape == (2, 48, 48, 3) and alpha.shape == (2, 48, 48)
    assert (rgb >= 0).all() and (rgb <= alpha[..., None] + 1e-6).all() and (alpha <= 1).all()
    depth = _deepest(s, camera)
    pixel = 5.0 / camera.Ks[0, 0, 0].item()
    assert (alpha[depth < -pixel] == 1).all()
    assert (alpha[depth > pixel + HIT] == 0).all()


def _deepest(s: Shape, camera) -> torch.Tensor:
    """Least distance along the ray of every pixel (C, H, W), by dense sampling: within a step of 0.02 of the true
    one."""
    y, x = torch.meshgrid(torch.arange(48) + 0.5, torch.arange(48) + 0.5, indexing="ij")
    K = camera.Ks[0]
    d = torch.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], torch.ones_like(x)], -1)
    d = torch.nn.functional.normalize(d, dim=-1)
    out = []
    for V in camera.viewmats:
        directions, origin = d @ V[:3, :3], -V[:3, :3].T @ V[:3, 3]
        t = torch.arange(3.2, 6.8, 0.04)
        points = origin + t[:, None, None, None] * directions
        out.append(s.sdf(points.reshape(-1, 3))[0].reshape(len(t), 48, 48).amin(0))
    return torch.stack(out)


def test_tiles_do_not_show():
    """The lists of tiles leave nothing out: a picture moved by half a tile is the same picture, but for rounding of
    the rays."""
    s = shape(RECIPES["burger"])
    camera = views(1, 64)
    moved = type(camera)(camera.viewmats, camera.Ks.clone(), 72, 64)
    moved.Ks[:, 0, 2] += 4
    a, b = s.render(camera)[0], s.render(moved)[0][:, :, 4:68]
    assert ((a - b).abs().amax(-1) > 0.02).float().mean() < 2e-3


def test_colours_of_points_are_those_of_pictures():
    """Shading does not depend on the view: points seen face-on have the colour of their pixel."""
    s = shape(RECIPES["cube"])
    camera = orbit([0.0], 0.0, 6.0, fov=30.0, width=65, height=65)
    rgb, _ = s.render(camera, aa=3)
    _, colour = s.look(torch.tensor([[1.0, 0.0, 0.0]]))
    torch.testing.assert_close(rgb[0, 32, 32], colour[0], rtol=0, atol=1e-3)


# ---------------------------------------------------------------------- words
def test_words_find_objects():
    assert find("Hamburger").name == "burger" and find("teddy  bears").name == "teddy bear"
    assert len(WORDS) == len({w for r in RECIPES.values() for w in (r.name, *r.words)})
    assert all(find(plural(w)).name == name for w, name in WORDS.items())


def test_unknown_objects_name_the_nearest():
    with pytest.raises(ValueError, match="did you mean burger"):
        find("burgr")


def test_left_out_parts_are_gone_and_the_stack_closes():
    """Without patty, cheese and salad the bun halves touch: nothing floats."""
    full, thin = shape(RECIPES["burger"]), shape(RECIPES["burger"], frozenset({"patty", "cheese", "lettuce", "tomato"}))
    assert {p.name for p in thin.parts} == {"bun", "sesame"}
    axis = torch.zeros(200, 3)
    axis[:, 2] = torch.linspace(-1, 1, 200)
    inside = (thin.sdf(axis)[0] < 1e-3).int()
    assert (inside.diff() != 0).sum() == 2
    assert len(full.primitives) > len(thin.primitives)


def test_impossible_shapes_are_refused():
    with pytest.raises(ValueError, match="no part 'wings'"):
        Shape(RECIPES["burger"], frozenset({"wings"}))
    with pytest.raises(ValueError, match="nothing is left"):
        Shape(RECIPES["ball"], frozenset({"ball"}))
    with pytest.raises(ValueError, match="no part 'hat'"):
        Shape(RECIPES["ball"]).tinted("hat=gold")
    with pytest.raises(ValueError, match="changes no colours"):
        Shape(RECIPES["ball"]).tinted("rubber")


@pytest.mark.parametrize("word", ["sand", "gold", "red", "green jelly"])
def test_a_tint_moves_colours_towards_its_own_but_features_less(word):
    """Mean colour distance to the tint falls for the body; the dark eyes of the snowman stay dark."""
    plain, tinted = (shape(RECIPES["snowman"], surface=x) for x in ("", word))
    aim = torch.tensor(tint_of(word).colour)
    for part, factor in (("body", 0.5), ("eyes", 1.0)):
        before, after = (
            torch.tensor([p.paint.colour for p in s.primitives if p.part == part]).mean(0) for s in (plain, tinted)
        )
        assert (after - aim).norm() < factor * (before - aim).norm()
    assert after.mean() < 0.35


def test_a_tint_of_one_part_leaves_the_others():
    plain, icing = shape(RECIPES["cake"]), shape(RECIPES["cake"], surface="icing=chocolate")
    for a, b in zip(plain.primitives, icing.primitives, strict=True):
        assert (a.paint == b.paint) == (a.part != "icing")


def test_every_tint_applies():
    for word in TINTS:
        for p in shape(RECIPES["duck"], surface=word).primitives:
            assert all(0 <= x <= 1 for x in (*p.paint.colour, *p.paint.second, *p.paint.third))


# ---------------------------------------------------------------------- the references component
def test_references_lie_over_the_background():
    """rgb + (1 - alpha) background, for one colour, one a view, and pictures."""
    library, look, camera = Library(variants=2), Look("duck", ""), views(2, 24)
    colour = torch.tensor([0.2, 0.5, 0.9])
    one, logits = library(look, camera, colour)
    assert one.shape == (2, 2, 24, 24, 3) and logits.shape == (2,)
    assert torch.equal(one, library(look, camera, colour.expand(2, 3))[0])
    assert torch.equal(one, library(look, camera, colour.expand(2, 24, 24, 3))[0])
    rgb, alpha = library.object(look, 0).render(camera)
    expected = rgb + (1 - alpha[..., None]) * colour
    torch.testing.assert_close(one[:, 0], expected, rtol=0, atol=2**-10)  # pictures are kept at half precision


def test_references_are_the_same_from_the_cache_and_in_any_company():
    look, camera = Look("burger", "", surface="jelly"), views(3, 24)
    warm, white = Library(variants=2), torch.ones(3)
    first, _ = warm(look, camera, white)
    again, _ = warm(look, camera[[2, 0, 2]], white)
    assert torch.equal(again, first[[2, 0, 2]])
    assert torch.equal(Library(variants=2)(look, camera[1:2], white)[0], first[1:2])
    assert warm == Library(variants=2)  # the cache is no setting


def test_the_cache_is_bounded(monkeypatch):
    """At most the given bytes: two pictures of 2 · 24² · 4 halves."""
    monkeypatch.setattr("diffuphy.text2gs.shapes.library.CACHE_BYTES", 2 * 2 * 24 * 24 * 4 * 2)
    library = Library(variants=2)
    camera = views(5, 24)
    first, _ = library(Look("ball", ""), camera, torch.ones(3))
    assert len(library._pictures) == 2
    assert torch.equal(library(Look("ball", ""), camera, torch.ones(3))[0], first)


def test_variants_differ_and_the_seed_favours_one():
    library = Library(variants=3, seed=5)
    refs, logits = library(Look("burger", ""), views(1, 32), torch.ones(3))
    for i in range(3):
        for j in range(i):
            assert (refs[0, i] - refs[0, j]).abs().mean() > 5e-3
    assert logits.argmax() == 5 % 3 and logits.softmax(0)[2] > 0.999
    assert torch.equal(Library(variants=3, seed=1)(Look("burger", ""), views(1, 32), torch.ones(3))[0], refs)


def test_negative_words_remove_parts():
    library = Library()
    names = {p.name for p in library.object(Look("snowman", "", negative="hats, blurry, carrot")).parts}
    assert names == {p.name for p in RECIPES["snowman"].parts} - {"hat", "nose"}


@pytest.mark.parametrize("settings", [{"variants": 0}, {"aa": 0}, {"favour": -1.0}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(ValueError):
        Library(**settings)


@pytest.mark.gpu
def test_cuda_draws_what_the_cpu_draws():
    """One source; fused multiply-adds move silhouettes by less than a pixel on few pixels."""
    s = shape(RECIPES["burger"])
    camera = views(2, 64)
    a, b = s.render(camera)[0], s.render(camera.to("cuda"))[0].cpu()
    assert ((a - b).abs().amax(-1) > 0.02).float().mean() < 5e-3
