"""The object on the bench: its regions."""

from types import SimpleNamespace

import pytest
import torch

from diffuphy.learning.case import Case, segments
from diffuphy.learning.probe import Probe
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.material.encoder import Points
from diffuphy.types import Gaussians, Look, Motion, Particles

RED, BROWN = torch.tensor([0.9, 0.1, 0.1]), torch.tensor([0.3, 0.2, 0.1])


def points(colors):
    return Points(
        torch.rand(len(colors), 3), torch.cat([torch.zeros(len(colors), 7), colors, torch.zeros(len(colors), 1)], 1)
    )


def test_parts_of_one_word_are_one_region_whatever_their_colours():
    """Bun, patty and seeds of two words: the patty is a region though half of it looks like the bun."""
    words, part = ["gelatin", "playdoh", "gelatin"], torch.tensor([0, 0, 1, 1, 2, 0])
    colors = torch.stack([RED, RED, RED, BROWN, BROWN, RED])
    found = segments(points(colors), words, part, 2, "parts")
    assert found.tolist() in ([0, 0, 1, 1, 0, 0], [1, 1, 0, 0, 1, 1])
    by_colour = segments(points(colors), words, part, 2, "colour")
    assert by_colour.tolist() == [0, 0, 0, 1, 1, 0]


def test_colours_decide_where_the_prompt_or_the_library_does_not():
    """One word, or more words than regions are wanted: clusters of colour; one region is always whole."""
    colors = torch.stack([RED, RED, BROWN])
    one = torch.zeros(3, dtype=torch.long)
    assert segments(points(colors), ["gelatin"], one, 2, "parts").tolist() == [0, 0, 1]
    three = segments(points(colors), ["gelatin", "playdoh", "sand"], torch.arange(3), 2, "parts")
    assert three.tolist() == [0, 0, 1]
    assert segments(points(colors), ["gelatin"], one, 1, "parts").tolist() == [0, 0, 0]


def test_regions_without_particles_are_not_counted():
    """A word of a part that the draft has no particle of is no region."""
    words, part = ["gelatin", "playdoh", "sand"], torch.tensor([0, 2, 2])
    found = segments(points(torch.stack([RED, RED, RED])), words, part, 2, "parts")
    assert sorted(found.unique().tolist()) == [0, 1] and found[1] == found[2] != found[0]


class Layers:
    """A block whose middle layer, a fifth of its height, is another part."""

    parts = (SimpleNamespace(name="bread"), SimpleNamespace(name="filling"))

    def object(self, look):
        return self

    def part_of(self, points):
        return (points[:, 2].abs() < 0.2).long()


@pytest.mark.parametrize("regions, segment", [(2, "parts"), (2, "colour"), (1, "parts")])
def test_every_draft_has_each_material_in_its_true_share(regions, segment):
    """Volume of the filling over that of the block, in the draft that is fitted and in that of the reference; also
    where one hypothesis is made for both. Draft cells are nearly as thick as the filling."""
    a = (torch.arange(20) + 0.5) / 10 - 1
    x = torch.cartesian_prod(a, a, a)
    colors = torch.stack([RED, BROWN])[Layers().part_of(x)]
    gaussians = Gaussians(
        x, torch.tensor([1.0, 0, 0, 0]).repeat(len(x), 1), torch.full((len(x), 3), -3.0), torch.full((len(x),), 4.0),
        ((colors - 0.5) / 0.28209479)[:, None, :],
    )  # fmt: skip
    body = Particles(0.2 * x, torch.full((len(x),), 0.02**3), torch.arange(len(x)), 0.2, (0.0, 0.0, 0.0), 0.02)
    motion = Motion("falling", "x", {"": "gelatin", "filling": "playdoh"}, 0.4)
    case = Case.make(
        Probe(particles=300, frames=2, image=16), Analytic(layout="clip", s=0.0), Layers(), Look("block", "a block"),
        motion, gaussians, body, elastic=("neo_hookean", "hencky"), plastic=("identity", "von_mises"),
        regions=regions, segment=segment,
    )  # fmt: skip
    theirs = case.cond.guidance.references
    for field, draft in ((case.table, case.bench.draft), (theirs.field, theirs.bench.draft)):
        share = float((draft.vol * field.w_p[:, 1]).sum() / draft.vol.sum())
        assert share == pytest.approx(0.2, rel=1e-5)  # float32
    assert len(set(case.labels.tolist())) == regions
