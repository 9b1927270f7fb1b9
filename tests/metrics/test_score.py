"""Numbers with error bars, and what is kept of them."""

import math

import pytest
import torch

from diffuphy.metrics import Scores, across, estimate
from diffuphy.metrics.score import Score


def test_mean_and_standard_error():
    """1, 2, 3: mean 2, s = 1, s/√3."""
    score = estimate("x", [1.0, 2.0, 3.0], better="higher", unit="dB")
    assert (score.value, score.count) == (2.0, 3) and score.error == pytest.approx(1 / math.sqrt(3))
    assert str(score) == "2 ± 0.58 dB"


def test_one_number_has_no_error():
    assert math.isnan(estimate("x", [1.0]).error) and str(estimate("x", [1.0])) == "1"
    with pytest.raises(ValueError, match="at least one"):
        estimate("x", [])


def test_scores_come_back_from_disk(tmp_path):
    scores = Scores((Score("a", 1.5, better="lower"), estimate("b", [1.0, 2.0])), {"c": "no weights"},
                    {"a": torch.tensor([1.0, 2.0])}, 24.0)  # fmt: skip
    scores.save(tmp_path)
    again = Scores.load(tmp_path)
    assert again["b"] == scores["b"] and str(again["a"]) == "1.5" and again.absent == scores.absent
    assert torch.equal(again.curves["a"], scores.curves["a"]) and again.fps == 24.0
    with pytest.raises(KeyError, match="no weights"):
        again["c"]


def test_runs_with_other_seeds_make_an_error_bar():
    """What only one run has is left out."""
    runs = [Scores((Score("a", v), *([Score("b", v)] if v > 1 else []))) for v in (1.0, 3.0)]
    mean = across(runs)
    assert [s.name for s in mean.scores] == ["a"]
    assert (mean["a"].value, mean["a"].error, mean["a"].count) == (2.0, pytest.approx(1.0), 2)
