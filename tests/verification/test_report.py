"""Checks can fail, pages show all of them, names are found or refused."""

import json
import math
import sys

import pytest

from benchmarks.verification import CASES, SETTINGS, Case, Check
from benchmarks.verification.bodies import crossings, order, peaks
from benchmarks.verification.case import at_least, at_most, case, near
from benchmarks.verification.report import Result, chosen, main, page, write


@pytest.mark.parametrize("measured, ok", [(1.0, True), (0.9, True), (1.1, True), (0.89, False), (1.11, False)])
def test_a_check_accepts_its_closed_interval(measured, ok):
    assert Check("q", measured, 0.9, 1.1, 1.0).ok is ok
    assert near("q", 1.05 * measured, 1.05, 0.105 + 1e-15).ok is ok


def test_what_is_not_a_number_fails():
    """A solver that answers NaN must not pass because comparisons with NaN are false."""
    assert not at_most("error", math.nan, 1.0).ok and not at_least("order", math.nan, 1.0).ok
    assert not at_most("error", math.inf, 1e9).ok


def test_a_negative_error_is_a_mistake_of_the_case():
    assert not at_most("error", -1e-3, 1.0).ok


def test_every_case_states_its_equation_in_one_line():
    for c in CASES.values():
        assert c.equation and len(c.equation) < 400, c.id
        assert set(c.schemes) <= set(SETTINGS) and c.tier in (0, 1)


def test_two_cases_cannot_share_a_name():
    with pytest.raises(ValueError, match="two cases are called A1"):
        case("A1", "again")(lambda s: [])


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="no case 'Z9'; known: A1"):
        chosen(["Z9"], None, ["default"])
    with pytest.raises(ValueError, match="no scheme 'flip'; known: default"):
        chosen([], None, ["flip"])


def test_tiers_and_names_choose():
    assert [i for i, _ in chosen(["A5", "A2"], None, ["default"])] == ["A2", "A5"]
    assert [i for i, _ in chosen(["A5", "A2"], 0, ["default"])] == ["A2"]
    assert {s.name for _, s in chosen(["C1"], None, ["all"])} == set(SETTINGS)
    assert {s.name for _, s in chosen(["A2"], None, ["all"])} == {"default", "mls", "apic"}


def test_the_page_shows_every_check(tmp_path):
    checks = [at_most("error of |u|", 2.0, 1.0, "m"), near("T", 1.0, 1.0, 0.1, "s")]
    results = [Result("A1", "default", checks)]
    text = page(results, "a machine")
    assert "| A1 | error of \\|u\\| [m] | 0 | 2 | 0 … 1 | **outside** |" in text
    assert "| A1 | T [s] | 1 | 1 | 0.9 … 1.1 | ok |" in text
    write(results, tmp_path)
    rows = json.loads((tmp_path / "benchmarks/verification.json").read_text(encoding="utf-8"))["results"]
    assert [len(r["checks"]) for r in rows] == [2]


def test_the_command_measures_writes_and_says_whether_all_is_well(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["verification", "A2", "--out", str(tmp_path)])
    assert main() == 0
    assert "| A2 |" in (tmp_path / "verification.md").read_text(encoding="utf-8")
    assert "A2" in capsys.readouterr().out
    failing = Case("A2", "fails", 0, ("default",), lambda s: [at_most("e", 2.0, 1.0)])
    monkeypatch.setitem(CASES, "A2", failing)
    assert main() == 1


def test_crossings_and_peaks_of_a_sine():
    """Zeros of cos ωi at (k + ½) π/ω and extremes ±1, ω = π/20: cubic and parabola leave ω⁴/100 and ω⁴/400."""
    w = math.pi / 20
    q = [math.cos(w * i + 0.3) for i in range(81)]
    for k, t in enumerate(crossings(q)):
        assert abs(w * t + 0.3 - (k + 0.5) * math.pi) < w * w**4 / 100
    assert max(abs(abs(p) - 1) for p in peaks(q)) < w**4 / 400


def test_order_of_errors():
    assert order(0.4, 0.1) == 2.0
