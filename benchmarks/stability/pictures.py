"""The map as pictures: colour and letter say what became of a cell."""

from pathlib import Path

from benchmarks._draw import BLUE, GREEN, INK, PAPER, RED, YELLOW, Panel, table
from benchmarks.stability import courant, design
from benchmarks.stability.verdict import KINDS, Kind

COLORS: dict[Kind, str] = {"stable": GREEN, "drift": YELLOW, "error": BLUE, "silent": RED}
LETTERS: dict[Kind, str] = {"stable": "", "drift": "d", "error": "E", "silent": "S"}
WORDS = {
    "stable": "stable",
    "drift": "d: drift, stays within the second bound",
    "error": "E: error with a message",
    "silent": "S: silent, wrong without an error",
}
TITLES = {
    "E": "E [Pa]",
    "nu": "Poisson's ratio",
    "speed": "speed of impact [c]",
    "cfl": "CFL",
    "yields": "yield stress [E]",
}


def short(value: float) -> str:
    """A coordinate in as few characters as say it."""
    if value and not 1e-3 <= value < 1e4:
        return f"{value:.0e}".replace("e+", "e").replace("e0", "e").replace("e-0", "e-")
    return f"{value:g}"


def draw_map(path: Path, cells: list[dict]) -> None:
    """Lines through the centre: a row for every matter and precision, a panel for every coordinate."""
    matters = list(dict.fromkeys(r["matter"] for r in cells))
    rows = [f"{m}, {p[5:]}" for m in matters for p in ("float64", "float32")]
    panels = []
    for axis, values in design.AXES.items():
        found = {}
        for r in (r for r in cells if r["place"] == axis):
            kind: Kind = r["verdict"]
            found[f"{r['matter']}, {r['precision'][5:]}", short(r[axis])] = (COLORS[kind], LETTERS[kind], ink(kind))
        panels.append(Panel(TITLES[axis], [short(v) for v in values], found))
    title = "Impact of a small body: lines through E = 1e5 Pa, nu = 0.3, 0.1 c, CFL 0.4, yield stress 0.01 E"
    table(path, title, rows, panels, [(COLORS[k], WORDS[k]) for k in KINDS])


def draw_corners(path: Path, cells: list[dict]) -> None:
    """Every combination of extreme values."""
    matters = list(dict.fromkeys(r["matter"] for r in cells))
    rows = [f"{m}, {p[5:]}" for m in matters for p in ("float64", "float32")]
    panels = []
    for E in design.CORNERS["E"]:
        for nu in design.CORNERS["nu"]:
            found, columns = {}, []
            for speed in design.CORNERS["speed"]:
                for cfl in design.CORNERS["cfl"]:
                    columns.append(f"{speed:g}c {cfl:g}")
            for r in cells:
                if r["place"] == "corner" and r["E"] == E and r["nu"] == nu:
                    kind: Kind = r["verdict"]
                    where = f"{r['matter']}, {r['precision'][5:]}", f"{r['speed']:g}c {r['cfl']:g}"
                    found[where] = (COLORS[kind], LETTERS[kind], ink(kind))
            panels.append(Panel(f"E = {short(E)} Pa, nu = {nu:g}", columns, found))
    title = "Corners of the map: columns are speed of impact and CFL"
    table(path, title, rows, panels, [(COLORS[k], WORDS[k]) for k in KINDS])


def draw_courant(path: Path, rows: list[dict]) -> None:
    """Largest stable steps, coloured by whether the limit of the clock lies below."""
    matters, nus = (list(dict.fromkeys(r[k] for r in rows)) for k in ("matter", "nu"))
    panels = []
    for alone, title in ((False, "a body"), (True, "a particle alone")):
        found = {}
        for r in (r for r in rows if r["alone"] == alone):
            holds, chosen = r["largest"] >= courant.STABLE, r["largest"] >= courant.CHOSEN
            kind: Kind = "stable" if holds else "drift" if chosen else "silent"
            word = f"> {courant.HIGH:g}" if r["largest"] >= courant.HIGH else f"{r['largest']:.2f}"
            found[r["matter"], f"nu {r['nu']:g}"] = (COLORS[kind], word, ink(kind))
        panels.append(Panel(title, [f"nu {nu:g}" for nu in nus], found))
    legend = [
        (GREEN, f"at least {courant.STABLE}, beyond which a pinned step is refused"),
        (YELLOW, f"at least {courant.CHOSEN}, which the clock takes"),
        (RED, "less"),
    ]
    table(path, "Largest stable c dt/dx", matters, panels, legend)


def ink(kind: Kind) -> str:
    """Letters that stand out on a colour."""
    return PAPER if kind in ("silent", "stable") else INK
