"""Error against work as SVG: two logarithmic axes, a line a series, the front behind them, a legend beside.

No plotting library: browsers and GitHub show the file as it is, and it changes only where numbers do.
"""

import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.work_precision.analysis import Point, front
from benchmarks.work_precision.rows import Row

PANEL, GAP, HEIGHT = 470, 74, 470
"""Width of a panel, room between them for labels, height [px]."""
LEFT, TOP, BOTTOM, LEGEND = 74, 64, 58, 250
"""Margins, and the width of the legend [px]."""
INK, FAINT, FRONT = "#1f2328", "#d0d7de", "#f2c94c"

LOOKS = {
    "default": ("#0b57d0", "circle", 2.6),
    "plain MLS": ("#d9480f", "square", 1.6),
    "plain APIC": ("#b02a37", "square", 1.6),
    "plain MLS, CFL 0.7": ("#f59f6a", "square", 1.2),
    "plain APIC, CFL 0.7": ("#e08a93", "square", 1.2),
    "elastic contact": ("#6f42c1", "hexagon", 1.6),
    "no sharpening": ("#8a8f98", "down", 1.2),
    "no retention": ("#a9adb5", "down", 1.2),
    "no half kick": ("#5c626b", "down", 1.2),
    "no mirror": ("#3f444c", "down", 1.2),
    "cubic": ("#2b8a3e", "up", 1.6),
    "cubic, CFL 0.7": ("#69b578", "up", 1.2),
    "classic force": ("#99a81f", "diamond", 1.4),
    "cubic, classic force": ("#5c6b00", "diamond", 1.4),
    "CFL 0.05": ("#a5d8ff", "ring", 1.0),
    "CFL 0.1": ("#8bc6f7", "ring", 1.0),
    "CFL 0.2": ("#6cb0ee", "ring", 1.0),
    "CFL 0.6": ("#3d8ae0", "ring", 1.0),
    "CFL 0.7": ("#1971c2", "ring", 1.2),
    "float64": ("#0ca678", "ring", 1.4),
    "1.5³ a cell": ("#c2255c", "cross", 1.2),
    "3³ a cell": ("#e64980", "cross", 1.2),
    "Taichi MLS-MPM": ("#000000", "star", 1.6),
    "SVD a particle, stand-in": ("#7a4b12", "star", 1.6),
    "Newton implicit, CFL 2": ("#a87d1c", "star", 1.2),
    "Newton implicit, CFL 8": ("#86620f", "star", 1.2),
}
"""Colour, mark and width of the line of every series; one colour family an axis of the sweep."""
OTHERS = ("#0ca678", "#d9480f", "#6f42c1", "#2b8a3e", "#c2255c", "#99a81f", "#5c626b", "#7a4b12", "#8bc6f7", "#000000")
"""Colours of series that have no look of their own, in turn."""


@dataclass(frozen=True)
class Axis:
    """What is on a horizontal axis."""

    label: str
    value: Callable[[Row], float]
    spread: Callable[[Row], tuple[float, float]] | None = None
    """Ends of the bar of a point."""


SECONDS = Axis("processor time [s]", lambda r: r.seconds, lambda r: (r.low, r.high))
WORK = Axis("particle-substeps", lambda r: r.work)
MEMORY = Axis("memory of the backward pass [MB]", lambda r: r.megabytes or math.nan)


