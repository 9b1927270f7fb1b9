"""The case that a uniform start loses: an elastic bun round a plastic patty."""

import pytest

from benchmarks.two_regions import WAYS, fit, page


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
    rows = [{"way": way, "seed": s, "cpu_seconds": 1.0, "bun": part, "patty": p} for s, p in enumerate((part, half))]
    text = page({"machine": "m", "particles": 1, "image": 1, "steps": 1, "rows": rows})
    assert f"| {way} | 1 of 2 | 100% | 75% | +0.10, +0.10 | +0.10, +0.10 | 1 |" in text
