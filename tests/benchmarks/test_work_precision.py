"""Work-precision: what is a front, an order, a fair turn; the exact answers; and that the default earns its place."""

import math
import random
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import torch

from benchmarks.work_precision import command
from benchmarks.work_precision.analysis import Point, beaten_by, fitted_order, front, orders, work_for
from benchmarks.work_precision.cases import BAR_C, BAR_V, CASES
from benchmarks.work_precision.choice import CHOICES, DEFAULT, Choice, named
from benchmarks.work_precision.figure import SECONDS, WORK, figure, number
from benchmarks.work_precision.gradient import EXACT, Gradient, W
from benchmarks.work_precision.nonlinear_bar import amplitudes
from benchmarks.work_precision.page import REASONS, Section, page
from benchmarks.work_precision.peers import CODES, has, task_of
from benchmarks.work_precision.problem import Sample, Trial
from benchmarks.work_precision.references import distance, kept, limit, reference
from benchmarks.work_precision.report import ratio, series_of, table, verdict
from benchmarks.work_precision.rows import Row, read, write
from benchmarks.work_precision.sweep import how_to
from benchmarks.work_precision.timing import interleaved, noise, repeats_of, turns


def point(series: str, work: float, error: float) -> Point:
    return Point(series, work, error)


def test_front_holds_what_nothing_beats():
    """p is on the front iff no q has work ≤, error ≤ and one of them <; found here by comparing all pairs."""
    g = random.Random(0)
    points = [point(str(i), g.choice((1, 2, 3, 4, 5)), g.choice((1, 2, 3, 4, 5))) for i in range(40)]
    expected = {
        (p.work, p.error)
        for p in points
        if not any(q.work <= p.work and q.error <= p.error and (q.work, q.error) != (p.work, p.error) for q in points)
    }
    assert {(p.work, p.error) for p in front(points)} == expected


def test_what_is_not_finite_is_not_on_the_front():
    assert front([point("a", 1.0, math.nan), point("b", 2.0, 1.0)]) == [point("b", 2.0, 1.0)]


def test_differences_below_the_noise_beat_nothing():
    """t' e^noise < t and e' ≤ e, or e' < 0.98 e and t' ≤ t e^noise."""
    mine = point("default", 1.0, 1.0)
    cases = {(0.95, 1.0): False, (0.85, 1.0): True, (1.05, 0.97): True, (1.05, 0.99): False, (1.2, 0.5): False}
    for (work, error), beats in cases.items():
        assert bool(beaten_by(mine, [point("other", work, error)], 0.1)) is beats, (work, error)


def test_orders_of_a_power_are_exact():
    """e = c n^−p: p between neighbours and by least squares."""
    cells = [8.0, 12.0, 16.0, 32.0]
    errors = [3.0 * n**-1.7 for n in cells]
    assert orders(cells, errors) == pytest.approx([1.7] * 3, rel=1e-12)
    assert fitted_order(cells, errors) == pytest.approx(1.7, rel=1e-12)
    with pytest.raises(ValueError, match="two resolutions"):
        fitted_order([8.0], [1.0])


def test_work_for_an_error_follows_a_power_exactly():
    """w = c e^−q is a straight line in logarithms; outside of the points nothing is said."""
    series = [point("a", 2.0 * e**-1.5, e) for e in (1.0, 0.1, 0.01)]
    assert work_for(series, 0.03) == pytest.approx(2.0 * 0.03**-1.5, rel=1e-12)
    assert work_for(series, 2.0) is None and work_for(series, 0.001) is None


def test_turns_go_there_and_back():
    """ABBA: with equal repeats every runner has the same mean place, so that a steady drift cancels."""
    assert turns([2, 2]) == [0, 1, 1, 0]
    assert turns([4, 1, 2]) == [0, 1, 2, 2, 0, 0, 0]
    order = turns([4] * 5)
    places = [sum(i for i, who in enumerate(order) if who == k) for k in range(5)]
    assert len(set(places)) == 1


def test_interleaved_keeps_the_order_and_counts_of_turns():
    """Each runner is run as often as its budget allows, and samples come back to those that they are of."""
    clock = {"t": 0.0}

    def runner(seconds: float):
        def run() -> Sample:
            clock["t"] += 1.0
            return Sample(seconds, clock["t"])

        return run

    timed = interleaved([runner(0.1), runner(10.0)], [Sample(9.0, 9.0)] * 2, budget=0.5)
    assert [len(t.samples) for t in timed] == [5, 2]
    assert [t.seconds for t in timed] == [0.1, 10.0]
    assert [s.wall for s in timed[1].samples] == [2.0, 3.0]  # A B B A …
    assert repeats_of(100.0, 1.0) == 2 and repeats_of(1e-9, 1.0) == 7


