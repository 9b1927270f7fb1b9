"""The object on the bench: its regions."""

import torch

from diffuphy.learning.case import segments
from diffuphy.material.encoder import Points

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
