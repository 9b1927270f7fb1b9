"""Numbers as colours."""

import pytest
import torch

from diffuphy.render.film import colormap
from diffuphy.render.film.colormap import DIVERGING, SEQUENTIAL, Scale, from_oklab, lookup, quantity, table, to_oklab


def test_oklab_is_that_of_its_author_and_goes_both_ways() -> None:
    """White is (1, 0, 0); the published example: linear red has L = 0.628, a = 0.225, b = 0.126 (Ottosson 2020)."""
    torch.testing.assert_close(to_oklab(torch.ones(3)), torch.tensor([1.0, 0, 0]).double(), rtol=0, atol=1e-6)
    red = to_oklab(torch.tensor([1.0, 0, 0]))
    torch.testing.assert_close(red, torch.tensor([0.628, 0.225, 0.126]).double(), rtol=0, atol=5e-4)  # three digits
    rgb = torch.rand(500, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    # the two branches of sRGB's curve meet to 1e-7 only, and the published matrices have ten digits
    torch.testing.assert_close(from_oklab(to_oklab(rgb)), rgb, rtol=0, atol=1e-6)


def test_the_sequential_map_rises_in_lightness_in_even_steps() -> None:
    """dL > 0 everywhere, so that grey tells the order; steps of colour differ by less than a third."""
    lab = to_oklab(table(SEQUENTIAL))
    steps = (lab[1:] - lab[:-1]).norm(dim=1)
    assert (lab[1:, 0] > lab[:-1, 0]).all() and steps.min() > 2 / 3 * steps.max()


def test_the_diverging_map_is_lightest_in_the_middle() -> None:
    """L rises to the middle and falls from it, and both ends are as dark."""
    L = to_oklab(table(DIVERGING))[:, 0]
    half = len(L) // 2
    assert (L[1:half] > L[: half - 1]).all() and (L[half + 2 :] < L[half + 1 : -1]).all()
    assert abs(float(L[0] - L[-1])) < 0.02  # a hundredth of lightness is what one just sees


def test_the_ends_of_a_map_are_its_control_points() -> None:
    for name in (SEQUENTIAL, DIVERGING):
        ends = [[int(h[k : k + 2], 16) / 255 for k in (0, 2, 4)] for h in (name[0], name[-1])]
        torch.testing.assert_close(lookup(torch.tensor([-1.0, 2.0]), name), torch.tensor(ends), rtol=0, atol=1e-5)


def test_one_particle_far_off_does_not_move_a_scale() -> None:
    """A hundredth of the values at each end may lie beyond; without them the scale is exact."""
    values = torch.linspace(0, 1, 1001)
    far = torch.cat([values, torch.tensor([1e9])])
    assert Scale.of(far).hi == pytest.approx(0.99, abs=2e-3) and Scale.of(far).lo == 0.0


def test_a_ratio_has_one_in_the_middle() -> None:
    """J and 1/J are as far from the middle: place(1) = ½, place(r) + place(1/r) = 1."""
    scale = Scale.of(torch.linspace(0.5, 1.1, 1000), "ratio")
    J = torch.tensor([0.7, 1 / 0.7, 1.0])
    place = scale.place(J)
    torch.testing.assert_close(place[2], torch.tensor(0.5))
    torch.testing.assert_close(place[0] + place[1], torch.tensor(1.0))
    assert scale.hi == pytest.approx(1 / scale.lo)


def test_a_logarithm_has_its_geometric_mean_in_the_middle() -> None:
    scale = Scale(1e3, 1e7, "log")
    assert float(scale.place(torch.tensor(1e5))) == pytest.approx(0.5, abs=1e-6)
    assert [v for _, v in scale.ticks()] == pytest.approx([1e3, 1e5, 1e7])


@pytest.mark.parametrize("kind", ["linear", "log", "ratio"])
@pytest.mark.parametrize("value", [0.0, 1.0, 5e4])
def test_matter_that_is_the_same_everywhere_has_a_scale(kind: str, value: float) -> None:
    """No division by a range of zero."""
    scale = Scale.of(torch.full((100,), value), kind)
    assert scale.lo < scale.hi and scale.colors(torch.full((3,), value)).isfinite().all()


def test_numbers_are_written_with_prefixes() -> None:
    said = [
        quantity(v, u) for v, u in ((1.254e6, "Pa"), (0.0, "Pa"), (3.2, "m/s"), (0.012, "m"), (1.05, ""), (2e13, "Pa"))
    ]
    assert said == ["1.25 MPa", "0 Pa", "3.2 m/s", "12 mm", "1.05", "2e+04 GPa"]


def test_the_legend_shows_the_colours_that_are_painted() -> None:
    """First and last colour of the map stand in the card, which lies in the lower left corner and nowhere else."""
    scale = Scale(0.0, 1.0)
    card = colormap.bar("speed", "m/s", scale, 200)
    flat = card[..., :3].reshape(-1, 3)
    for end in scale.colors(torch.tensor([0.0, 1.0])):
        assert ((flat - end).abs().amax(1) < 2 / 255).any()  # 8 bit, and one step of the map
    picture = colormap.lay(torch.zeros(200, 300, 3), card)
    assert picture[: 200 - len(card) - 6].max() == 0 and picture[:, card.shape[1] + 6 :].max() == 0
    assert picture.max() > 0.5
    assert colormap.lay(torch.zeros(20, 20, 3), card).shape == (20, 20, 3)  # cut where it does not fit


def test_scale_errors_say_what_is_allowed() -> None:
    with pytest.raises(ValueError, match="lo < hi"):
        Scale(1.0, 1.0)
    with pytest.raises(ValueError, match="log scale needs lo > 0"):
        Scale(0.0, 1.0, "log")
