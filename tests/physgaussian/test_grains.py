"""``particle_filling`` of a scene file, in our frame."""

import json
from pathlib import Path

import pytest

from diffuphy.mpm.sampling.filling import Rays
from diffuphy.physgaussian import sample
from diffuphy.physgaussian.grains import grains, rays
from diffuphy.physgaussian.scene_file import parse

PUBLISHED = Path(__file__).parent / "published"


def test_the_wolf_is_filled_as_its_file_says():
    """Box [0.4, 1.6]³ about (1, 1, 1), z up: ±0.6 m about the middle; direction 2 is +y, 4 is +z."""
    made = sample(str(PUBLISHED / "wolf.json"), cells=16)
    assert made.cells == 16 and made.threshold == 100.0
    r = made.filling
    assert isinstance(r, Rays) and (r.threshold, r.exclude, r.parity, r.n_grid) == (1.0, ("+y",), "+z", 100)
    assert r.box == pytest.approx((-0.6, 0.6) * 3)


def test_directions_and_box_turn_with_the_vertical():
    """With y up, +y of the box is +z of the film; numbers outside 0 … 5 switch a condition off; by default four cells
    of the lattice in one of the grid."""
    file = parse({
        "mpm_space_vertical_upward_axis": [0, 1, 0],
        "particle_filling": {"search_exclude_direction": [2, 3, 6], "ray_cast_direction": 6,
                             "boundary": [0.9, 1.1, 0.5, 1.7, 0.8, 1.2]},
    })  # fmt: skip
    r = rays(file)
    assert set(r.exclude) == {"+z", "-z"} and r.parity is None and r.n_grid == 4 * 50
    assert r.box[4:] == pytest.approx((-0.5, 0.7))


def test_a_file_that_fills_nothing_says_so():
    with pytest.raises(ValueError, match="no particle_filling; use sample=flood"):
        grains(parse({}))


@pytest.mark.parametrize("path", sorted(PUBLISHED.glob("*.json")), ids=lambda p: p.stem)
def test_every_published_filling_has_a_meaning(path):
    if json.loads(path.read_text()).get("particle_filling"):
        assert isinstance(sample(str(path)).filling, Rays)
