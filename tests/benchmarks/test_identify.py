"""The machinery of the identification study: other discretisations, least squares, rates, and a recovery."""

import dataclasses
import json
import math

import pytest
import torch

from benchmarks.identify import page, recover, seen, trained
from benchmarks.identify.bodies import PROBE
from benchmarks.identify.newton import least_squares
from benchmarks.identify.rows import Rows, rate, wilson
from benchmarks.identify.specimens import SPECIMENS, contrast
from benchmarks.identify.watch import Watch
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.material.field import harden
from diffuphy.material.net import Net
from diffuphy.workspace import Workspace

TINY = dataclasses.replace(PROBE, particles=200, frames=4, image=32)
NET = Net(groups=12, group_size=12, width=16, depth=1, heads=2)
RUBBER, JELLY = SPECIMENS["rubber"], SPECIMENS["jelly"]


def at(*q):
    return torch.tensor(q, dtype=torch.float64)


def test_interval_of_a_rate_is_wilsons():
    """8 of 10: 0.490 to 0.943 (Brown, Cai & DasGupta 2001, Stat. Sci. 16, by their formula 4)."""
    assert wilson(8, 10) == pytest.approx((0.4901, 0.9433), abs=1e-4)
    assert wilson(10, 10)[1] == 1.0 and wilson(10, 10)[0] == pytest.approx(1 / (1 + 1.96**2 / 10))
    assert rate([True] * 9 + [False]) == "9/10, 60–98 %"
    with pytest.raises(ValueError, match="runs > 0"):
        wilson(0, 0)


def test_least_squares_of_a_line_is_exact():
    """r = A q − b: the minimum is that of the normal equations, wherever it starts."""
    generator = torch.Generator().manual_seed(0)
    A, b = torch.randn(9, 2, generator=generator).double(), torch.randn(9, generator=generator).double()
    best = torch.linalg.lstsq(A, b[:, None]).solution[:, 0]
    wide = {"lo": at(-9, -9), "hi": at(9, 9)}
    found = least_squares(lambda q: A @ q - b, at(3.0, -2.0), tol=1e-9, **wide)
    # the last step is shorter than tol, and steps shrink by the damping, ≥ 1e-6
    torch.testing.assert_close(found.q, best, rtol=0, atol=1e-8)
    bound = float(best[0]) - 0.5
    held = least_squares(lambda q: A @ q - b, at(bound - 1, 0), lo=at(-9, -9), hi=at(bound, 9), tol=1e-9)
    there = torch.linalg.lstsq(A[:, 1:], (b - bound * A[:, 0])[:, None]).solution[0, 0]
    torch.testing.assert_close(held.q, at(bound, float(there)), rtol=0, atol=1e-8)  # on the bound, best along it


def test_descents_start_in_every_basin_of_the_scan():
    """Minima of a grid, the cheapest first: diagonal neighbours count, and what could not be simulated is none."""
    inf = math.inf
    assert recover.minima(at(3, 1, 2, inf, 0.5)) == [4, 1]
    grid = at(5, 4, 4, 9, 2, 8, 1, 8, inf).reshape(3, 3)  # 2 touches the cheaper 1 at its corner
    assert recover.minima(grid) == [6]
    assert recover.minima(at(1, 3, 6, 2, 4, 7, 5, 8, inf).reshape(3, 3)) == [0]


def test_rows_go_on_where_they_stopped(tmp_path):
    rows = Rows(tmp_path / "a.json", ("x",))
    rows.add(x=1, y=2.0)
    again = Rows(tmp_path / "a.json", ("x",))
    assert again.has(x=1) and not again.has(x=2) and json.loads((tmp_path / "a.json").read_text())["rows"] == rows.rows


