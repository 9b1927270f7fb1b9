"""Pictures of tables and of curves, with nothing but Pillow.

Its own font knows no Greek: labels are ASCII. Colours are those of Okabe and Ito (2008), told apart by everybody.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

GREEN, YELLOW, BLUE, RED = "#009E73", "#F0E442", "#56B4E9", "#D55E00"
LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
INK, PALE, PAPER = "#222222", "#D8D8D8", "#FFFFFF"
SCALE = 2
"""Pixels a unit: pictures are sharp where a page shows them at half their size."""


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size * SCALE)


class Sheet:
    """A white picture in units of two pixels."""

    def __init__(self, width: float, height: float):
        self.image = Image.new("RGB", (math.ceil(width * SCALE), math.ceil(height * SCALE)), PAPER)
        self._draw = ImageDraw.Draw(self.image)

    def text(self, x: float, y: float, words: str, *, size: int = 12, anchor: str = "lm", color: str = INK) -> None:
        """Words at a place; ``anchor`` as Pillow has it."""
        self._draw.text((x * SCALE, y * SCALE), words, fill=color, font=_font(size), anchor=anchor)

    def upward(self, x: float, y: float, words: str, size: int = 12) -> None:
        """Words that read upwards, centred at a place."""
        left, top, right, bottom = self._draw.textbbox((0, 0), words, font=_font(size))
        strip = Image.new("RGB", (math.ceil(right - left) + 4, math.ceil(bottom - top) + 4), PAPER)
        ImageDraw.Draw(strip).text((2 - left, 2 - top), words, fill=INK, font=_font(size))
        strip = strip.rotate(90, expand=True)
        self.image.paste(strip, (round(x * SCALE - strip.width / 2), round(y * SCALE - strip.height / 2)))

    def box(self, x: float, y: float, w: float, h: float, fill: str, edge: str | None = PAPER) -> None:
        """A rectangle."""
        corners = [x * SCALE, y * SCALE, (x + w) * SCALE, (y + h) * SCALE]
        self._draw.rectangle(corners, fill=fill, outline=edge, width=SCALE)

    def line(self, points: Sequence[tuple[float, float]], color: str, width: float = 2.0, dash: float = 0.0) -> None:
        """A polygon line, dashed if ``dash`` is a length."""
        for (x0, y0), (x1, y1) in itertools.pairwise(points):
            length = math.hypot(x1 - x0, y1 - y0)
            pieces = [(0.0, 1.0)]
            if dash and length:
                n = max(1, round(length / (2 * dash)))
                pieces = [(k / n, (k + 0.5) / n) for k in range(n)]
            for a, b in pieces:
                ends = [x0 + a * (x1 - x0), y0 + a * (y1 - y0), x0 + b * (x1 - x0), y0 + b * (y1 - y0)]
                self._draw.line([e * SCALE for e in ends], fill=color, width=round(width * SCALE))

    def mark(self, x: float, y: float, color: str, kind: int = 0, size: float = 4.0) -> None:
        """A disc, square, triangle or diamond."""
        s, shapes = size, ([], [(-1, -1), (1, -1), (1, 1), (-1, 1)], [(0, -1.2), (1.1, 0.9), (-1.1, 0.9)],
                           [(0, -1.3), (1.3, 0), (0, 1.3), (-1.3, 0)])  # fmt: skip
        corners = shapes[kind % len(shapes)]
        if not corners:
            self._draw.ellipse([(x - s) * SCALE, (y - s) * SCALE, (x + s) * SCALE, (y + s) * SCALE], fill=color)
        else:
            self._draw.polygon([((x + a * s) * SCALE, (y + b * s) * SCALE) for a, b in corners], fill=color)

    def save(self, path: Path) -> None:
        self.image.save(path, optimize=True)


@dataclass(frozen=True)
class Panel:
    """Columns of a table of coloured cells that belong together."""

    title: str
    columns: Sequence[str]
    cells: dict[tuple[str, str], tuple[str, str, str]]
    """(row, column) → colour, word in it, colour of the word."""


def table(
    path: Path, title: str, rows: Sequence[str], panels: Sequence[Panel], legend: Sequence[tuple[str, str]]
) -> None:
    """Panels side by side with the same rows; ``legend``: colours and what they mean."""
    cell_w, cell_h, gap, left, top = 48, 22, 22, 14 + 6.6 * max(map(len, rows)), 92
    width = left + sum(cell_w * len(p.columns) + gap for p in panels) + 10
    sheet = Sheet(max(width, 720), top + cell_h * len(rows) + 16)
    sheet.text(12, 18, title, size=16)
    x = 12.0
    for color, words in legend:
        sheet.box(x, 36, 16, 14, color)
        sheet.text(x + 22, 43, words, size=12)
        x += 48 + 6.3 * len(words)
    for k, row in enumerate(rows):
        sheet.text(left - 8, top + cell_h * (k + 0.5), row, size=12, anchor="rm")
    x = left
    for panel in panels:
        sheet.text(x, 66, panel.title, size=13)
        for j, column in enumerate(panel.columns):
            sheet.text(x + cell_w * (j + 0.5), 83, column, size=11, anchor="mm")
            for k, row in enumerate(rows):
                color, word, ink = panel.cells.get((row, column), (PALE, "", INK))
                sheet.box(x + cell_w * j, top + cell_h * k, cell_w, cell_h, color)
                sheet.text(x + cell_w * (j + 0.5), top + cell_h * (k + 0.5), word, size=11, anchor="mm", color=ink)
        x += cell_w * len(panel.columns) + gap
    sheet.save(path)


@dataclass(frozen=True)
class Curve:
    """Points of one name; those that are not finite or not positive are left out."""

    name: str
    points: Sequence[tuple[float, float]]
    color: int = 0
    """Place in ``LINES``, and kind of mark."""
    dashed: bool = False


@dataclass(frozen=True)
class Plot:
    """Curves on two logarithmic axes."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]


