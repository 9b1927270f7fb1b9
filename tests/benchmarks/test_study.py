"""The user study: what participants see says nothing of the methods, and the statistics find what was put in."""

import csv
import json
import subprocess

import numpy as np
import pytest
import torch

from benchmarks.study import films, main
from benchmarks.study.design import Film, Refused, make
from benchmarks.study.power import power
from benchmarks.study.ratings import Key, read
from benchmarks.study.report import report
from benchmarks.study.statistics import bradley_terry, holm, interval, krippendorff, pigeonhole, sign_flip
from diffuphy.render import write_mp4

METHODS = ("alpha", "beta", "gamma")
PROMPTS = ("a ball falling", "a jelly <bouncing> & 'more'")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study of three methods and two prompts, of tiny films."""
    folder = tmp_path_factory.mktemp("films")
    rows = [["prompt", "method", "path"]]
    for p, prompt in enumerate(PROMPTS):
        for m, method in enumerate(METHODS):
            frames = torch.full((4, 32, 32, 3), 0.1 + 0.1 * m)
            frames[:, 4 * m : 4 * m + 8, 8 * p : 8 * p + 8] = 1.0
            write_mp4(folder / f"{method}{p}.mp4", frames, 12.0)
            rows.append([prompt, method, f"{method}{p}.mp4"])
    with (folder / "films.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    assert main(["build", str(folder / "films.csv"), str(folder / "study"), "--catch", "2"]) == 0
    return folder / "study"


def answers(key: Key, draw: np.random.Generator, quality: dict[str, float], *, careful: bool = True) -> list[dict]:
    """What a participant says whose liking is ``quality`` and noise."""
    given = []
    for name, item in key.items.items():
        shown = list(draw.permutation(item["films"]))
        liking = [quality[key.films[f]["method"]] + 0.5 * draw.standard_normal() for f in shown]
        if item["kind"] == "score":
            says = int(np.clip(np.rint(3 + liking[0]), 1, 5))
        elif shown[0] == shown[1]:
            says = "none" if careful else "left"
        else:
            gap = liking[0] - liking[1]
            says = "none" if abs(gap) < 0.1 else "left" if gap > 0 else "right"
        given.append({"item": name, "films": [str(f) for f in shown], "motion": says, "visual": says, "seconds": 3.0})
    return given


def ratings(folder, key: Key, name: str, given: list[dict], **other) -> None:
    held = {"format": "diffuphy-study-1", "study": key.study, "participant": name, "answers": given} | other
    (folder / f"{name}.json").write_text(json.dumps(held))


# ---------------------------------------------------------------------- what is shown
def test_participants_cannot_learn_who_made_a_film(made):
    """No method name in any file of the page, and no metadata in a film."""
    from imageio_ffmpeg import get_ffmpeg_exe

    for file in (made / "page").rglob("*"):
        if file.is_file():
            assert not any(m.encode() in file.read_bytes() or m in file.name for m in METHODS)
    film = next((made / "page" / "films").glob("*.mp4"))
    said = subprocess.run([get_ffmpeg_exe(), "-i", str(film)], capture_output=True, text=True, check=False).stderr
    assert "title" not in said and "encoder" not in said and "h264" in said


def test_every_film_is_scored_and_every_pair_of_a_prompt_compared(made):
    items = list(Key.load(made / "key.json").items.values())
    pairs = [frozenset(i["films"]) for i in items if i["kind"] == "pair" and i["films"][0] != i["films"][1]]
    assert sum(i["kind"] == "score" for i in items) == 6 and len(set(pairs)) == len(pairs) == 6
    assert sum(i["kind"] == "pair" and i["films"][0] == i["films"][1] for i in items) == 2


def test_prompts_cannot_break_out_of_the_page(made):
    page = (made / "page" / "index.html").read_text()
    assert "<bouncing>" not in page and "\\u003cbouncing>" in page


def test_studies_that_would_mislead_are_refused(made, tmp_path):
    small, large = tmp_path / "small.mp4", tmp_path / "large.mp4"
    write_mp4(small, torch.zeros(2, 16, 16, 3), 12.0)
    write_mp4(large, torch.zeros(2, 32, 32, 3), 12.0)
    with pytest.raises(Refused, match="which tells them apart"):
        make([Film("p", "a", small), Film("p", "b", large)], tmp_path / "s")
    with pytest.raises(Refused, match="two films"):
        make([Film("p", "a", small), Film("p", "a", small)], tmp_path / "s")
    with pytest.raises(Refused, match="needs two methods"):
        make([Film("p", "a", small)], tmp_path / "s")
    with pytest.raises(Refused, match="is not empty"):
        make([Film("p", "a", small), Film("p", "b", small)], made)
    (tmp_path / "no.mp4").write_bytes(b"no film")
    with pytest.raises(Refused, match="no film that can be read"):
        make([Film("p", "a", small), Film("p", "b", tmp_path / "no.mp4")], tmp_path / "s")
    (tmp_path / "films.csv").write_text("prompt,path\na,b\n")
    with pytest.raises(Refused, match="columns prompt, method and path"):
        films(tmp_path / "films.csv")


# ---------------------------------------------------------------------- what they said
def test_the_study_finds_the_order_that_was_put_in(made, tmp_path):
    """Twelve people who like beta by 0.8 more than alpha and alpha by 0.8 more than gamma."""
    key, draw = Key.load(made / "key.json"), np.random.default_rng(3)
    for k in range(12):
        ratings(tmp_path, key, f"p{k:02d}", answers(key, draw, {"alpha": 0.0, "beta": 0.8, "gamma": -0.8}))
    held = read(key, sorted(tmp_path.glob("p*.json")))
    assert len(held.scores) == 12 * 6 and len(held.preferences) == 12 * 6
    text = report(held, "beta", tmp_path / "out")
    rows = {(r["criterion"], r["method"]): r for r in csv.DictReader((tmp_path / "out" / "scores.csv").open())}
    means = [float(rows["motion", m]["mean"]) for m in ("beta", "alpha", "gamma")]
    # 24 ratings with a spread of 0.6 (noise and rounding): standard error 0.12
    assert np.allclose(means, [3.8, 3.0, 2.2], atol=4 * 0.12)
    # every sign of 12 people agrees or nearly: the least p there is, 2 · 2^-12, times two rivals
    assert float(rows["motion", "gamma"]["p (Holm)"]) < 0.01
    pairs = {(r["criterion"], r["method"]): r for r in csv.DictReader((tmp_path / "out" / "pairs.csv").open())}
    strength = [float(pairs["visual", m]["strength"]) for m in ("beta", "alpha", "gamma")]
    assert strength[0] > strength[1] > strength[2] and text == (tmp_path / "out" / "study.md").read_text()


def test_who_does_not_look_does_not_count(made, tmp_path):
    key, draw = Key.load(made / "key.json"), np.random.default_rng(0)
    quality = dict.fromkeys(METHODS, 0.0)
    ratings(tmp_path, key, "careful", answers(key, draw, quality))
    ratings(tmp_path, key, "careless", answers(key, draw, quality, careful=False))
    ratings(tmp_path, key, "early", answers(key, draw, quality)[:-1])
    held = read(key, sorted(tmp_path.glob("*.json")))
    assert held.participants == ["careful"] and "2 of 2 pairs" in held.excluded["careless"]
    assert "answered 13 of 14" in held.excluded["early"] and "careless does not" in report(held, "alpha")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda h: h | {"study": "other"}, "belongs to study"),
        (lambda h: h | {"format": "x"}, "no file of ratings"),
        (lambda h: h | {"answers": [*h["answers"], h["answers"][0]]}, "comes twice"),
        (lambda h: h | {"answers": [h["answers"][0] | {"motion": 6}]}, "must be one of"),
        (lambda h: h | {"answers": [h["answers"][0] | {"motion": True}]}, "must be one of"),
        (lambda h: h | {"answers": [h["answers"][0] | {"films": ["x"]}]}, "not one of this study"),
        (lambda h: h | {"answers": None}, "no list of answers"),
        (lambda h: [1, 2], "no file of ratings"),
    ],
)
def test_files_that_are_no_ratings_are_refused(made, tmp_path, change, says, capsys):
    key = Key.load(made / "key.json")
    given = answers(key, np.random.default_rng(0), dict.fromkeys(METHODS, 0.0))
    held = {"format": "diffuphy-study-1", "study": key.study, "participant": "p", "answers": given}
    (tmp_path / "p.json").write_text(json.dumps(change(held)))
    assert main(["score", str(made / "key.json"), str(tmp_path / "p.json"), "--ours", "alpha"]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1


# ---------------------------------------------------------------------- statistics
def test_krippendorff_gives_the_published_values():
    """Krippendorff (2011), Computing Krippendorff's alpha-reliability, example C/D: 4 observers, 12 units."""
    n = np.nan
    table = np.array(
        [
            [1, 2, 3, 3, 2, 1, 4, 1, 2, n, n, n],
            [1, 2, 3, 3, 2, 2, 4, 1, 2, 5, n, 3],
            [n, 3, 3, 3, 2, 3, 4, 2, 2, 5, 1, n],
            [1, 2, 3, 3, 2, 4, 4, 1, 2, 5, 1, n],
        ]
    )
    found = [krippendorff(table, level) for level in ("nominal", "ordinal", "interval")]
    assert np.allclose(found, [0.743, 0.815, 0.849], atol=5e-4)  # printed to three digits


