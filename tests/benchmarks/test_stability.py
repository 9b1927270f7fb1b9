"""The map of stability calls things by their names: a wrong run is not passed as a stable one."""

import csv
import dataclasses
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from PIL import Image

from benchmarks._draw import Curve, Panel, Plot, plots, table
from benchmarks.stability import courant, design, endurance, report, words
from benchmarks.stability.cells import DX, MATTERS, Cell, Outcome, after_rest, measure, play, scene_of
from benchmarks.stability.verdict import LIMITS, Verdict, classify
from benchmarks.verification.bodies import block
from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.mpm import FrameReport, Grid, Scheme, State

ROOT = Path(__file__).parents[2]
GOOD = {"gain": 0.0, "stirred": 0.0, "momentum": 0.1, "shrunk": 1.3, "sunk": 0.0, "apart": 1e-5}


def test_a_run_within_all_bounds_is_stable():
    assert classify(GOOD).kind == "stable"


@pytest.mark.parametrize("name", LIMITS)
def test_each_number_alone_makes_a_run_drift_and_then_silent(name):
    """stable ≤ first bound < drift ≤ second bound < silent, and the number is named; NaN is silent."""
    limit = LIMITS[name]
    between = 0.5 * (limit.stable + limit.silent)
    for value, kind in (
        (limit.stable, "stable"), (between, "drift"), (limit.silent, "drift"), (1.01 * limit.silent, "silent"),
        (math.inf, "silent"), (math.nan, "silent"),
    ):  # fmt: skip
        verdict = classify(GOOD | {name: value})
        assert verdict.kind == kind
        assert kind == "stable" or name in verdict.why


def test_an_error_is_one_only_if_it_is_of_the_documented_classes():
    assert classify({}, "lower cfl").kind == "error"
    assert classify({}, "IndexError: list index out of range", foreign=True).kind == "silent"
    with pytest.raises(ValueError, match="known"):
        classify({"grain": 1.0})


def made_up(change) -> dict[str, float]:
    """What is measured on a body that lies in the air for a frame, with something about its last state changed."""
    cell = Cell("neo_hookean", speed=0.1)
    body, scene = block((1, 1, 1), DX, (0.0, 0.0, 0.5)), dataclasses.replace(scene_of(cell), gravity=(0.0, 0.0, 0.0))
    zero = torch.zeros(8, 3, 3, dtype=torch.float64)
    v = torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64).repeat(8, 1)
    first = State(body.x, v, zero, zero.clone(), None)
    frame = FrameReport(100, 1e-3, 10.0, 1.0, Grid(DX, (0, 0, 0), (8, 8, 8)), 0, impulse=torch.zeros(3))
    last = dataclasses.replace(first, time=0.1, **change(first))
    return measure(cell, body, scene, [first, last], [frame])[0]


def test_silent_states_are_seen_by_what_is_wrong_with_them():
    """A made-up last state: energy from nothing, momentum from nothing, a squashed and an inverted particle, one below
    the floor. What is wrong is measured, and nothing else on an untouched one."""
    assert classify(made_up(lambda s: {})).kind == "stable"
    e = torch.eye(3, dtype=torch.float64)
    spoiled = {
        "gain": lambda s: {"v": -1.1 * s.v},  # 1.21 of the kinetic energy
        "momentum": lambda s: {"v": s.v * (1 - 1e-8)},
        "shrunk": lambda s: {"He": s.He - 0.9 * e},  # J = 1e-3
        "sunk": lambda s: {"x": s.x - s.x.new_tensor([0.0, 0.0, 0.6 + DX])},
    }
    for name, change in spoiled.items():
        verdict = classify({name: made_up(change)[name]})
        assert verdict.kind == "silent" and name in verdict.why
    assert math.isnan(made_up(lambda s: {"He": s.He - 2.0 * e})["shrunk"])
    assert classify(made_up(lambda s: {"x": s.x * math.nan})).kind == "silent"