def plots(path: Path, title: str, several: Sequence[Plot], across: int = 2) -> None:
    """Log–log plots beside and below each other, each with its legend under it."""
    w, h, legend = 430.0, 300.0, 18.0
    deep = max(len(p.curves) for p in several)
    high = h + legend * math.ceil(deep / 2) + 74
    rows = math.ceil(len(several) / across)
    sheet = Sheet(across * (w + 20) + 10, 34 + rows * high)
    sheet.text(12, 18, title, size=16)
    for k, plot in enumerate(several):
        _plot(sheet, plot, 10 + (k % across) * (w + 20), 34 + (k // across) * high, w, h)
    sheet.save(path)


def _plot(sheet: Sheet, plot: Plot, x0: float, y0: float, w: float, h: float) -> None:
    left, top = x0 + 72, y0 + 34
    w -= 80
    points = [p for c in plot.curves for p in c.points if _drawn(p)]
    xs, ys = _decades([p[0] for p in points]), _decades([p[1] for p in points])

    def place(p: tuple[float, float]) -> tuple[float, float]:
        a = (math.log10(p[0]) - xs[0]) / (xs[1] - xs[0])
        return left + a * w, top + h - (math.log10(p[1]) - ys[0]) / (ys[1] - ys[0]) * h

    sheet.text(x0 + 8, y0 + 16, plot.title, size=14)
    for k in _ticks(*ys):
        _, y = place((10.0 ** xs[0], 10.0**k))
        sheet.line([(left, y), (left + w, y)], PALE, 1)
        sheet.text(left - 6, y, f"1e{k}", size=11, anchor="rm")
    for k in _ticks(*xs):
        x, _ = place((10.0**k, 10.0 ** ys[0]))
        sheet.line([(x, top), (x, top + h)], PALE, 1)
        sheet.text(x, top + h + 12, f"1e{k}", size=11, anchor="mm")
    sheet.text(left + w / 2, top + h + 30, plot.x, size=12, anchor="mm")
    sheet.upward(x0 + 14, top + h / 2, plot.y)
    for c in plot.curves:
        color, there = LINES[c.color % len(LINES)], [place(p) for p in c.points if _drawn(p)]
        sheet.line(there, color, 2, 5.0 if c.dashed else 0.0)
        for x, y in there:
            sheet.mark(x, y, color, c.color)
    for k, c in enumerate(plot.curves):
        x, y = left + (k % 2) * w / 2, top + h + 50 + 18 * (k // 2)
        color = LINES[c.color % len(LINES)]
        sheet.line([(x, y), (x + 26, y)], color, 2, 5.0 if c.dashed else 0.0)
        sheet.mark(x + 13, y, color, c.color)
        sheet.text(x + 32, y, c.name, size=11)


def _drawn(p: tuple[float, float]) -> bool:
    return all(math.isfinite(v) and v > 0 for v in p)


def _decades(values: Sequence[float]) -> tuple[int, int]:
    """Powers of ten that enclose the values."""
    low, high = (math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))) if values else (0, 1)
    return low, max(high, low + 1)


def _ticks(low: int, high: int) -> range:
    return range(low, high + 1, max(1, math.ceil((high - low) / 8)))
