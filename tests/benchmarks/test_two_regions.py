"""The case that a uniform start loses: an elastic bun round a plastic patty."""

import json

import pytest

from benchmarks.two_regions import WAYS, fit, known, landscape_section, page


@pytest.mark.slow
def test_the_right_law_is_found_for_both_parts():
    """At least 90 % of each part, from clips of another draw of particles; E of the elastic part within 0.33
    decades: a quarter of a step of the joint grid, which the compass leaves."""
    row = fit("softmax", 0, particles=400, image=40, steps=10)
    assert min(row["bun"]["right"], row["patty"]["right"]) >= 0.9 and abs(row["bun"]["error"]) < 0.33


def test_the_page_counts_those_that_are_right_in_both_parts():
    part = {"right": 1.0, "error": 0.1, "spread": 0.0}
    half = part | {"right": 0.5}
    way = next(iter(WAYS))
    rows = [
        {"way": way, "seed": s, "cpu_seconds": 1.0, "mixed": 0.01, "hardened": 0.1, "bun": part, "patty": p}
        for s, p in enumerate((part, half))
    ]
    text = page({"machine": "m", "particles": 1, "image": 1, "steps": 1, "rows": rows})
    assert f"| {way} | 1 of 2 | 100% | 75% | +0.10, +0.10 | +0.10, +0.10 | 1e-02, 1e-02 | 1e-01, 1e-01 | 1 |" in text


def test_the_page_says_how_far_from_the_truth_the_loss_is_lowest():
    """An end of the line is a bound, not a minimum."""
    row = {"seed": 0, "particles": 9, "share": [0.4, 0.3], "log_E": [4.0, 5.0, 6.0], "true": 5.0}
    text = landscape_section([row | {"loss": [1.0, 2.0, 3.0]}, row | {"loss": [3.0, 1.0, 2.0]}])
    assert "| 9 | 0 | 40.0% | 30.0% | 1.0e+00 | ≤ -1.0 | 2.0e+00 |" in text
    assert "| 1.0e+00 | +0.0 | 1.0e+00 |" in text


def test_results_of_another_size_are_not_mixed(tmp_path):
    """Rows of 400 particles stay with rows of 400 particles."""
    size, file = {"particles": 400, "image": 40, "steps": 30}, tmp_path / "two_regions.json"
    file.write_text(json.dumps(size | {"rows": [{"seed": 0}]}))
    assert known(file, size)["rows"] == [{"seed": 0}]
    assert known(file, size | {"steps": 31})["rows"] == []
