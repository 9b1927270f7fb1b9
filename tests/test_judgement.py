"""What a run says about its error."""

import json

import pytest
import torch

from diffuphy.artifact import Done
from diffuphy.judgement import BAND, duration, judgement, length
from diffuphy.types import Errors, Particles


def done(tmp_path, errors):
    """The stages that a judgement reads, on disk."""
    n = 1000
    particles = Particles(torch.zeros(n, 3), torch.ones(n), torch.zeros(n), 1.0, (0.0, 0.0, 0.0), 0.5 / 28 / 2)
    found = []
    for name, result, seconds in (("particles", particles, 1.0), ("trajectory", None, 12.0), ("errors", errors, 3.0)):
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        if result is not None:
            result.save(folder)
        found.append(Done(name, folder, False, seconds, 100.0))
    return found


def errors(com, size=0.5):
    com = torch.tensor(com)
    return Errors(com, 0.4 * com, 100 * com, {"grid": 1.1 * com, "time": 0.1 * com}, size, 10.0)


def test_a_run_without_an_estimate_says_nothing(tmp_path):
    assert judgement(done(tmp_path, errors([0.0, 0.01]))[:2]) is None


def test_the_line_says_error_pixels_and_what_half_of_it_takes(tmp_path):
    said = str(judgement(done(tmp_path, errors([0.0, 0.02, 0.01]))))
    assert "2 cm of the centre of mass, 8 mm of the shape (4.0%, 1.6% of the size), 2.0 px" in said
    assert "for 16 times the 12 s" in said and "found in 3.0 s" in said and "\n" not in said


def test_the_section_holds_curves_with_their_bands(tmp_path):
    """100 e/size, and a third of it to three times it, at t = frame/fps."""
    section = judgement(done(tmp_path, errors([0.0, 0.02, 0.01]))).section()
    name, points, band = section.curves[0]
    assert name == "centre of mass [% of the size]"
    assert points == [(0.0, 0.0), (0.1, pytest.approx(4.0)), (0.2, pytest.approx(2.0))]
    assert band[1] == (0.1, pytest.approx(4.0 / BAND), pytest.approx(4.0 * BAND))
    assert [n for n, *_ in section.numbers] == ["centre of mass", "shape", "picture", "due to time", "took"]
    assert "23% of the 13 s" in section.numbers[-1][2]


def test_finer_settings_are_half_the_spacing(tmp_path):
    """28 cells → 56, 1000 particles → 8000; 16 × 12 s = 192 s."""
    words = " ".join(judgement(done(tmp_path, errors([0.01]))).section().words)
    assert "+sample.cells=56 +sample.max_particles=8000" in words and "about 3 min instead of 12 s" in words


def test_two_motions_are_called_two_motions(tmp_path):
    """√(com² + shape²) > size/4 from the third frame on."""
    far = judgement(done(tmp_path, errors([0.0, 0.05, 0.2, 0.3]))).section().words
    near = judgement(done(tmp_path, errors([0.0, 0.05, 0.05, 0.1]))).section().words
    assert len(far) == len(near) + 1 and far[-1].startswith("From 0.20 s on")


def test_a_missing_estimate_says_why(tmp_path):
    said = judgement(done(tmp_path, Errors.missing(3, 0.5, 30.0, "the draft is too small")))
    assert str(said) == "not known: the draft is too small"
    assert "the draft is too small" in said.section().words[0] and not said.section().curves


def test_lengths_and_times_are_as_one_reads_them():
    assert [length(v) for v in (1.234, 0.0567, 0.004, 3e-6)] == ["1.2 m", "5.7 cm", "4 mm", "3 µm"]
    assert [length(v) for v in (5.94e-4, 9.96e-4, 5.5e-8)] == ["590 µm", "1000 µm", "0.055 µm"]
    assert [duration(v) for v in (12.4, 300.0, 7200.0)] == ["12 s", "5 min", "2.0 h"]


def test_report_claims_what_was_measured():
    """The factors in the words are those measured, and they hold on the scene that was kept for that."""
    from benchmarks.errors import OUT, fall
    from diffuphy.judgement import FALL

    measured = json.loads((OUT / "errors.json").read_text(encoding="utf-8"))
    assert fall(measured["scenes"]) == FALL
    assert FALL[0] <= measured["accept"]["factor"] <= FALL[2]
