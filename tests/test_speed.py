"""Prices come out of timings as they went in, and the page says what the files say."""

import json

import numpy as np
import pytest

from benchmarks.speed import films, page, prices
from diffuphy.cost import coefficients

PRICES = {"round": 5e-5, "particle": 2e-7, "node": 1e-7, "law": 3e-8}


def rows(noise=0.0):
    """Timings of random work at known prices."""
    g = np.random.default_rng(0)
    found = []
    for _ in range(20):
        n, r = int(g.integers(100, 20_000)), int(g.integers(10, 100))
        work = {"round": r, "particle": n * r, "node": r * n**0.9 / 4, "law": n * r * (g.random() < 0.5)}
        found.append((work, sum(PRICES[u] * k for u, k in work.items()) * (1 + noise * g.standard_normal())))
    return found


def test_prices_are_found_again():
    """As many independent rows as units: the least squares are exact but for the four digits that are kept."""
    found = prices.fit(rows())
    assert found == pytest.approx(PRICES, rel=1e-3)
    assert max(map(abs, prices.errors(rows(), found))) < 1e-3


def test_noise_of_timings_goes_into_prices_once():
    """5 % of noise in 20 rows leaves predictions of the true cost within 5 %."""
    assert max(map(abs, prices.errors(rows(), prices.fit(rows(0.05))))) < 0.05


def test_known_prices_are_kept_and_taken_off():
    found = prices.fit(rows(), {"round": PRICES["round"], "particle": PRICES["particle"]})
    assert found == pytest.approx({u: PRICES[u] for u in ("node", "law")}, rel=1e-3)


def test_no_price_is_negative():
    assert prices.fit([({"a": 1.0}, 1.0), ({"a": 1.0, "b": 1.0}, 0.5)])["b"] == 0.0


def test_memory_is_that_of_the_process_its_stages_and_what_they_keep():
    base, own, factor = 8e8, {"one": 5e7, "two": 1e8}, 2.0
    made = [
        {"stages": {name: {"sizes": {"state": size}, "bytes": base + own[name] + factor * size} for name in own}}
        for size in (1e7, 1e8, 4e8)
    ]
    made.append({"stages": {"prompt": {"sizes": {}, "bytes": base}}})
    found = prices.memory(made)
    assert found["process"] == base and found["state"] == pytest.approx(factor, rel=1e-3)
    assert found["stage.two"] - found["stage.one"] == pytest.approx(5e7, rel=1e-3)


def test_what_is_kept_counts_at_least_once():
    """A peak that does not show it, because something else was freed before, is not a negative size."""
    made = [{"stages": {"one": {"sizes": {"state": s}, "bytes": 8e8}}} for s in (1e6, 1e8)]
    assert prices.memory(made)["state"] == pytest.approx(1.0)


def test_films_that_teach_and_films_that_test_differ():
    taught = {(prompt, *settings) for prompt, settings in films.LEARN}
    assert len(films.TEST) >= 10 and not taught & {(prompt, *settings) for prompt, settings in films.TEST}


def test_the_page_holds_what_the_files_say(tmp_path):
    counted, done = {"work": {"round": 1e6}, "sizes": {}}, {"processor": 100.0, "bytes": 8e8}
    film = {
        "expected": {"stages": {"trajectory": counted}, "particles": 10, "rounds": 5},
        "measured": {"stages": {"trajectory": done}, "particles": 11, "rounds": 6, "prompt": "a ball"},
    }
    folder = tmp_path / "docs/benchmarks"
    folder.mkdir(parents=True)
    (folder / "cost.json").write_text(json.dumps({"machine": "this one", "films": [film]}))
    text = page.text(tmp_path)
    seconds = 1e6 * coefficients()["seconds"]["round"]
    assert f"| a ball | 10 / 11 | 5 / 6 | {seconds:.1f} | 100.0 |" in text
    assert "of 1 films are predicted within 30 %" in text


def test_a_film_is_expected_before_it_is_made():
    """From the words and settings alone: every stage, and as many particles as the settings can give."""
    found = films.expected(films.TEST[0])
    assert set(found["stages"]) == {"prompt", "gaussians", "particles", "material", "trajectory", "clip"}
    assert 2_000 < found["particles"] <= 12_000 and found["rounds"] > 0
