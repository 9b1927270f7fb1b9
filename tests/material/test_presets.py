"""Presets: every word is simulable, physically ordered, and findable."""

import math

import pytest
import torch

from diffuphy.material import ELASTIC, PLASTIC, PRESETS, Preset, candidates, lookup, presets

WORDS = (
    "rubber jelly gelatin soft foam sponge bread bun patty cheese lettuce dough plasticine clay playdoh sand gravel "
    "snow salt metal gold steel wood stone plastic cloth plush fur wax chocolate honey syrup butter icecream cream "
    "batter pancake melted water fluid mud ice glass fruit apple cake"
).split()
G = 9.81


def wave_speed(p: Preset) -> float:
    theta = {k: torch.tensor(v, dtype=torch.float64) for k, v in p.theta.items()}
    return float(ELASTIC[p.elastic].wave_speed(theta, torch.tensor(p.rho, dtype=torch.float64)))


def test_every_word_of_the_vocabulary_is_there():
    assert set(WORDS) <= set(PRESETS)
    assert all(PRESETS[a] for a in presets.ALIASES.values())


@pytest.mark.parametrize("word", PRESETS)
def test_preset_lies_in_the_ranges_a_fit_may_search(word: str):
    """Each parameter its laws read is in [lo, hi], and E, ρ where films look well: 3 kPa–2 MPa, 200–2500 kg/m³."""
    p = PRESETS[word]
    for param in p.params:
        assert param.lo <= p.theta[param.name] <= param.hi
    assert 3e3 <= p.E <= 2e6 and 200 <= p.rho <= 2500
    assert p.candidates_elastic[0] == p.elastic and p.candidates_plastic[0] == p.plastic
    assert set(p.candidates_elastic) <= set(ELASTIC) and set(p.candidates_plastic) <= set(PLASTIC)


@pytest.mark.parametrize("word", PRESETS)
def test_preset_costs_few_substeps(word: str):
    """dt = 0.4 dx/(c + 5 m/s) at dx = 2 cm gives at most 300 substeps in a frame of 1/30 s."""
    assert (1 / 30) * (wave_speed(PRESETS[word]) + 5) / (0.4 * 0.02) < 300


@pytest.mark.parametrize("word", [w for w, p in PRESETS.items() if p.plastic == "identity"])
def test_elastic_things_carry_their_own_weight(word: str):
    """A block of 0.3 m sags by ρ g H/(2 E) < 10 % on average."""
    p = PRESETS[word]
    assert p.rho * G * 0.3 / (2 * p.E) < 0.1


@pytest.mark.parametrize("word", [w for w, p in PRESETS.items() if p.plastic == "von_mises"])
def test_ductile_things_stand_and_dent(word: str):
    """They stand 0.3 m high (σ_Y > ρ g H) and an impact at 3 m/s (ρ c v) passes yield."""
    p = PRESETS[word]
    assert p.yield_stress > p.rho * G * 0.3
    assert p.yield_stress < p.rho * wave_speed(p) * 3.0


@pytest.mark.parametrize("word", ["metal", "steel", "gold"])
def test_metals_keep_their_shape_in_a_fall(word: str):
    """All the energy of a fall of 0.6 m, ρ g h, spent on plastic work σ_Y ε is a mean strain of less than 10 %."""
    p = PRESETS[word]
    assert p.rho * G * 0.6 < 0.1 * p.yield_stress


@pytest.mark.parametrize("word", PRESETS)
def test_everything_flows_once_it_melts(word: str):
    """A 0.2 m stack of the melt is far beyond yield and sinks at a rate ρ g H/(3η) of more than 0.3 per second."""
    p = presets.melt(PRESETS[word])
    assert p.rho == PRESETS[word].rho
    if p.plastic == "fluid":
        return
    assert p.plastic == "viscoplastic"
    assert p.yield_stress < 0.1 * p.rho * G * 0.2
    assert 0.3 < p.rho * G * 0.2 / (3 * p.viscosity)
    assert p.viscosity <= PRESETS["melted"].viscosity


