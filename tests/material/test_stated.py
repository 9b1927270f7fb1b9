"""Matter that is written out is what it says."""

import pytest
import torch

from diffuphy.material.stated import Piece, StatedMaterial
from diffuphy.mpm.state import check_weights
from diffuphy.types import Motion, Particles

X = torch.tensor([[0.0, 0.0, -0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 0.4]])
PARTICLES = Particles(X, torch.ones(3), torch.zeros(3, dtype=torch.long), 1.0, (0, 0, 0), 1.0)
SOFT = Piece("fixed_corotated", "identity", 200.0, {"E": 1e4, "nu": 0.3})
TOP = {"low": (-1, -1, 0.2), "high": (1, 1, 1)}


def field(*pieces):
    return StatedMaterial(pieces)(None, Motion("falling", ""), None, PARTICLES, work=None)


def test_particle_is_of_the_last_piece_that_it_lies_in():
    upper = Piece("fixed_corotated", "identity", 70.0, {"E": 2e4, "nu": 0.2}, (-1, -1, -0.1), (1, 1, 1))
    top = Piece("fixed_corotated", "identity", 50.0, {"E": 3e4, "nu": 0.1}, **TOP)
    f = field(SOFT, upper, top)
    assert f.rho.tolist() == [200.0, 70.0, 50.0] and f.theta["E"].tolist() == [1e4, 2e4, 3e4]
    assert f.elastic == ("fixed_corotated",) and f.plastic == ("identity",)


def test_pieces_may_follow_different_laws():
    """One-hot rows; a parameter that a piece does not read is that of the one which does."""
    metal = Piece("hencky", "von_mises", 2500.0, {"E": 1e5, "nu": 0.3, "yield_stress": 1e3}, **TOP)
    f = field(SOFT, metal)
    check_weights(f)
    assert f.elastic == ("fixed_corotated", "hencky") and f.w_e.tolist() == [[1, 0], [1, 0], [0, 1]]
    assert f.plastic == ("identity", "von_mises") and f.w_p.tolist() == [[1, 0], [1, 0], [0, 1]]
    assert f.theta["yield_stress"].tolist() == [1e3] * 3


def test_piece_that_holds_nothing_is_refused():
    with pytest.raises(ValueError, match=r"pieces\[1\] holds none of the 3 particles"):
        field(SOFT, Piece("fixed_corotated", "identity", 70.0, {"E": 2e4, "nu": 0.2}, (5, 5, 5), (6, 6, 6)))


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"elastic": "rubbery"}, "unknown law 'rubbery'"),
        ({"theta": {"E": 1e4}}, "needs nu in theta"),
        ({"theta": {"E": 1e4, "nu": 0.3, "viscosity": 1.0}}, "reads no 'viscosity'"),
        ({"theta": {"E": 1e4, "nu": 0.5}}, "nu must be in"),
        ({"rho": 0.0}, "rho must be positive"),
        ({"low": (0, 0, 0), "high": (1, 1, 0)}, "low < high"),
    ],
)
def test_piece_of_no_matter_is_refused(settings, says):
    with pytest.raises(ValueError, match=says):
        Piece(
            **{"elastic": "fixed_corotated", "plastic": "identity", "rho": 1.0, "theta": {"E": 1.0, "nu": 0.3}}
            | settings
        )


@pytest.mark.parametrize(
    ("pieces", "says"),
    [
        ((), "at least one piece"),
        ((Piece("fixed_corotated", "identity", 1.0, {"E": 1.0, "nu": 0.3}, (0, 0, 0)),), "first piece"),
    ],
)
def test_material_begins_with_a_piece_that_is_everywhere(pieces, says):
    with pytest.raises(ValueError, match=says):
        StatedMaterial(pieces)