def test_a_body_that_stirs_after_a_rest_is_not_passed():
    """Largest rise of the energy from the first of two still frames on: not that of a bounce, whose turn is one frame,
    nor anything before."""
    fall, turn, bounce, rest = [1.0, 0.7], [0.005], [0.4], [0.005, 0.004]
    assert after_rest([*fall, *turn, *bounce, *rest], [0.0, 0.0, -0.9, 0.3, -0.95, -0.95], 0.01) == 0.0
    assert after_rest([*fall, *rest, 0.3], [0.0, 0.0, -0.95, -0.96, -0.65], 0.01) == pytest.approx(0.3)
    assert after_rest([*fall, *turn, *bounce], [0.0, 0.0, -0.9, 0.3], 0.01) == 0.0


def test_every_law_is_run_long_and_small_bodies_on_both_floors():
    runs = {matter: list(endurance.bodies(matter)) for matter in MATTERS}
    assert all(("long", Cell(matter, precision="float32")) in runs[matter] for matter in MATTERS)
    small = [cell for its in runs.values() for place, cell in its if place == "small"]
    assert {(c.side, c.contact, c.precision) for c in small} == {
        (side, contact, precision)
        for side in (1, 2) for contact in ("elastic", "rigid") for precision in ("float32", "float64")
    }  # fmt: skip


def test_a_crash_is_silent_and_a_refusal_an_error(monkeypatch):
    cell = Cell("hencky, von_mises", yields=-1.0, side=1)
    refused, _ = play(cell, scene_of(cell))
    assert refused.verdict.kind == "error" and "yield_stress of particle 0" in refused.verdict.why

    def crash(*_args: object, **_options: object) -> None:
        raise IndexError("out of range")

    monkeypatch.setattr("benchmarks.stability.cells.simulate", crash)
    assert play(cell, scene_of(cell))[0].verdict.kind == "silent"


def test_the_map_has_every_law_and_every_corner():
    laws = {law for elastic, plastic, _ in MATTERS.values() for law in (*elastic, *plastic)}
    assert laws == set(ELASTIC) | set(PLASTIC)
    assert len(set(design.corners("hencky"))) == 16
    assert {c.E for _, c in design.lines("hencky")} >= {1e2, 1e11}
    assert {c.contact for _, c in design.inside("hencky", 4)} == {"elastic", "rigid"}
    assert list(design.inside("hencky", 4)) == list(design.inside("hencky", 4)), "seeded"


def test_halving_finds_where_steps_become_unstable(monkeypatch):
    """To 2 %, and says so where all steps or none are stable."""
    monkeypatch.setattr(courant, "stable", lambda m, nu, c, s, a: c <= 0.93)
    assert courant.largest("hencky", 0.3).largest == pytest.approx(0.93 / 1.011, rel=0.013)
    monkeypatch.setattr(courant, "stable", lambda m, nu, c, s, a: True)
    assert courant.largest("hencky", 0.3).largest == courant.HIGH
    monkeypatch.setattr(courant, "stable", lambda m, nu, c, s, a: False)
    assert courant.largest("hencky", 0.3).largest == 0.0


def test_a_particle_alone_is_stable_to_what_its_own_field_allows():
    """c Δt/Δx ≤ √((λ + 2μ)/(3λ + 2μ)) at rest, 0.577 of a liquid, wherever it is in its cell; 2 % on either side."""
    plain = Scheme(sharpen=False)
    assert courant.stable("fluid_eos, fluid", 0.3, 0.566, plain, alone=True)
    assert not courant.stable("fluid_eos, fluid", 0.3, 0.589, plain, alone=True)