def test_noise_is_the_largest_difference_of_equal_runs():
    assert noise([(1.0, 1.0), (2.0, 2.2), (1.0, 0.95)]) == pytest.approx(math.log(1.1))
    assert noise([]) == 0.0


def test_bar_of_small_strain_is_the_linear_one():
    """a₁ → (V/ω) sin ωt as V → 0, the rest to 0: squares of the strain V/c = 1e-6 drive them, by ωt/4 of it."""
    V = 1e-6 * BAR_C
    a = amplitudes((0.05, 0.13), V, BAR_C)
    omega = math.pi * BAR_C
    exact = [V / omega * math.sin(omega * t) for t in (0.05, 0.13)]
    np.testing.assert_allclose(a[:, 0], exact, atol=1e-6 * omega * 0.13 / 4 * V / omega)
    assert np.abs(a[:, 1:]).max() < 1e-6 * V / omega


def test_bar_of_finite_strain_keeps_its_energy():
    """½ ρ v² + μ/2 (F² − 1 − 2 ln F) is conserved: the velocity at u = 0 after a period has the energy of the start."""
    h = 1e-5
    times = tuple(0.4 + k * h for k in (-1, 0, 1))
    before, now, after = amplitudes(times, BAR_V, BAR_C)
    v = (after - before) / (2 * h)
    k = np.arange(1, len(now) + 1) * math.pi
    X = (np.arange(400) + 0.5) / 400
    F = 1 - np.sin(np.outer(X, k)) @ (k * now)
    kinetic = 0.25 * (v**2).sum()
    stored = 0.5 * BAR_C**2 / 2 * (F**2 - 1 - 2 * np.log(F)).mean()
    # central differences of ω = 31 over 1e-5 s: (ω h)²/6 = 2e-8
    assert kinetic + stored == pytest.approx(0.25 * BAR_V**2, rel=1e-6)


def test_gradient_of_the_bar_is_exact_in_the_limit():
    """d ln v/d ln E = −(w/2) tan w, by differences of cos ωt."""
    v = lambda s: math.cos(W * math.sqrt(s))  # noqa: E731
    assert (v(1 + 1e-6) - v(1 - 1e-6)) / 2e-6 / v(1.0) == pytest.approx(EXACT, rel=1e-8)


def test_richardson_finds_limit_and_order_of_a_power():
    """u = u0 + a n^−1.5 on 4, 6, 9 cells: limit u0, order 1.5."""
    exact = torch.tensor([[1.0, 2.0]], dtype=torch.float64)
    values = [exact + torch.tensor([[0.3, -0.2]], dtype=torch.float64) * n**-1.5 for n in (4, 6, 9)]
    found, p = limit(values, (4, 6, 9))
    assert p == pytest.approx(1.5, rel=1e-9)
    torch.testing.assert_close(found, exact, rtol=1e-12, atol=1e-12)
    with pytest.raises(ValueError, match="constant ratio"):
        limit(values, (4, 6, 8))


def test_reference_is_known_to_what_two_schemes_differ_by():
    one = [torch.tensor([[0.0, 1.0], [1.0, 3.0]]) + x for x in (0.4, 0.2, 0.1)]
    two = [a + 0.05 for a in one]
    kept_ = reference({"default": one, "plain APIC": two}, (4, 8, 16))
    assert kept_["uncertainty"] == pytest.approx(0.05 / 2.0, rel=1e-3)
    assert distance(one[0] + 0.05, one[0]) == pytest.approx(0.025, rel=1e-6)


def test_references_are_those_of_the_grids_that_cases_name():
    """A case with a closed form has none; the others are made from the grids that they say."""
    for id, known in kept().items():
        assert tuple(known["cells"]) == CASES[id].reference


