"""The tables of a study: Markdown to read, CSV to work with."""

import csv
from pathlib import Path

import numpy as np

from benchmarks.study.design import CRITERIA, Refused
from benchmarks.study.ratings import Preference, Ratings
from benchmarks.study.statistics import bradley_terry, holm, interval, krippendorff, pigeonhole, sign_flip

AVERAGE = "average"


def report(ratings: Ratings, ours: str, out: Path | None = None) -> str:
    """Tables of opinion scores, of comparisons, and of agreement; written to ``out`` as study.md and CSV files too.

    Raises:
        Refused: ``ours`` is not one of the methods.
    """
    methods = sorted(
        {s.method for s in ratings.scores} | {m for p in ratings.preferences for m in p.methods},
        key=lambda m: (m != ours, m),
    )
    if ours not in methods:
        raise Refused(f"--ours {ours!r} is not one of {', '.join(methods)}")
    tables: dict[str, list[list[str]]] = {}
    if ratings.scores:
        tables["scores"] = opinion(ratings, methods)
    if ratings.preferences:
        tables["pairs"] = strengths(ratings, methods)
    parts = [f"# User study\n\n{_who(ratings)}"]
    parts += [f"## {TITLES[name]}\n\n{_markdown(rows)}\n\n{NOTES[name]}" for name, rows in tables.items()]
    text = "\n\n".join(parts) + "\n"
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "study.md").write_text(text, encoding="utf-8")
        for name, rows in tables.items():
            with (out / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
                csv.writer(file).writerows(rows)
    return text


def opinion(ratings: Ratings, methods: list[str]) -> list[list[str]]:
    """Mean opinion scores, their intervals, the difference of the first method to each other and its p."""
    people = ratings.participants
    prompts = sorted({s.prompt for s in ratings.scores})
    cube = np.full((len(people), len(prompts), len(methods), len(CRITERIA) + 1), np.nan)
    for s in ratings.scores:
        values = [s.value[c] for c in CRITERIA]
        cube[people.index(s.participant), prompts.index(s.prompt), methods.index(s.method)] = [*values, np.mean(values)]
    draws = pigeonhole(cube)
    lo, hi = interval(draws)
    mean = np.nanmean(cube, axis=(0, 1))
    apart = draws[:, :1] - draws
    apart_lo, apart_hi = interval(apart)
    rows = [
        ["criterion", "method", "mean", "95 % from", "to", "ahead by", "95 % from", "to", "p (Holm)", "agreement α"]
    ]
    for c, name in enumerate([*CRITERIA, AVERAGE]):
        each = np.nanmean(cube[..., c], axis=1)  # one number per person and method
        p = holm([sign_flip(each[:, 0] - each[:, m]) for m in range(1, len(methods))])
        alpha = krippendorff(cube[..., c].reshape(len(people), -1), "interval" if name == AVERAGE else "ordinal")
        for m, method in enumerate(methods):
            row = [name, method, f"{mean[m, c]:.2f}", f"{lo[m, c]:.2f}", f"{hi[m, c]:.2f}"]
            if m:
                ahead = mean[0, c] - mean[m, c]
                row += [f"{ahead:+.2f}", f"{apart_lo[m, c]:+.2f}", f"{apart_hi[m, c]:+.2f}", f"{p[m - 1]:.4f}", ""]
            else:
                row += ["", "", "", "", f"{alpha:.2f}"]
            rows.append(row)
    return rows


def strengths(ratings: Ratings, methods: list[str], draws: int = 1000) -> list[list[str]]:
    """Share of comparisons won and Bradley–Terry strength, with intervals over people."""
    rows = [["criterion", "method", "won", "strength", "95 % from", "to", "P(first method better)"]]
    pairs: dict[str, list[Preference]] = {who: [] for who in ratings.participants}
    for p in ratings.preferences:
        pairs[p.participant].append(p)
    draw = np.random.default_rng(0)
    for name in CRITERIA:
        each = np.stack([_wins(mine, name, methods) for mine in pairs.values()])
        wins = each.sum(0)
        s = bradley_terry(wins)
        again = [bradley_terry(each[draw.integers(len(each), size=len(each))].sum(0)) for _ in range(draws)]
        lo, hi = interval(np.stack(again))
        for m, method in enumerate(methods):
            won = wins[m].sum() / max(wins[m].sum() + wins[:, m].sum(), 1)
            better = f"{1 / (1 + np.exp(s[m] - s[0])):.2f}" if m else ""
            rows.append([name, method, f"{won:.0%}", f"{s[m]:+.2f}", f"{lo[m]:+.2f}", f"{hi[m]:+.2f}", better])
    return rows


def _wins(pairs: list[Preference], criterion: str, methods: list[str]) -> np.ndarray:
    wins = np.zeros((len(methods), len(methods)))
    for p in pairs:
        i, j = map(methods.index, p.methods)
        wins[i, j] += p.value[criterion]
        wins[j, i] += 1 - p.value[criterion]
    return wins


TITLES = {"scores": "Opinion scores, 1 to 5", "pairs": "Comparisons"}
NOTES = {
    "scores": "Intervals: bootstrap over people and prompts at once. p: sign flips of one mean per person, two-sided, "
    "corrected for the number of rivals (Holm). α: Krippendorff's agreement of the participants, 1 perfect, 0 chance.",
    "pairs": "Ties are half a win. Strength: Bradley–Terry, natural logarithm of the odds, half a win added to either "
    "side of each compared pair; intervals: bootstrap over people.",
}


def _who(ratings: Ratings) -> str:
    people = f"{len(ratings.participants)} participants count."
    left = "".join(f"\n- {who} does not: {why}" for who, why in ratings.excluded.items())
    return people + (f"\n{left}" if left else "")


def _markdown(rows: list[list[str]]) -> str:
    head, *body = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([head, "|" + "---|" * len(rows[0]), *body])
