"""Several things, several materials."""

from dataclasses import dataclass

import pytest
import torch

from diffuphy.material import presets
from diffuphy.material.labelled import LabelledMaterial, of_particles
from diffuphy.types import Gaussians, Look, Motion, Particles

LOOK, MOTION = Look("scene", "a scene"), Motion("falling", "")


@dataclass(frozen=True)
class Source:
    """Labels as ``LoadGaussians`` gives them."""

    materials: dict[int, str]
    labels: tuple[int, ...]

    def kinds(self) -> torch.Tensor:
        return torch.tensor(self.labels)


def line(count: int = 8) -> tuple[Gaussians, Particles]:
    """Gaussians in a row; every other particle stands at one, the rest are filler beside it."""
    x = torch.zeros(count, 3)
    x[:, 0] = torch.arange(count).float()
    g = Gaussians(x, torch.zeros(count, 4), x, torch.zeros(count), torch.zeros(count, 1, 3))
    places = torch.cat([x, x + torch.tensor([0.1, 0.3, 0.0])])
    carried = torch.cat([torch.arange(count), torch.full((count,), -1)])
    return g, Particles(places, torch.ones(2 * count), carried, 1.0, (0.0, 0.0, 0.0), 0.1)


def test_every_particle_is_of_the_material_of_its_label():
    """Carriers by their Gaussian, filler by the nearest carrier; laws and parameters are the table's."""
    g, particles = line()
    labels = (1, 1, 1, 2, 2, 7, 7, 7)
    material = LabelledMaterial(Source({1: "rubber", 2: "sand", 7: "rubber"}, labels))
    field = material(LOOK, MOTION, g, particles, work=None)
    rubber, sand = presets.lookup("rubber"), presets.lookup("sand")
    expected = torch.tensor([sand.rho if label == 2 else rubber.rho for label in labels]).repeat(2)
    torch.testing.assert_close(field.rho, expected)
    is_sand = field.w_p[:, field.plastic.index(sand.plastic)] == 1
    assert torch.equal(is_sand, expected == sand.rho) and set(field.plastic) == {rubber.plastic, sand.plastic}
    assert set(material.plastic) == set(field.plastic) and set(material.elastic) == set(field.elastic)


def test_filler_takes_the_label_of_the_nearest_carrier():
    _, particles = line(3)
    assert of_particles(torch.tensor([4, 5, 6]), particles).tolist() == [4, 5, 6, 4, 5, 6]


def test_what_does_not_fit_is_refused():
    g, particles = line(4)
    with pytest.raises(ValueError, match="3 labels do not fit 4"):
        LabelledMaterial(Source({1: "rubber"}, (1, 1, 1)))(LOOK, MOTION, g, particles, work=None)
    with pytest.raises(ValueError, match=r"label 2 \(sand\) has no particles"):
        LabelledMaterial(Source({1: "rubber", 2: "sand"}, (1, 1, 1, 1)))(LOOK, MOTION, g, particles, work=None)
    with pytest.raises(ValueError, match="unknown material"):
        LabelledMaterial(Source({1: "unobtainium"}, (1,)))
    with pytest.raises(ValueError, match="no label has a material"):
        LabelledMaterial(Source({}, (1,)))
