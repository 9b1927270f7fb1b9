"""The page of errors is made of what was measured."""

import pytest

from benchmarks.errors import fall, filled

PAGE = "before\n<!-- a -->\n<!-- /a -->\nbetween\n<!-- b -->\nold\n<!-- /b -->\nafter\n"


def test_a_part_is_replaced_and_nothing_else():
    once = filled(filled(PAGE, "a", "A"), "b", "B")
    assert once == "before\n<!-- a -->\nA\n<!-- /a -->\nbetween\n<!-- b -->\nB\n<!-- /b -->\nafter\n"
    assert filled(once, "a", "A") == once


def test_a_page_without_the_marks_is_refused():
    with pytest.raises(ValueError, match="the page has no part"):
        filled(PAGE, "c", "C")


def test_the_mean_of_factors_is_geometric():
    """√(1 · 4) = 2; the ends are rounded outwards."""
    assert fall({"a": {"factor": 1.04}, "b": {"factor": 3.96}}) == (1.0, 2.0, 4.0)
