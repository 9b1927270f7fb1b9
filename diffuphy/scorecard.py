"""What a run says about its scores: one line at its end, one section of its report, one table over several runs."""

from collections.abc import Sequence
from pathlib import Path

from diffuphy.artifact import Done
from diffuphy.metrics.score import Score, Scores, across
from diffuphy.render.report import Section

NAMED = ("CLIPSIM", "Diff_SSIM", "Diff_CLIP", "FVD", "LAION", "Janus", "PSNR to the prior")
"""Scores of which a missing one is worth a word at the end of a run."""


def scorecard(done: Sequence[Done]) -> Scores | None:
    """The scores of a run, if it was evaluated."""
    return next((Scores.load(d.path) for d in done if d.name == "evaluate"), None)


def line(scores: Scores) -> str:
    """What judges the film, and what is missing, in one line."""
    said = ", ".join(f"{s.name} {s}" for s in scores.scores if s.better)
    left = [name for name in NAMED if name in scores.absent]
    return said + (f"; left out: {', '.join(left)} (see the plan)" if left else "")


def section(scores: Scores) -> Section:
    """All numbers, their curves, and why others are not there."""
    numbers = [(s.name, str(s), _note(s)) for s in scores.scores]
    curves = [
        (name, [(t / scores.fps, v) for t, v in enumerate(values.tolist())], [])
        for name, values in scores.curves.items()
        if len(values)
    ]
    reasons: dict[str, list[str]] = {}
    for name, why in scores.absent.items():
        reasons.setdefault(why, []).append(name)
    words = [f"Left out: {', '.join(names)}. {why}." for why, names in reasons.items()]
    return Section("Scores", numbers, curves, words)


def _note(score: Score) -> str:
    return f"{score.note}; {score.better} is better" if score.better else score.note


def markdown(folders: Sequence[Path]) -> str:
    """A table of the mean scores of several runs, with standard errors, from their run folders.

    Raises:
        ValueError: a folder of a run that was not evaluated.
    """
    runs = []
    for folder in folders:
        found = sorted(folder.glob("*_evaluate"))
        if not found:
            raise ValueError(f"{folder} holds no scores; run it to its end without evaluate.score=off")
        runs.append(Scores.load(found[-1]))
    mean = across(runs)
    head = f"| score | mean of {len(runs)} run{'s' * (len(runs) > 1)} ± standard error | better |\n|---|---|---|\n"
    return head + "\n".join(f"| {s.name} | {s} | {s.better} |" for s in mean.scores)


if __name__ == "__main__":
    import sys

    print(markdown([Path(folder) for folder in sys.argv[1:]]))
