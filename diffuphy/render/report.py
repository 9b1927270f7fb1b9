"""The page one shows: film, pictures, curves, numbers and settings of a run in a single HTML file.

Nothing is fetched and nothing runs: pictures and film are inside the file, curves are SVG, there is no script, and the
page forbids itself every request by its content security policy.
"""

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diffuphy.render.page import PAGE, STYLE
from diffuphy.render.plot import line_plot

FILM_TYPES = {".mp4": "video/mp4", ".webm": "video/webm", ".gif": "image/gif"}
"""Films a browser plays, by suffix."""

COLORS = 7
"""Colours of the time bar, classes s0 to s6 of the style."""


@dataclass(frozen=True)
class Section:
    """Numbers, curves with bands and sentences under one title."""

    title: str
    numbers: Sequence[tuple[str, Any, str]] = ()
    """(name, value, what it means)."""
    curves: Sequence[tuple[str, Sequence[tuple[float, float]], Sequence[tuple[float, float, float]]]] = ()
    """(name, (time, value), (time, lower, upper)), times in seconds."""
    words: Sequence[str] = ()
    """Sentences."""


@dataclass(frozen=True)
class Report:
    """Writes ``report.html``; the settings say how large the pictures in it may be."""

    max_side: int = 1600
    """Longest side of a picture [px]; larger ones are reduced, or a contact sheet alone would make the page heavy."""
    heading: str = "diffuphy"
    """Small line above the title."""

    def __post_init__(self) -> None:
        if self.max_side < 16:
            raise ValueError(f"report.max_side must be at least 16 px, got {self.max_side}")

    def __call__(
        self,
        path: Path,
        *,
        title: str,
        film: Path | None = None,
        sheet: Any = None,
        views: Sequence[tuple[str, Any]] = (),
        maps: Sequence[tuple[str, Any]] = (),
        curves: Mapping[str, Sequence[tuple[float, float]]] | None = None,
        plan: Sequence[tuple[str, str, str]] = (),
        settings: str = "",
        stages: Sequence[Mapping[str, Any]] = (),
        numbers: Sequence[tuple[str, Any, str]] = (),
        warnings: Sequence[str] = (),
        sections: Sequence[Section] = (),
    ) -> Path:
        """Write the page; what is empty has no section.

        Args:
            path: file to write; replaced as a whole or not at all.
            title: the prompt.
            film: an mp4, webm or gif.
            sheet: contact sheet, floats in [0, 1] or bytes, shape (H, W, 3) or (H, W).
            views: the object from several sides, (caption, picture).
            maps: material maps, (caption, picture).
            curves: metric → (step, value) in order of steps.
            plan: (what, decision, why) for each line of the plan.
            settings: the composed configuration, YAML.
            stages: one row a stage, its name first; the keys are the columns, ``seconds`` also make a bar.
            numbers: (name, value, what it means).
            warnings: sentences a reader must see.
            sections: what else there is to say, before time and memory.

        Returns:
            ``path``.

        Raises:
            ValueError: for a picture of another shape or range, or a film of another type.
        """
        pictures = [("contact sheet", sheet)] if sheet is not None else []
        body = [
            _warnings(warnings),
            _hero(film, title, numbers),
            _section("Film, frame by frame", self._gallery(pictures, "wide")),
            _section("The object", self._gallery(views, "tiles")),
            _section("What it is made of", self._gallery(maps, "tiles large")),
            _section("Curves", _curves(curves or {})),
            _section("The plan", _table(("what", "decision", "why"), plan, "plan")),
            *map(_own, sections),
            _section("Time and memory", _stages(stages)),
            _section("Settings", _settings(settings)),
        ]
        content = "\n".join(filter(None, body))
        page = PAGE.format(title=_text(title), heading=_text(self.heading), style=STYLE, body=content)
        temporary = path.with_name(path.name + ".tmp")
        temporary.write_text(page, encoding="utf-8")
        temporary.replace(path)
        return path

    def _gallery(self, pictures: Sequence[tuple[str, Any]], kind: str) -> str:
        figures = "".join(
            f'<figure><img src="{self._png(caption, image)}" alt="{_text(caption)}">'
            f"<figcaption>{_text(caption)}</figcaption></figure>"
            for caption, image in pictures
        )
        return f'<div class="{kind}">{figures}</div>' if figures else ""

    def _png(self, caption: str, image: Any) -> str:
        """Data URI of a picture."""
        from PIL import Image

        picture = Image.fromarray(_bytes(caption, image))
        picture.thumbnail((self.max_side, self.max_side), Image.Resampling.BOX)
        buffer = io.BytesIO()
        picture.save(buffer, "PNG", optimize=True)
        return _data("image/png", buffer.getvalue())


def _text(value: Any) -> str:
    return html.escape(str(value), quote=True)


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _bytes(caption: str, image: Any) -> np.ndarray:
    """A picture as bytes, from floats in [0, 1] or bytes, a tensor or an array."""
    array = np.asarray(image.detach().cpu() if hasattr(image, "detach") else image)
    if not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)) or array.size == 0:
        raise ValueError(f"picture {caption!r} must be (H, W, 3) or (H, W), got {array.shape}")
    if array.dtype == np.uint8:
        return array
    low, high = float(array.min()), float(array.max())
    if not (low >= -1e-3 and high <= 1 + 1e-3):  # interpolation may overshoot by rounding; NaN fails both
        raise ValueError(f"picture {caption!r} must have values in [0, 1], got {low:g} to {high:g}; scale it first")
    return (array.clip(0, 1) * 255).round().astype(np.uint8)