def test_bradley_terry_recovers_strengths():
    """With w_ij equal to its expectation and no prior, the strengths come back to the iteration's tolerance."""
    s = np.array([0.7, 0.1, -0.3, -0.5])
    wins = 50 / (1 + np.exp(s - s[:, None]))
    np.fill_diagonal(wins, 0)
    assert np.allclose(bradley_terry(wins, prior=0.0), s, atol=1e-7)
    apart = np.zeros((4, 4))
    apart[0, 1] = apart[2, 3] = 3
    with pytest.raises(ValueError, match="never compared"):
        bradley_terry(apart)
    assert np.isfinite(bradley_terry(np.array([[0, 5], [0, 0]]))).all()


def test_sign_flip_is_exact_for_few_people():
    """All of n differences positive: p = 2 / 2^n."""
    assert sign_flip(np.array([1.0, 2.0, 0.5, 3.0, 1.0])) == 2 / 32
    assert sign_flip(np.array([1.0, -1.0])) == 1.0
    many = sign_flip(np.full(40, 1.0))
    assert many == 1 / 20_001  # no drawn flip reaches it


def test_holm_corrects_in_steps():
    """(0.01, 0.04, 0.03) → 3·0.01, and 2·0.03 bounds the next from below."""
    assert np.allclose(holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])