def figure(
    title: str, norm: str, note: str, rows: Sequence[Row], axes: Sequence[Axis], floor: float | None = None
) -> str:
    """The SVG of one case.

    Args:
        norm: label of the vertical axis.
        note: what stands under the title: machine and noise.
        floor: error to which the reference is known.
    """
    rows = [r for r in rows if math.isfinite(r.error) and r.error > 0]
    series = list(dict.fromkeys(r.series for r in rows))
    looks = {s: LOOKS.get(s) or (OTHERS[i % len(OTHERS)], "circle", 1.4) for i, s in enumerate(series)}
    width = LEFT + len(axes) * PANEL + (len(axes) - 1) * GAP + LEGEND
    y = Scale([r.error for r in rows], HEIGHT - BOTTOM, TOP)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {HEIGHT}" width="{width}" height="{HEIGHT}" '
        'font-family="system-ui, sans-serif" font-size="12">',
        f'<rect width="{width}" height="{HEIGHT}" fill="#ffffff"/>',
        text(LEFT, 24, title, size=17, weight=600),
        text(LEFT, 44, note, fill="#57606a"),
    ]
    for k, axis in enumerate(axes):
        left = LEFT + k * (PANEL + GAP)
        x = Scale([axis.value(r) for r in rows], left, left + PANEL)
        parts += frame(x, y, left, axis.label, norm if k == 0 else "")
        if floor is not None and y.end < y(floor) < y.start:
            parts += [
                line(left, y(floor), left + PANEL, y(floor), INK, 1.2, 0.6, "6 4"),
                text(left + PANEL - 6, y(floor) + 15, "reference known to this", anchor="end", fill="#57606a"),
            ]
        parts.append(step(front([Point(r.series, axis.value(r), r.error) for r in rows]), x, y))
        for s in reversed(series):  # the default on top
            parts += curve([r for r in rows if r.series == s], axis, x, y, looks[s])
    parts += legend(series, looks, width - LEGEND + 22)
    return "\n".join([*parts, "</svg>"]) + "\n"


class Scale:
    """A logarithmic axis that holds some values with room at both ends."""

    def __init__(self, values: Sequence[float], start: float, end: float):
        kept = [math.log10(v) for v in values if math.isfinite(v) and v > 0]
        room = 0.06 * max(max(kept) - min(kept), 0.5)
        self.low, self.high, self.start, self.end = min(kept) - room, max(kept) + room, start, end

    def __call__(self, value: float) -> float:
        return self.start + (math.log10(value) - self.low) / (self.high - self.low) * (self.end - self.start)

    def ticks(self) -> list[tuple[float, bool]]:
        """Values of grid lines, and whether they are labelled: powers of ten, and 2 and 5 of them on short axes."""
        span, found = self.high - self.low, []
        for p in range(math.floor(self.low), math.ceil(self.high) + 1):
            for m in (1, 2, 5):
                if self.low <= p + math.log10(m) <= self.high and (m == 1 or span < 3):
                    found.append((m * 10.0**p, m == 1 or span < 1.7))
        return found


def frame(x: Scale, y: Scale, left: float, label: str, norm: str) -> list[str]:
    """Grid, ticks and labels of a panel."""
    right, bottom, parts = left + PANEL, HEIGHT - BOTTOM, []
    for v, named in x.ticks():
        parts.append(line(x(v), TOP, x(v), bottom, FAINT, 1 if named else 0.5))
        parts += [text(x(v), bottom + 17, number(v), anchor="middle")] * named
    for v, named in y.ticks():
        parts.append(line(left, y(v), right, y(v), FAINT, 1 if named else 0.5))
        parts += [text(left - 7, y(v) + 4, number(v), anchor="end")] * named
    parts.append(
        f'<rect x="{left}" y="{TOP}" width="{PANEL}" height="{bottom - TOP}" fill="none" stroke="{INK}"/>'
        f"{text(left + PANEL / 2, bottom + 40, label, anchor='middle', size=13)}"
    )
    if norm:
        middle = (TOP + bottom) / 2
        parts.append(
            f'<text x="20" y="{middle}" transform="rotate(-90 20 {middle})" text-anchor="middle" font-size="13" '
            f'fill="{INK}">{html.escape(norm)}</text>'
        )
    return parts


def step(points: Sequence[Point], x: Scale, y: Scale) -> str:
    """The front: nothing measured lies to the lower left of it."""
    path = ""
    for a, b in zip(points, [*points[1:], None], strict=True):
        path += f"{'M' if not path else 'L'}{x(a.work):.1f} {y(a.error):.1f}"
        if b is not None:
            path += f"L{x(b.work):.1f} {y(a.error):.1f}"
    return f'<path d="{path}" fill="none" stroke="{FRONT}" stroke-width="9" stroke-linejoin="round" opacity="0.55"/>'


