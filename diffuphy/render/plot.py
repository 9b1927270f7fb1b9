"""A line plot as SVG text, small enough to read and without a plotting library."""

import html
import math
from collections.abc import Sequence

WIDTH, HEIGHT = 420, 230
"""Size of a plot in its own units; the page scales it."""
LEFT, RIGHT, TOP, BOTTOM = 58, 12, 30, 34
"""Margins for the labels."""
DECADES = 1.5
"""Positive values that span more than this many decades are drawn on a logarithmic axis."""
MOST_POINTS = 600
"""Points drawn of one curve; of more, the least and the greatest of every stretch, so no spike is lost."""


def line_plot(
    name: str,
    points: Sequence[tuple[float, float]],
    *,
    band: Sequence[tuple[float, float, float]] = (),
    axis: str = "step",
) -> str:
    """One curve with its axes; the value axis is logarithmic where the values ask for it, and linear with a band.

    Values that are not finite leave a gap, and the plot says how many there are.

    Args:
        name: what is plotted.
        points: (step, value) in order of steps, at least one.
        band: (step, lower, upper) in order of steps, all finite: shaded behind the curve.
        axis: what a step is.
    """
    if not points:
        raise ValueError(f"curve {name!r} has no points; leave it out")
    finite = [(float(s), float(v)) for s, v in points if math.isfinite(v)]
    missing = len(points) - len(finite)
    if not finite:
        none = f"none of {missing} values is finite"
        return _frame(name, f"{name}: {none}", "", none, axis)
    values = [v for _, v in finite] + [v for _, *ends in band for v in ends]
    log = not band and min(values) > 0 and math.log10(max(values) / min(values)) > DECADES
    y_ticks = log_ticks(min(values), max(values)) if log else ticks(min(values), max(values))
    x_ticks = ticks(float(points[0][0]), float(points[-1][0]), 6)
    scale = math.log10 if log else float
    x_lo, x_hi = float(points[0][0]), max(float(points[-1][0]), float(points[0][0]) + 1e-9)
    y_lo, y_hi = scale(min(*values, y_ticks[0])), scale(max(*values, y_ticks[-1]))

    def px(s: float) -> float:
        return LEFT + (s - x_lo) / (x_hi - x_lo) * (WIDTH - LEFT - RIGHT)

    def py(v: float) -> float:
        return HEIGHT - BOTTOM - (scale(v) - y_lo) / (y_hi - y_lo) * (HEIGHT - TOP - BOTTOM)

    parts = [
        f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{py(t):.1f}" y2="{py(t):.1f}"/>'
        f'<text x="{LEFT - 7}" y="{py(t) + 4:.1f}" text-anchor="end">{label(t)}</text>'
        for t in y_ticks
    ]
    parts += [
        f'<text x="{px(t):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{label(t)}</text>'
        for t in x_ticks
        if x_lo <= t <= x_hi
    ]
    if band:
        edge = [(s, hi) for s, _, hi in band] + [(s, lo) for s, lo, _ in reversed(band)]
        parts.append(f'<polygon class="band" points="{" ".join(f"{px(s):.1f},{py(v):.1f}" for s, v in edge)}"/>')
    for run in _runs(points):
        run = thin(run)
        if len(run) == 1:
            parts.append(f'<circle class="dot" cx="{px(run[0][0]):.1f}" cy="{py(run[0][1]):.1f}" r="2.5"/>')
        else:
            parts.append(f'<polyline class="curve" points="{" ".join(f"{px(s):.1f},{py(v):.1f}" for s, v in run)}"/>')
    last = finite[-1]
    parts.append(f'<circle class="dot" cx="{px(last[0]):.1f}" cy="{py(last[1]):.1f}" r="3.5"/>')
    gap = f", {missing} not finite" if missing else ""
    ends = " to ".join(f"{v:.4g} at {axis} {s:g}" for s, v in (finite[0], last))
    least = min(v for _, v in finite)
    return _frame(name, f"{name}: from {ends}, least {least:.4g}{gap}", "".join(parts), f"{last[1]:.4g}{gap}", axis)


def _frame(name: str, words: str, content: str, value: str, axis: str) -> str:
    words = html.escape(words)
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{words}"><title>{words}</title>'
        f'<text class="name" x="{LEFT}" y="18">{html.escape(name)}</text>'
        f'<text class="value" x="{WIDTH - RIGHT}" y="18" text-anchor="end">{html.escape(value)}</text>{content}'
        f'<text x="{WIDTH - RIGHT}" y="{HEIGHT - 3}" text-anchor="end">{html.escape(axis)}</text></svg>'
    )


def _runs(points: Sequence[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """Stretches of finite values."""
    runs: list[list[tuple[float, float]]] = [[]]
    for s, v in points:
        if math.isfinite(v):
            runs[-1].append((float(s), float(v)))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def thin(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """About ``MOST_POINTS`` of them: the first, the last, and the least and greatest of every stretch, in order."""
    if len(points) <= MOST_POINTS:
        return points
    size = math.ceil(2 * len(points) / MOST_POINTS)
    kept: list[tuple[float, float]] = [points[0]]
    for i in range(1, len(points) - 1, size):
        stretch = points[i : min(i + size, len(points) - 1)]
        kept += sorted({min(stretch, key=lambda p: p[1]), max(stretch, key=lambda p: p[1])})
    return [*kept, points[-1]]


def ticks(lo: float, hi: float, most: int = 5) -> list[float]:
    """Round numbers 1, 2 or 5 × 10ⁿ apart that enclose [lo, hi]; at most ``most`` steps."""
    if not hi > lo:
        pad = abs(lo) or 1.0
        lo, hi = lo - 0.1 * pad, lo + 0.1 * pad
    power = 10.0 ** math.floor(math.log10((hi - lo) / most))
    for multiple in (1, 2, 5, 10, 20):  # the ends rarely fall on ticks, so one or two steps more may be needed
        step = multiple * power
        first, last = math.floor(lo / step + 1e-9), math.ceil(hi / step - 1e-9)
        if last - first <= most:
            break
    return [i * step for i in range(first, last + 1)]


def log_ticks(lo: float, hi: float) -> list[float]:
    """Powers of ten that enclose [lo, hi], at most seven."""
    first, last = math.floor(math.log10(lo)), math.ceil(math.log10(hi))
    stride = math.ceil((last - first) / 6)
    return [10.0**p for p in range(first, last + stride, stride)]


def label(value: float) -> str:
    """A tick in as few characters as say it."""
    if value and not 1e-3 <= abs(value) < 1e5:
        digits, power = f"{value:.1e}".split("e")
        digits = digits.removesuffix(".0")
        head = "" if digits == "1" else f"{digits}·"
        return f'{head}10<tspan dy="-4" font-size="8">{int(power)}</tspan>'.replace("-", "−").replace('dy="−', 'dy="-')
    return f"{value:.6g}".replace("-", "−")