def _number(value: Any) -> str:
    """Four significant digits for floats, powers of ten as one reads them."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float | np.floating):
        return _text("" if value is None else value)
    if value and math.isfinite(value) and not 1e-3 <= abs(value) < 1e5:
        digits, power = f"{value:.2e}".split("e")
        return f"{digits}&#8239;·&#8239;10<sup>{int(power)}</sup>".replace("-", "−")
    return f"{value:.4g}".replace("-", "−")


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>{content}</section>" if content else ""


def _warnings(warnings: Sequence[str]) -> str:
    items = "".join(f"<li>{_text(w)}</li>" for w in warnings)
    return (
        f'<aside role="note" aria-label="Warnings"><strong>Please note</strong><ul>{items}</ul></aside>'
        if items
        else ""
    )


def _hero(film: Path | None, title: str, numbers: Sequence[tuple[str, Any, str]]) -> str:
    """Film beside the numbers that say how good it is."""
    left = ""
    if film is not None:
        if film.suffix.lower() not in FILM_TYPES:
            raise ValueError(f"film must be one of {sorted(FILM_TYPES)}, got {film.name!r}; encode it as mp4")
        kind = FILM_TYPES[film.suffix.lower()]
        source = _data(kind, film.read_bytes())
        if kind.startswith("image"):
            left = f'<img src="{source}" alt="Film: {_text(title)}">'
        else:
            name = f'aria-label="Film: {_text(title)}"'
            left = f'<video src="{source}" {name} controls autoplay loop muted playsinline></video>'
        left = f'<div class="film">{left}</div>'
    right = _numbers(numbers)
    return f'<div class="hero">{left}{right}</div>' if left or right else ""


def _numbers(numbers: Sequence[tuple[str, Any, str]]) -> str:
    rows = "".join(
        f"<div><dt>{_text(name.replace('_', ' '))}</dt><dd>{_number(value)}</dd>"
        f'<dd class="note">{_text(note)}</dd></div>'
        for name, value, note in numbers
    )
    return f'<dl class="numbers">{rows}</dl>' if rows else ""


def _own(section: Section) -> str:
    plots = "".join(
        f"<figure>{line_plot(name, points, band=band, axis='time [s]')}</figure>"
        for name, points, band in section.curves
    )
    plots = f'<div class="plots">{plots}</div>' if plots else ""
    words = "".join(f'<p class="says">{_text(sentence)}</p>' for sentence in section.words)
    return _section(_text(section.title), _numbers(section.numbers) + plots + words)


def _curves(curves: Mapping[str, Sequence[tuple[float, float]]]) -> str:
    plots = "".join(f"<figure>{line_plot(name, points)}</figure>" for name, points in curves.items() if len(points))
    return f'<div class="plots">{plots}</div>' if plots else ""


def _cell(tag: str, content: str, number: bool = False) -> str:
    scope, place = ' scope="col"' if tag == "th" else "", ' class="num"' if number else ""
    return f"<{tag}{scope}{place}>{content}</{tag}>"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]], kind: str, keyed: bool = False) -> str:
    """A column with a number in it is set flush right; ``keyed`` rows carry the colour of their part of the bar."""
    if not rows:
        return ""
    columns = [[row[i] for row in rows] for i in range(len(head))]
    numeric = [any(isinstance(c, float | int) and not isinstance(c, bool) for c in column) for column in columns]
    titles = "".join(_cell("th", _text(h), n) for h, n in zip(head, numeric, strict=True))
    lines = []
    for i, row in enumerate(rows):
        cells = [_number(c) for c in row]
        if keyed:
            cells[0] = f'<span class="key s{i % COLORS}"></span>{cells[0]}'
        lines.append(f"<tr>{''.join(map(_cell, ['td'] * len(cells), cells, numeric))}</tr>")
    body = f"<thead><tr>{titles}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="scroll"><table class="{kind}">{body}</table></div>'


def _stages(stages: Sequence[Mapping[str, Any]]) -> str:
    """Stage rows, and how the seconds divide among them."""
    keys = list(dict.fromkeys(k for row in stages for k in row))
    names = [str(next(iter(row.values()), "")) for row in stages]
    seconds = [float(row.get("seconds") or 0) for row in stages]
    bar = ""
    if total := sum(seconds):
        parts = zip(names, seconds, strict=True)
        segments = "".join(
            f'<span style="flex-grow:{s:.4f}" class="s{i % COLORS}" title="{_text(name)}: {s:.3g} s"></span>'
            for i, (name, s) in enumerate(parts)
        )
        spoken = _text(", ".join(f"{name} {s / total:.0%}" for name, s in zip(names, seconds, strict=True)))
        bar = f'<div class="bar" role="img" aria-label="Share of {total:.3g} seconds: {spoken}">{segments}</div>'
    rows = [[row.get(k) for k in keys] for row in stages]
    return bar + _table([k.replace("_", " ") for k in keys], rows, "stages", keyed=bool(bar))


def _settings(settings: str) -> str:
    summary = "<summary>every effective setting, defaults included</summary>"
    return f"<details>{summary}<pre>{_text(settings)}</pre></details>" if settings else ""