def test_a_fine_reference_shares_no_discretisation_with_the_fit():
    """Half Δx, half the Courant number, eight times the particles, elsewhere on the grid; the same body, as high."""
    mine, theirs = Watch.make(0, probe=TINY).bench, Watch.make(1, 2.0, probe=TINY).bench
    assert theirs.scene.dx == pytest.approx(mine.scene.dx / 2, rel=0.02)  # whole particles
    assert theirs.scene.cfl == mine.scene.cfl / 2
    assert len(theirs.draft) == pytest.approx(8 * len(mine.draft), rel=0.05)
    assert float(theirs.draft.vol.sum()) == pytest.approx(float(mine.draft.vol.sum()), rel=1e-4)
    assert theirs.draft.offset[2] == mine.draft.offset[2] and theirs.draft.offset[:2] != mine.draft.offset[:2]


def test_every_camera_sees_the_ball_in_the_middle():
    """Cameras and their axis go with the ball, wherever on the grid it is."""
    watch = Watch.make(3, probe=TINY)
    drop = watch.drop(RUBBER, at(5.0), 1)
    clip = watch.see(drop, "4 cameras")
    seen = (clip[0] - torch.tensor(TINY.background)).abs().amax(-1) > 0.2  # (4, H, W)
    column = (seen.sum(1) * torch.arange(32)).sum(1) / seen.sum((1, 2))
    assert bool(((column - 15.5).abs() < 1).all())  # pixels


def test_noise_is_the_seeds_own():
    watch = Watch.make(0, probe=TINY)
    drop = watch.drop(RUBBER, at(5.0), 2)
    a, b, c = (watch.see(drop, "1 camera, noise", seed) for seed in (1, 1, 2))
    assert torch.equal(a, b) and not torch.equal(a, c)
    assert torch.equal(watch.see(drop, "1 camera, noise"), watch.see(drop, "1 camera"))


def test_stiffness_is_recovered_from_a_clip_of_the_same_simulation():
    """Without any discretisation error least squares ends at the truth: to the step at which it stops."""
    watch = Watch.make(0, probe=TINY)
    target = watch.see(watch.drop(RUBBER, at(4.6)), "1 camera")
    lo, hi = RUBBER.box()
    found = least_squares(lambda q: watch.see(watch.drop(RUBBER, q), "1 camera") - target, at(4.9), lo=lo, hi=hi)
    assert RUBBER.errors(found.q, at(4.6))[0] == pytest.approx(0, abs=0.01)  # twice the last step, 5e-3
    assert RUBBER.right([0.09]) == [True] and RUBBER.right([0.11]) == [False] and RUBBER.right([0.19], 2.0) == [True]


def test_halves_beside_each_other_are_left_and_right_in_the_picture():
    """The camera looks along y, a little from the right: colours and regions change where x does."""
    watch = Watch.make(3, probe=TINY, split="x")
    right = watch.bench.draft.x[:, 0] > watch.bench.draft.offset[0]
    assert torch.equal(watch.labels == 1, right)
    clip = watch.see(watch.drop(SPECIMENS["halves side by side"], at(5.0, 5.0), 1), "1 camera")[0, 0]
    blue = clip[..., 2] - clip[..., 0]  # the half of label 0 is red, the other blue
    assert float(blue[12:20, 10:14].mean()) < 0 < float(blue[12:20, 18:22].mean())


def test_a_fit_with_the_discretisation_of_the_reference_has_no_bias(monkeypatch):
    """The resolution study starts at the truth: where nothing differs it stays there, to the step at which it stops."""
    monkeypatch.setattr(seen, "made", lambda seed, finer, probe, split: Watch.make(0, probe=TINY))
    found = seen._bias(RUBBER, 200, PROBE.scheme, 1)
    assert found["bias"] == pytest.approx([0.0], abs=5e-3) and found["rms"] == pytest.approx(0.0, abs=1e-6)


def test_rows_of_halves_say_which_one_is_softer():
    """A stiff half on a soft one and a soft one on a stiff one are two experiments; side by side they are one."""
    row = {"specimen": "two halves", "truth": [1e4, 1e5]}
    assert page.body_of(row) == "two halves, the lower one softer"
    assert page.body_of(row | {"truth": [1e5, 1e4]}) == "two halves, the upper one softer"
    assert page.body_of(row | {"specimen": "halves side by side"}) == "halves side by side"