def test_intervals_cover_the_truth_when_prompts_vary_too():
    """95 % intervals over people and prompts hold the mean at least that often, up to the error of 120 studies."""
    draw, held = np.random.default_rng(1), 0
    for k in range(120):
        people, prompts = draw.normal(0, 0.4, (15, 1)), draw.normal(0, 0.4, (1, 12))
        lo, hi = interval(pigeonhole(people + prompts + draw.normal(0, 0.6, (15, 12)), seed=k, draws=200))
        held += bool(lo <= 0 <= hi)
    # 15 and 12 are few for a percentile bootstrap; binomial standard error 2 %
    assert held / 120 > 0.95 - 3 * 0.02


def test_power_grows_with_people_and_is_the_level_without_a_difference():
    few, many = power(4, 5, 3, 0.5, studies=60), power(20, 5, 3, 0.5, studies=60)
    # four people cannot reach 5 % at all: p ≥ 2 / 2⁴
    assert few == 0.0 and many > 0.5
    # one rival, no difference: wrongly found better in 2.5 % of studies, and some more because prompts are few
    assert power(12, 40, 1, 0.0, studies=200) < 0.025 + 4 * (0.025 / 200) ** 0.5


def test_a_browser_can_take_the_whole_study(made, tmp_path):
    """Chromium watches, rates and saves; the file is read like any other."""
    sync = pytest.importorskip("playwright.sync_api")
    from shutil import which

    browser = which("chromium") or which("chromium-browser") or which("google-chrome")
    if browser is None:
        pytest.skip("no chromium on the path")
    key = Key.load(made / "key.json")
    with sync.sync_playwright() as play:
        chrome = play.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = chrome.new_page(accept_downloads=True)
        problems: list[str] = []
        page.on("pageerror", lambda e: problems.append(str(e)))
        page.goto((made / "page" / "index.html").as_uri())
        page.click("#next")
        for k in range(len(key.items)):
            page.wait_for_selector("video")
            assert page.locator("#next").is_disabled()
            page.locator("input[name=motion]").nth(1).check()
            page.locator("input[name=visual]").nth(1).check()
            if k == 3:  # half-way, the page is closed and opened again
                page.reload()
                page.locator("input[name=motion]").nth(1).check()
                page.locator("input[name=visual]").nth(1).check()
            page.click("#next")  # waits until it may be pressed
        with page.expect_download() as saved:
            page.click("#save")
        saved.value.save_as(tmp_path / "r.json")
        chrome.close()
    assert not problems
    held = read(key, [tmp_path / "r.json"])
    assert len(held.scores) == 6 and {s.value["motion"] for s in held.scores} == {2}
    assert all(p.value["visual"] == 0.5 for p in held.preferences)