def test_case_without_its_reference_is_left_out_with_how_to_make_it(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "kept", dict)
    found, missing = command.measure("W5", True, None, tmp_path)
    assert found is None and "--references" in missing[0]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_cases_hold_the_same_matter_at_every_resolution(case):
    """Σ vol does not depend on the grid, except along what is n cells thin; steps fill the time."""
    masses = [float(case.build(n, 2).body.vol.sum()) for n in case.resolutions]
    thin = {"W1": 2, "W1b": 2, "W3": 1, "W5": 1}.get(case.id, 0)  # so many sides are a fixed number of cells
    for n, m in zip(case.resolutions, masses, strict=True):
        assert m * n**thin == pytest.approx(masses[0] * case.resolutions[0] ** thin, rel=1e-9)
    p = case.build(case.resolutions[0], 2)
    dt, per = p.steps(0.4)
    assert dt * per * p.frames == pytest.approx(p.seconds, rel=1e-12)
    assert dt * p.pace <= 0.4 * p.dx * (1 + 1e-9)


def test_choices_differ_from_the_default_in_what_they_say():
    assert [c for c in CHOICES if c.axis == "default"] == [DEFAULT]
    assert len({c.series for c in CHOICES}) == len(CHOICES)
    settings = {(c.scheme, c.cfl, c.dtype, c.per) for c in CHOICES}
    assert len(settings) == len(CHOICES)
    with pytest.raises(ValueError, match="no choice is called nothing"):
        named("nothing")
    with pytest.raises(ValueError, match="cfl must be in"):
        Choice("fast", "CFL", cfl=1.0)


def test_every_axis_has_a_reason():
    """What beats the default somewhere has to be answered for."""
    assert {c.axis for c in CHOICES} - {"default"} <= set(REASONS)


@pytest.fixture(scope="module")
def bars() -> dict[str, Trial]:
    """W1 at eight cells, run once by the default and by both plain schemes."""
    trials = {c.series: Trial(CASES["W1"].build(8, 2), c) for c in named("default", "plain MLS", "plain APIC")}
    for t in trials.values():
        t.run()
    return trials


def test_default_is_an_order_of_magnitude_less_wrong_than_the_plain_schemes(bars):
    """Sharpening takes the inertia D |C|² out, which makes periods (π²/8)(Δx/L)² too long: 4π · 0.019 at 8 cells."""
    assert bars["plain MLS"].error() > 8 * bars["default"].error()
    assert bars["plain APIC"].error() > 8 * bars["default"].error()


def test_rounds_count_the_extra_one_of_half_kicks(bars):
    a, b = bars["default"], bars["plain MLS"]
    assert a.rounds - b.rounds == a.problem.frames and a.per == b.per


def test_body_forces_are_not_counted():
    """The manufactured solution is forced by what costs more than the solver; its seconds are those of the solver."""
    trial = Trial(CASES["W2"].build(6, 2), DEFAULT)
    trial.run()
    assert trial.forces is not None
    first = trial.forces.cpu
    assert first > 0.0
    again = trial.run()
    assert again.seconds >= 0.0 and len(trial.forces.kept) == trial.rounds


def test_gradient_does_not_depend_on_checkpoints():
    """Substeps run again are the same substeps: equal to the last bit."""
    found = []
    for options in ({}, {"segment": 1}, {"keep": True}):
        g = Gradient(8, DEFAULT, **options)
        g.run()
        found.append((g.value, g.megabytes))
    assert found[0][0] == found[1][0] == found[2][0]
    assert found[2][1] > found[0][1]


def row(series: str, cells: float, error: float, seconds: float, axis: str = "CFL", **fields: object) -> Row:
    values = {
        "case": "W1", "series": series, "axis": axis, "cells": cells, "dx": 1 / cells, "cfl": 0.4, "order": 2,
        "precision": "float32", "force": "mls", "per": 2.0, "particles": 100, "rounds": 10, "error": error,
        "seconds": seconds, "low": seconds, "high": seconds, "wall": seconds, "compiling": None, "samples": "1 2",
    }  # fmt: skip
    return Row(**(values | fields))  # type: ignore[arg-type]


ROWS = [
    row("default", 8, 0.1, 1.0, "default", compiling=2.0),
    row("default", 16, 0.02, 4.0, "default"),
    row("CFL 0.7", 8, 0.1, 0.5),
    row("CFL 0.7", 16, 0.021, 2.0),
    row("plain MLS", 8, 0.9, 0.8, "transfer"),
]


def test_rows_come_back_from_their_file(tmp_path):
    write(tmp_path / "a" / "W1.csv", ROWS)
    assert read(tmp_path / "a" / "W1.csv") == ROWS