def curve(rows: Sequence[Row], axis: Axis, x: Scale, y: Scale, look: tuple[str, str, float]) -> list[str]:
    """A series: a line through its resolutions, marks, and bars between quartiles."""
    colour, shape, thick = look
    at = [(x(axis.value(r)), y(r.error)) for r in rows if math.isfinite(axis.value(r))]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in at)
    parts = [f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{thick}" opacity="0.85"/>']
    for r, (a, b) in zip(rows, at, strict=False):
        if axis.spread is not None:
            low, high = (x(max(v, 1e-9)) for v in axis.spread(r))
            parts += [line(low, b, high, b, colour, 1.2)] * (high - low > 2)
        parts.append(mark(a, b, shape, colour, 5.0 if thick > 2 else 3.6))
    return parts


SIDES = {"square": (4, 45), "diamond": (4, 0), "up": (3, -90), "down": (3, 90), "hexagon": (6, 0)}
"""Corners of a mark, and where the first one is [°]."""


def mark(x: float, y: float, shape: str, colour: str, r: float) -> str:
    """One point."""
    if shape in ("circle", "ring"):
        fill, stroke = (colour, "#ffffff") if shape == "circle" else ("#ffffff", colour)
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r}" fill="{fill}" stroke="{stroke}" stroke-width="1.3"/>'
    if shape in ("cross", "star"):
        angles = (45, 135) if shape == "cross" else (0, 60, 120)
        return "".join(
            line(
                x - r * math.cos(math.radians(a)), y - r * math.sin(math.radians(a)), x + r * math.cos(math.radians(a)),
                y + r * math.sin(math.radians(a)), colour, 1.8,
            )
            for a in angles
        )  # fmt: skip
    n, first = SIDES[shape]
    corners = [math.radians(first + 360 * i / n) for i in range(n)]
    points = " ".join(f"{x + 1.2 * r * math.cos(a):.1f},{y + 1.2 * r * math.sin(a):.1f}" for a in corners)
    return f'<polygon points="{points}" fill="{colour}" stroke="#ffffff" stroke-width="0.8"/>'


def legend(series: Sequence[str], looks: dict[str, tuple[str, str, float]], left: float) -> list[str]:
    """A line a series, and the front."""
    height = min(19.0, (HEIGHT - TOP - 20) / (len(series) + 1))
    parts = []
    for i, s in enumerate(series):
        y = TOP + 8 + i * height
        colour, shape, thick = looks[s]
        parts += [line(left, y, left + 26, y, colour, thick), mark(left + 13, y, shape, colour, 4)]
        parts.append(text(left + 34, y + 4, s))
    y = TOP + 8 + len(series) * height
    parts += [line(left, y, left + 26, y, FRONT, 9, 0.55), text(left + 34, y + 4, "front")]
    return parts


def line(
    x1: float, y1: float, x2: float, y2: float, colour: str, width: float, opacity: float = 1.0, dash: str = ""
) -> str:
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width}" opacity="{opacity:g}" stroke-dasharray="{dash}"/>'


def text(
    x: float, y: float, words: str, *, anchor: str = "start", size: int = 12, weight: int = 400, fill: str = INK
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}" font-weight="{weight}" '
        f'fill="{fill}">{words if "<tspan" in words else html.escape(words)}</text>'
    )


def number(v: float) -> str:
    """A tick: 0.01 … 999 as they are, others as a digit and a power of ten."""
    if 0.01 <= v < 1000:
        return f"{v:g}"
    power = math.floor(math.log10(v) + 1e-9)
    digit = round(v / 10.0**power)
    head = "" if digit == 1 else f"{digit}·"
    exponent = f"{power}".replace("-", "−")
    return f'{head}10<tspan dy="-5" font-size="9">{exponent}</tspan>'
