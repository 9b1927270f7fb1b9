"""The benchmark of gradients measures what it says."""

import csv
import math
from pathlib import Path

import pytest
import torch

from benchmarks import gradients


def test_the_slope_of_a_matched_film_is_flat_and_that_of_a_softer_one_falls():
    """L = mean |x − x*|² is 0 at the goal; off() is the distance between slopes over that of the secant."""
    assert gradients.off({"secant": -2.0, "exact": -3.0}, "exact") == 0.5
    zero = torch.zeros((), dtype=torch.float64)
    states = list(gradients.film(gradients.FREE, 1e5, zero, gradients.shaken(), 2, grad=False))
    assert float(gradients.mismatch(states, states, 2)) == 0.0
    stiff = list(gradients.film(gradients.FREE, 1e5, zero + 0.1, gradients.shaken(), 2, grad=False))
    assert float(gradients.mismatch(states, stiff, 2)) > 0.0


def test_the_substep_does_not_follow_the_stiffness_that_is_differentiated_in():
    """Else differences would see another number of substeps; and it divides a frame."""
    dt = gradients.substep(1e5)
    assert 1.0 / gradients.FPS / dt == pytest.approx(round(1.0 / gradients.FPS / dt), abs=1e-9)
    c = gradients.cube().c * math.sqrt(gradients.TARGET * math.exp(gradients.SECANT))
    assert dt * c <= 0.4 * gradients.DX


def test_the_quick_form_runs_and_gradients_are_exact(tmp_path: Path, monkeypatch):
    """float64 against differences of 1e-5 and 1e-6, the better of both: h² and ε/h are below 1e-6 of a smooth function;
    where a wall or the turning of a particle switches within h, the smaller one is."""
    monkeypatch.setattr("sys.argv", ["gradients", "--quick", "--out", str(tmp_path)])
    assert gradients.main() == 0
    with (tmp_path / "exactness.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows and all(float(r["differences"]) < 1e-6 for r in rows)