@pytest.mark.parametrize("word", ["water", "fluid", "milk", "oil"])
def test_liquids_are_nearly_incompressible(word: str):
    """Half a metre of it compresses by ρ g H/κ < 4 % at the bottom."""
    p = PRESETS[word]
    assert p.rho * G * 0.5 / (p.E / (3 * (1 - 2 * p.nu))) < 0.04


def test_lookup_forgives_case_blanks_and_other_names():
    assert lookup("  Ice  Cream ") is PRESETS["icecream"]
    assert lookup("sponge cake") is PRESETS["cake"]
    assert lookup("RUBBER") is PRESETS["rubber"]


def test_lookup_of_an_unknown_word_names_the_nearest():
    with pytest.raises(ValueError, match="unknown material 'rubbr'; nearest known: rubber"):
        lookup("rubbr")
    with pytest.raises(ValueError, match="unknown material 'qqqq'; known: apple, batter"):
        lookup("qqqq")


def test_field_gives_each_particle_its_preset():
    """Columns in registry order, one-hot rows, θ and ρ of the preset, also for parameters its own laws do not read."""
    kinds = [PRESETS["sand"], PRESETS["rubber"], PRESETS["plasticine"]]
    index = torch.tensor([1, 0, 2, 1])
    f = presets.field(kinds, index, dtype=torch.float64)
    assert f.elastic == ("neo_hookean", "hencky")
    assert f.plastic == ("identity", "drucker_prager", "von_mises")
    for p, k in enumerate(index.tolist()):
        assert f.elastic[int(f.w_e[p].argmax())] == kinds[k].elastic and f.w_e[p].sum() == f.w_e[p].max() == 1
        assert f.plastic[int(f.w_p[p].argmax())] == kinds[k].plastic and f.w_p[p].sum() == f.w_p[p].max() == 1
        assert f.rho[p] == kinds[k].rho
        assert all(float(f.theta[n][p]) == getattr(kinds[k], n) for n in f.theta)
    assert set(f.theta) == {"E", "nu", "friction_angle", "cohesion", "yield_stress"}
    assert f.w_e.dtype == torch.float64 and len(presets.field(PRESETS["sand"], 7)) == 7


def test_field_refuses_an_index_without_preset():
    with pytest.raises(ValueError, match=r"index must be in \[0, 0\], got 0 to 1"):
        presets.field([PRESETS["sand"]], torch.tensor([0, 1]))
    with pytest.raises(ValueError, match="at least one preset"):
        presets.field([], torch.tensor([0]))


def test_candidates_are_the_union_over_the_scene():
    assert candidates(["rubber"]) == (("neo_hookean",), ("identity", "von_mises"))
    assert candidates(["bun", "sand"]) == (("fixed_corotated", "hencky"), ("identity", "drucker_prager", "von_mises"))
    assert candidates(["pancake"], melting=True) == (("hencky",), ("von_mises", "viscoplastic"))
    with pytest.raises(ValueError, match="at least one material word"):
        candidates([])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"nu": 0.5}, "nu must be in .*'fluid' expert"),
        ({"E": -1.0}, "E must be positive"),
        ({"rho": 0.0}, "rho must be positive"),
        ({"E": 1e8}, r"E must be in \[1000, 1e\+07\] Pa"),
        ({"plastic": "rubber"}, "unknown law 'rubber'"),
        ({"candidates_plastic": ("fluid", "identity")}, "must come first"),
    ],
)
def test_preset_that_cannot_be_is_refused(change: dict, message: str):
    with pytest.raises(ValueError, match=message):
        Preset(**({"word": "x", "E": 1e5, "nu": 0.3, "rho": 1000.0} | change))


def test_melted_film_is_thin():
    """What yields at σ_Y stops at the thickness √(2 σ_Y R/(√3 ρ g)), here below 4 cm for a puddle of R = 0.5 m."""
    p = presets.melt(PRESETS["chocolate"])
    assert math.sqrt(2 * p.yield_stress * 0.5 / (math.sqrt(3) * p.rho * G)) < 0.04