def test_one_half_is_ten_times_as_stiff_by_turns():
    specimen = SPECIMENS["two halves"]
    for number, sign in ((0, -1), (1, 1)):
        q = contrast(torch.Generator().manual_seed(0), number)
        assert float(q[1] - q[0]) == pytest.approx(sign)
        field = specimen.field(torch.tensor([0, 1]), q)
        assert float(field.theta["E"][1] / field.theta["E"][0]) == pytest.approx(10.0**sign, rel=1e-5)


@pytest.fixture
def tiny(monkeypatch):
    """The study's benches at a tiny size."""
    for module in (trained, recover):
        monkeypatch.setattr(module, "fitting", lambda s: Watch.make(0, probe=TINY, split=s.seam))
        monkeypatch.setattr(module, "made_by", lambda s, _, seed: Watch.make(seed, probe=TINY, split=s.seam))


def stage(case, **settings):
    defaults = dict(guidance=case.cond.guidance, probe=TINY, net=NET, stiffness_steps=0, scan_frames=4, steps=4)
    return FitMaterial(**(defaults | settings))


def test_learning_nu_moves_nu_and_nothing_else(tiny):
    """The prior's clip has ν = 0.43, the table 0.285: it rises, and E stays where the start has it."""
    case = trained.case_of(JELLY, at(4.65, (0.43 - 0.05) / 0.4), "same", 0)
    component = stage(case, learn=("nu",), start=4.65)
    begin = float(case.table.theta["nu"].mean())
    model = component.fit(case, Workspace())
    with torch.no_grad():
        field = harden(model())
    assert float(field.theta["nu"].mean()) > begin + 0.01
    assert float(field.theta["E"].log10().mean()) == pytest.approx(4.65, abs=1e-4)


def test_the_report_says_how_certain_stiffness_is_and_what_cannot_be_told_apart(tiny, caplog):
    """Two elastic laws at 1e6 Pa: a drop that hardly flattens the ball does not show which of them it is."""
    from diffuphy.learning.case import with_columns
    from diffuphy.learning.identifiability import certainty
    from diffuphy.material.moduli import E

    case = trained.case_of(RUBBER, at(6.0), "same", 1)
    field = with_columns(RUBBER.field(case.labels, at(6.0)), ("neo_hookean", "hencky"), ("identity",))
    numbers = certainty(case, field, [E], 0.05)
    assert 0 < numbers["error_E"] < 0.1 and numbers["differ_neo_hookean_hencky"] < 0.05
    assert "does not tell neo_hookean from hencky" in caplog.text
    again = certainty(case, field, [E], 0.1)
    assert again["error_E"] == pytest.approx(2 * numbers["error_E"], rel=1e-6)  # proportional to the noise


def test_a_yield_stress_that_is_never_reached_is_said_not_to_be_seen(tiny, caplog):
    from diffuphy.learning.identifiability import certainty
    from diffuphy.material.plastic.von_mises import YIELD_STRESS

    plasticine = SPECIMENS["plasticine"]
    case = trained.case_of(plasticine, at(3.8), "same", 1)
    numbers = certainty(case, plasticine.field(case.labels, at(5.8)), [YIELD_STRESS], 0.05)
    assert math.isinf(numbers["error_yield_stress"])
    assert "the clip does not show yield_stress" in caplog.text


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"learn": ("E", "rho")}, "E/rho, yield_stress/rho"), ({"pixel_noise": 0.0}, "material.pixel_noise")],
)
def test_what_cannot_be_asked_is_refused_with_a_sentence(settings, message):
    from diffuphy.losses.guidance.analytic import Analytic

    with pytest.raises(ValueError, match=message):
        FitMaterial(guidance=Analytic(layout="clip", s=0.0), **settings)