def test_messages_are_quoted_once():
    """Two errors that differ by numbers are one line."""
    cell, error = Cell("hencky"), "det F = {} of particle {}; lower cfl"
    rows = [report.row("E", Outcome(cell, classify({}, error.format(a, b)), {})) for a, b in ((-0.1, 7), (-2e-5, 11))]
    text = words.messages({"cells": rows, "long": [], "refusals": []})
    assert text.count("lower cfl") == 1 and "| 2 |" in text


def test_marked_parts_of_a_page_are_replaced_and_nothing_else(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("head\n<!-- a -->\nold\n<!-- /a -->\ntail\n")
    for _ in range(2):
        report.put(page, {"a": "new\n", "b": "more\n"})
        assert page.read_text() == "head\n<!-- a -->\nnew\n<!-- /a -->\ntail\n<!-- b -->\nmore\n<!-- /b -->\n"


def test_pictures_are_drawn(tmp_path: Path):
    table(tmp_path / "t.png", "T", ["a"], [Panel("p", ["1"], {("a", "1"): ("#D55E00", "S", "#FFFFFF")})], [])
    points = [(1.0, 1e-3), (10.0, 1e-1), (100.0, math.nan)]
    plots(tmp_path / "p.png", "P", [Plot("one", "x", "y", [Curve("c", points), Curve("d", points, 1)])])
    with Image.open(tmp_path / "t.png") as picture:
        assert (0xD5, 0x5E, 0x00) in {c for _, c in picture.getcolors(10**6) or ()}
    with Image.open(tmp_path / "p.png") as picture:
        assert len(picture.getcolors(10**6)) > 4


def test_the_quick_form_runs_and_finds_nothing_silent(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["stability", "--quick", "--jobs", "1", "--out", str(tmp_path)])
    assert report.main() == 0
    with (tmp_path / "cells.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 10 and not any(r["verdict"] == "silent" for r in rows)
    page = (tmp_path / "stability.md").read_text()
    assert "**0 silent cells:**" in page and "not measured yet:** fixed_corotated" in page
    assert page.count("<!-- short -->") == page.count("<!-- /measured -->") == 1


def test_a_matter_that_is_measured_again_takes_the_place_of_what_was_known_of_it():
    """Rows of the others stay, in the order of the list; seconds are kept for each."""
    data = {"cells": [], "courant": [], "long": [], "seconds": {}}
    for matter, verdict in (("hencky", "error"), ("neo_hookean", "stable"), ("hencky", "stable")):
        outcome = Outcome(Cell(matter), Verdict(verdict, ""), {})
        share = report.Share(
            matter, [("corner", outcome)], [courant.Courant(matter, 0.3, False, 0.9)], [("long", outcome)], 2.0
        )
        data = report.added(data, share)
    assert sorted((r["matter"], r["verdict"]) for r in data["cells"]) == [
        ("hencky", "stable"),
        ("neo_hookean", "stable"),
    ]
    assert [r["matter"] for r in data["long"]] == sorted(("hencky", "neo_hookean"), key=list(MATTERS).index)
    assert data["seconds"] == {"hencky": 2.0, "neo_hookean": 2.0}


ASLEEP = """
import signal, time
from benchmarks.stability import report

def asleep(matter, quick):
    print("at work", flush=True)
    time.sleep(60.0)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background jobs do not inherit
    report.study = asleep
    list(report.studied(False, 1, ["hencky"]))
"""


@pytest.mark.parametrize("end", (signal.SIGINT, signal.SIGKILL))
def test_no_process_outlives_the_map(end: signal.Signals, tmp_path: Path):
    """Nobody holds the pipe to which its processes write once the first one was told to end, or was killed."""
    script = tmp_path / "asleep.py"
    script.write_text(ASLEEP)
    run = subprocess.Popen([sys.executable, script], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert run.stdout is not None
    assert run.stdout.readline() == b"at work\n"
    begin = time.monotonic()
    run.send_signal(end)
    assert run.stdout.read() == b""  # not before the last of them has ended
    assert time.monotonic() - begin < 20.0, "it was left to sleep"
    assert run.wait() != 0