def test_verdict_names_what_beats_the_default_and_by_how_much():
    text = verdict(ROWS, 0.05)
    assert text.startswith("The default lies on the front at 1 of 2 resolutions (16 cells)")
    assert "at 8 cells CFL 0.7 has 1.00 of the error in 0.50 of the time" in text
    slow = [r for r in ROWS if r.axis != "CFL"]
    assert verdict(slow, 0.05) == "The default lies on the front at 2 of 2 resolutions (8, 16 cells)."


def test_time_to_an_error_is_read_off_between_points():
    by = series_of(ROWS)
    target = by["default"][1]
    assert ratio(by["default"], target) == "4 s"
    assert ratio(by["plain MLS"], target) == "> 0.2 ×"
    assert ratio(by["CFL 0.7"], by["default"][0]) == "0.5 ×"


def test_page_says_where_the_default_is_beaten_and_why_it_is_kept():
    section = Section("W1", "Free bar", "error", "cells", "A bar.", ROWS, 0.05)
    text = page("a machine", [section], ["Taichi is left out"])
    assert "| [W1](#w1-free-bar) Free bar | 1 of 2 | CFL 0.7 |" in text
    assert f"- CFL: {REASONS['CFL']}." in text and f"- part: {REASONS['part']}." not in text
    assert table(ROWS) in text and "Taichi is left out." in text


def test_figure_is_well_formed_and_shows_every_point():
    svg = figure("W1 & more", "error <e>", "note", ROWS, (SECONDS, WORK), 0.05)
    root = ET.fromstring(svg)
    marks = [e for e in root.iter() if e.tag.endswith("circle") or e.tag.endswith("polygon")]
    series = len({r.series for r in ROWS})
    assert len(marks) == 2 * len(ROWS) + series  # in both panels, and in the legend
    assert "reference known to this" in svg
    width = float(root.attrib["width"])
    assert all(0 <= float(e.attrib["cx"]) <= width for e in root.iter() if e.tag.endswith("circle"))


@pytest.mark.parametrize(
    ("value", "words"), [(0.01, "0.01"), (5.0, "5"), (1e-3, '10<tspan dy="-5" font-size="9">−3</tspan>')]
)
def test_ticks_are_short(value, words):
    assert number(value) == words


def test_a_task_says_what_the_problem_is(tmp_path):
    """An npz file holds all that another code needs, and comes back equal."""
    problem = CASES["W4"].build(2, 2)
    task = task_of(problem, 0.4)
    task.save(str(tmp_path / "task.npz"))
    again = type(task).read(str(tmp_path / "task.npz"))
    assert all(np.array_equal(getattr(task, k), getattr(again, k)) for k in vars(task))
    assert task.walls.shape == (1, 8) and task.walls[0, 6:].tolist() == [2.0, 0.3]
    assert (task.low < task.x.min(0)).all() and (task.high > task.x.max(0)).all()


def test_missing_codes_are_named_with_how_to_install_them():
    assert not has(sys.executable, "no_such_package") and not has("no_such_interpreter", "numpy")
    assert has(sys.executable, "numpy")
    text = how_to(next(c for c in CODES if c.package == "taichi"), None)
    assert "pip install taichi" in text and "--peers-python" in text


def test_page_is_drawn_again_from_the_files(tmp_path):
    """--page runs nothing: same rows, same page."""
    section = command.section("W1", ROWS, 0.05)
    command.store(tmp_path, section, "a machine")
    assert command.main(["--page", "--out", str(tmp_path)]) == 0
    first = (tmp_path / "accuracy.md").read_text(encoding="utf-8")
    command.main(["--page", "--out", str(tmp_path)])
    assert (tmp_path / "accuracy.md").read_text(encoding="utf-8") == first
    assert "Largest rms" not in first and "1 of 2" in first


def test_quick_form_writes_every_case(tmp_path):
    """All cases at their coarsest: rows, figures and page are there, and the default is less wrong than plain MLS."""
    assert command.main(["--quick", "--out", str(tmp_path)]) == 0
    for id in command.ORDER:
        if id in CASES and CASES[id].reference and id not in kept():
            continue
        rows = read(tmp_path / f"{id}.csv")
        assert (tmp_path / f"{id}.svg").exists() and rows
        by = series_of(rows)
        if id in ("W1", "W2", "W3", "W4", "W6"):
            assert by["default"][-1].error < by["plain MLS"][-1].error
