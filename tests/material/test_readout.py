"""A material field in words."""

import pytest
import torch

from diffuphy.material import presets
from diffuphy.material.readout import readout


@pytest.mark.parametrize("word", presets.PRESETS)
def test_a_material_of_the_table_reads_as_itself(word):
    """Its distance to its own word is zero: the word found has the same law and the same values of what is read."""
    own = presets.lookup(word)
    (row,) = readout(presets.field([own], torch.zeros(5, dtype=torch.long)), torch.zeros(5, dtype=torch.long), ["it"])
    found = presets.lookup(row.like)
    assert (row.plastic, row.elastic) == (own.plastic, own.elastic) and found.plastic == own.plastic
    for name, value in row.theta.items():
        assert value == pytest.approx(own.theta[name], rel=1e-5)  # float32, and a logarithm of it
        if name != "nu":
            assert getattr(found, name) == own.theta[name]


def test_parts_come_largest_first_and_those_without_particles_are_left_out():
    part = torch.tensor([0, 0, 2, 2, 2])
    kinds = [presets.lookup(w) for w in ("gelatin", "sand", "playdoh")]
    rows = readout(presets.field(kinds, part), part, ["bun", "salt", "patty"])
    assert [r.name for r in rows] == ["patty", "bun"] and rows[0].share == pytest.approx(0.6)
    assert str(rows[1]).startswith("bun: gelatin-like, neo_hookean, identity, E 6e+04")


def test_a_part_of_two_minds_says_so():
    """Half of one law, half of another: purity ½; log10 E of 4 and 6 is 10^5 with a spread of 1."""
    field = presets.field([presets.lookup("plasticine")], torch.zeros(2, dtype=torch.long))
    field.theta["E"].copy_(torch.tensor([1e4, 1e6]))
    mixed = type(field)(
        field.elastic,
        ("von_mises", "identity"),
        field.w_e,
        torch.tensor([[1.0, 0.0], [0.0, 1.0]]),
        field.theta,
        field.rho,
    )
    (row,) = readout(mixed, torch.zeros(2, dtype=torch.long), ["it"])
    assert row.purity == 0.5 and "(50%)" in str(row)
    assert row.theta["E"] == pytest.approx(1e5, rel=1e-5) and row.spread == pytest.approx(1.0, rel=1e-6)
