"""SVG line plots: the drawn curve is the data."""

import math
import re

import pytest

from diffuphy.render.plot import (
    BOTTOM,
    HEIGHT,
    LEFT,
    MOST_POINTS,
    RIGHT,
    TOP,
    WIDTH,
    label,
    line_plot,
    log_ticks,
    thin,
    ticks,
)


def curve(svg):
    return [
        [tuple(map(float, p.split(","))) for p in c.split()]
        for c in re.findall(r'<polyline class="curve" points="([^"]+)"', svg)
    ]


def test_plot_maps_values_linearly_between_its_ticks():
    """y = 0, 5, 10 with ticks 0 … 10: bottom, middle, top of the frame; x from left to right."""
    (line,) = curve(line_plot("a", [(0, 0.0), (50, 5.0), (100, 10.0)]))
    top, bottom = TOP, HEIGHT - BOTTOM
    want = [(LEFT, bottom), ((LEFT + WIDTH - RIGHT) / 2, (top + bottom) / 2), (WIDTH - RIGHT, top)]
    assert line == pytest.approx([pytest.approx(p, abs=0.06) for p in want])  # coordinates have one decimal


def test_plot_is_logarithmic_where_positive_values_span_decades():
    """1, 10, 100 become equidistant; with a zero among them, or within a decade, the axis stays linear."""
    (line,) = curve(line_plot("a", [(0, 1.0), (1, 10.0), (2, 100.0)]))
    assert line[0][1] - line[1][1] == pytest.approx(line[1][1] - line[2][1], abs=0.2)
    for values in ([0.0, 10.0, 100.0], [1.0, 2.0, 4.0]):
        (line,) = curve(line_plot("a", list(enumerate(values))))
        ratio = (line[0][1] - line[1][1]) / (line[0][1] - line[2][1])
        assert ratio == pytest.approx((values[1] - values[0]) / (values[2] - values[0]), abs=2e-3)


def test_plot_leaves_a_gap_for_values_that_are_not_finite_and_says_so():
    svg = line_plot("a", [(0, 1.0), (1, 2.0), (2, math.nan), (3, 1.5), (4, 1.0), (5, math.inf)])
    assert [len(c) for c in curve(svg)] == [2, 2]
    assert "2 not finite" in svg and "nan" not in svg
    assert "none of 2 values is finite" in line_plot("a", [(0, math.nan), (1, math.nan)])


@pytest.mark.parametrize(
    "points", [[(3, 0.0)], [(3, 7.0)], [(0, 2.0), (1, 2.0)], [(0, -1e-9), (1, -1e9)], [(0, 1e-300), (1, 1.0)]]
)
def test_plot_of_odd_curves_stays_inside_its_frame(points):
    for x, y in re.findall(r'cx="([^"]+)" cy="([^"]+)"', line_plot("a", points)) + [
        p for c in curve(line_plot("a", points)) for p in c
    ]:
        assert LEFT - 0.1 <= float(x) <= WIDTH - RIGHT + 0.1 and TOP - 0.1 <= float(y) <= HEIGHT - BOTTOM + 0.1


def test_plot_escapes_its_name_and_refuses_an_empty_curve():
    assert "<b>" not in line_plot("<b>", [(0, 1.0)])
    with pytest.raises(ValueError, match="no points"):
        line_plot("a", [])


@pytest.mark.parametrize(
    ("lo", "hi"), [(0, 1), (-3.2, 17), (12.01, 12.02), (1e-9, 5e-9), (99, 101), (0.05, 0.951), (-1, 5)]
)
def test_ticks_enclose_the_values_in_few_round_steps(lo, hi):
    found = ticks(lo, hi)
    step = found[1] - found[0]
    assert found[0] <= lo + 1e-6 * step and found[-1] >= hi - 1e-6 * step and 3 <= len(found) <= 6
    assert f"{step:.6e}"[0] in "125"


def test_log_ticks_are_powers_of_ten_that_enclose_the_values():
    assert log_ticks(0.02, 3.0) == pytest.approx([0.01, 0.1, 1, 10])
    assert len(log_ticks(1e-30, 1e30)) <= 8 and log_ticks(1e-30, 1e30)[-1] >= 1e30


def test_thin_keeps_every_spike():
    points = [(float(i), math.sin(i / 500)) for i in range(20000)]
    points[12345] = (12345.0, 50.0)
    kept = thin(points)
    assert len(kept) <= MOST_POINTS + 4 and points[12345] in kept
    assert kept[0] == points[0] and kept[-1] == points[-1] and kept == sorted(kept)


def test_labels_are_short():
    assert [label(v) for v in (0.0, 0.25, -3.0, 1000.0)] == ["0", "0.25", "−3", "1000"]
    assert re.sub("<[^>]+>", "^", label(1e-5)) == "10^−5^" and re.sub("<[^>]+>", "^", label(2.5e7)) == "2.5·10^7^"
