"""How many people a study needs before it is held: studies of people who do not exist, scored like real ones."""

import numpy as np

from benchmarks.study.statistics import holm, sign_flip

PERSON, TASTE, PROMPT, NOISE = 0.4, 0.3, 0.3, 0.8
"""Assumed spreads of a score from 1 to 5: how strict a person is (falls out of a comparison), how much more or less
than others they like a method, how well a method does at a prompt, and the rest."""


def power(people: int, prompts: int, rivals: int, gap: float, *, studies: int = 400, seed: int = 0) -> float:
    """Share of studies in which every rival, worse by ``gap`` points, is found worse at the level of 5 %.

        score = 3 + person + quality of the method + taste(person, method) + luck(method, prompt) + rest

    rounded to 1 … 5, one score per person, prompt and method; test and correction are those of the report.
    """
    draw, found = np.random.default_rng(seed), 0
    for study in range(studies):
        quality = np.r_[gap / 2, np.full(rivals, -gap / 2)]
        mean = 3 + draw.normal(0, PERSON, (people, 1, 1)) + quality
        mean = mean + draw.normal(0, TASTE, (people, 1, rivals + 1)) + draw.normal(0, PROMPT, (prompts, rivals + 1))
        scores = np.clip(np.rint(mean + draw.normal(0, NOISE, (people, prompts, rivals + 1))), 1, 5).mean(1)
        ahead = scores[:, :1] - scores[:, 1:]
        p = holm([sign_flip(d, seed=study) for d in ahead.T])
        found += all(v < 0.05 for v in p) and bool((ahead.mean(0) > 0).all())
    return found / studies
