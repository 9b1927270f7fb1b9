"""Views of matter."""

import dataclasses

import pytest
import torch

from diffuphy.render.film.colormap import CATEGORIES, OTHER
from diffuphy.render.film.paint import ALL, PAINTED, Mixed, Moment, check_view, onto_gaussians, painter, wants_matter
from diffuphy.types import MaterialField, Trajectory

T, N = 4, 300


def film() -> Trajectory:
    """A motion that speeds up and is stretched more from frame to frame."""
    g = torch.Generator().manual_seed(0)
    x = torch.rand(T, N, 3, generator=g)
    grow = torch.arange(T)[:, None, None, None] * 0.1 * torch.rand(T, N, 1, 1, generator=g)
    F = torch.eye(3) * (1 + grow)
    v = torch.arange(T)[:, None, None] * torch.rand(T, N, 3, generator=g)
    return Trajectory(x, v, F, 30.0)


def matter(plastic: tuple[str, ...] = ("identity",)) -> MaterialField:
    g = torch.Generator().manual_seed(1)
    w = torch.rand(N, 1, generator=g)
    return MaterialField(
        ("hencky", "neo_hookean"),
        plastic,
        torch.cat([w, 1 - w], 1),
        torch.full((N, len(plastic)), 1 / len(plastic)),
        {"E": 10 ** (4 + 2 * torch.rand(N, generator=g)), "nu": torch.full((N,), 0.3), "yield_stress": torch.ones(N)},
        torch.full((N,), 1e3),
    )


@pytest.mark.parametrize("view", PAINTED)
def test_every_view_paints_every_particle(view: str) -> None:
    paint = painter(view, film(), matter())
    for t in range(T):
        colors = paint(Moment.of(film(), t))
        assert colors.shape == (N, 3) and ((colors >= 0) & (colors <= 1)).all()
    card = paint.legend(200)
    assert card.shape[2] == 4 and card[..., 3].max() > 0.5


def test_a_scale_is_that_of_the_whole_film() -> None:
    """The same number has the same colour in all frames: at rest all are at the bottom, though that frame has no
    range."""
    paint = painter("velocity", film())
    colors = paint(Moment.of(film(), 0))
    assert torch.equal(colors, paint.scale.colors(torch.zeros(N)))  # type: ignore[attr-defined]
    assert len(paint(Moment.of(film(), T - 1)).unique(dim=0)) > 50


def test_stress_is_that_of_the_elastic_part() -> None:
    """A body that has flowed to where it is and is elastically at rest has no stress; with F for Fe it has."""
    motion, plastic = film(), ("identity", "von_mises")
    rest = dataclasses.replace(motion, Fe=torch.eye(3).expand(T, N, 3, 3).contiguous())
    shear = torch.eye(3).repeat(T, N, 1, 1)
    shear[..., 0, 1] = 0.2
    rest, sheared = (dataclasses.replace(m, F=shear) for m in (rest, motion))
    painted = painter("stress", sheared, matter())
    zero = painted.scale.colors(torch.zeros(N))  # type: ignore[attr-defined]
    assert (painted(Moment.of(sheared, 3)) - zero).abs().max() > 0.5
    flowed = painter("stress", rest, matter(plastic))
    assert torch.equal(flowed(Moment.of(rest, 3)), flowed.scale.colors(torch.zeros(N)))  # type: ignore[attr-defined]


def test_a_motion_without_its_elastic_part_is_refused() -> None:
    with pytest.raises(ValueError, match="force=trajectory"):
        painter("stress", film(), matter(("identity", "von_mises")))


def test_laws_are_mixed_by_their_weights() -> None:
    """A colour is Σ w_k c_k, pairs have products of weights, the most frequent law the first colour."""
    field = matter(("identity", "von_mises"))
    mixed = Mixed.of(field)
    assert set(mixed.names) == {f"{e}{p}" for e in field.elastic for p in ("", " + von_mises")}
    assert sum(mixed.shares) == pytest.approx(1, abs=1e-5) and list(mixed.shares) == sorted(mixed.shares, reverse=True)
    weights = {f"{e}{p}": field.w_e[:, k] * 0.5 for k, e in enumerate(field.elastic) for p in ("", " + von_mises")}
    expected = sum(weights[name][:, None] * CATEGORIES[k] for k, name in enumerate(mixed.names))
    torch.testing.assert_close(mixed(), expected)


def test_what_has_no_colour_of_its_own_is_grey() -> None:
    """Seven laws, six colours."""
    w = torch.eye(7)
    names = tuple("abcdefg")
    field = MaterialField(names, ("identity",), w, torch.ones(7, 1), {}, torch.ones(7))
    assert torch.equal(Mixed.of(field, "elastic").colors[6], torch.tensor(OTHER))
    assert len(Mixed.of(field, "elastic").entries) == 6


def test_a_gaussian_has_the_mean_colour_of_those_it_follows() -> None:
    colors = torch.eye(3)
    index, weight = torch.tensor([[0, 1], [2, 2]]), torch.tensor([[0.25, 0.75], [0.5, 0.5]])
    found = onto_gaussians(colors, index, weight)
    assert torch.equal(found, torch.tensor([[0.25, 0.75, 0.0], [0.0, 0.0, 1.0]]))


def test_view_errors_say_what_there_is() -> None:
    with pytest.raises(ValueError, match="a view is one of colour, depth"):
        check_view("color")
    check_view("colour", ALL)
    with pytest.raises(ValueError, match="give their material"):
        painter("E", film())
    assert [v for v in ALL if wants_matter(v)] == ["material", "E", "stress"]
