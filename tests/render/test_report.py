"""The report page: self-contained, well-formed, escaped, and true to what it was given."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import torch
from PIL import Image

from diffuphy.render.report import Report

EVIL = "<script>alert('1')</script> \"&"
VOID = {"meta", "img", "line", "circle", "polyline"}


class Page(HTMLParser):
    """Elements in order, with a check that every tag is closed in turn."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.words = [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    def all(self, tag):
        return [attrs for t, attrs in self.elements if t == tag]


def picture(seed=0, h=12, w=16):
    return np.random.default_rng(seed).random((h, w, 3))


@pytest.fixture
def page(tmp_path):
    film = tmp_path / "film.mp4"
    film.write_bytes(bytes(range(256)))
    path = Report()(
        tmp_path / "report.html",
        title=EVIL,
        film=film,
        sheet=picture(),
        views=[(EVIL, picture(1)), ("back", torch.from_numpy(picture(2)).float())],
        maps=[("stiffness", (255 * picture(3)).astype(np.uint8))],
        curves={EVIL: [(i, 2.0**-i) for i in range(20)], "psnr": [(0, 10.0), (5, 20.0)], "empty": []},
        plan=[(EVIL, "left out", EVIL)],
        settings=f"prompt: {EVIL}\nseed: 0",
        stages=[
            {"name": "material", "cached": False, "seconds": 30.0},
            {"name": "clip", "seconds": 10.0, "note": EVIL},
        ],
        numbers=[("hardened_loss", 2.134e-7, EVIL), ("expert", "neo_hookean", "")],
        warnings=[EVIL],
    )
    return Page(path.read_text(encoding="utf-8"))


def test_report_asks_for_nothing_outside_itself(page):
    """Every src is a data URI, no link, script or style sheet is fetched, and the policy forbids it all."""
    sources = [
        v for _, attrs in page.elements for k, v in attrs.items() if k in ("src", "href", "srcset", "poster", "action")
    ]
    assert len(sources) == 5 and all(s.startswith("data:") for s in sources)
    assert not {"script", "link", "iframe", "object", "base"} & {tag for tag, _ in page.elements}
    assert not [k for _, attrs in page.elements for k in attrs if k.startswith("on")]
    (style,) = [w for w in page.words if ":root" in w]
    assert "url(" not in style and "@import" not in style
    policy = next(m["content"] for m in page.all("meta") if "http-equiv" in m)
    assert policy.startswith("default-src 'none'")


def test_report_escapes_every_text(page):
    """The hostile text is read as words in each of its eleven places, never as markup."""
    said = [w for w in page.words if "alert" in w]
    assert len(said) == 11 and all("<script>" in w for w in said)
    assert page.all("svg")[0]["aria-label"].startswith(EVIL)
    assert [i["alt"] for i in page.all("img")] == ["contact sheet", EVIL, "back", "stiffness"]


def test_report_holds_film_and_pictures_unchanged(page):
    def content(uri):
        return base64.b64decode(uri.split(",", 1)[1])

    assert content(page.all("video")[0]["src"]) == bytes(range(256))
    for attrs, seed in zip(page.all("img"), range(4), strict=True):
        shown = np.asarray(Image.open(io.BytesIO(content(attrs["src"]))))
        error = np.abs(shown / 255 - picture(seed)).max()
        assert error <= 1 / 255 + 1e-6  # half a level of rounding; a whole one for the picture truncated to bytes above


def test_report_reads_aloud(page):
    """Every picture has words, tables have column heads, the page has a language and one first heading."""
    assert all(i.get("alt") for i in page.all("img")) and all(v.get("aria-label") for v in page.all("video"))
    assert all(s["role"] == "img" and s["aria-label"] for s in page.all("svg"))
    assert all(t.get("scope") == "col" for t in page.all("th")) and len(page.all("th")) == 3 + 4
    assert page.all("html")[0]["lang"] == "en" and len(page.all("h1")) == 1


def test_report_writes_numbers_as_people_do(page):
    text = "".join(page.words)
    assert "2.13" in text and "−7" in text and "e-07" not in text
    assert "hardened loss" in text and "neo_hookean" in text
    spans = [s for s in page.all("span") if "style" in s]
    assert [s["style"] for s in spans] == ["flex-grow:30.0000", "flex-grow:10.0000"]


def test_report_has_no_section_for_what_is_absent(tmp_path):
    text = Report()(tmp_path / "r.html", title="t").read_text(encoding="utf-8")
    assert "<section" not in text and "<video" not in text and "<aside" not in text
    assert "<h2>Curves</h2>" not in Report()(tmp_path / "r.html", title="t", curves={"a": []}).read_text("utf-8")


def test_report_reduces_large_pictures(tmp_path):
    path = Report(max_side=40)(tmp_path / "r.html", title="t", sheet=picture(0, 50, 100))
    (img,) = Page(path.read_text(encoding="utf-8")).all("img")
    assert Image.open(io.BytesIO(base64.b64decode(img["src"].split(",", 1)[1]))).size == (40, 20)


def test_report_that_fails_leaves_the_old_one(tmp_path):
    """A picture that is no picture, or a film no browser plays, is named; the file that was there stays whole."""
    path = tmp_path / "r.html"
    path.write_text("old", encoding="utf-8")
    bad = [
        ({"sheet": 3.0 * picture()}, r"'contact sheet' must have values in \[0, 1\]"),
        ({"views": [("front", picture() * np.nan)]}, "'front' must have values"),
        ({"maps": [("E", np.zeros((2, 3, 4)))]}, r"'E' must be \(H, W, 3\)"),
        ({"film": tmp_path / "film.avi"}, "encode it as mp4"),
    ]
    for content, message in bad:
        with pytest.raises(ValueError, match=message):
            Report()(path, title="t", **content)
    assert path.read_text(encoding="utf-8") == "old" and [p.name for p in tmp_path.iterdir()] == ["r.html"]
    with pytest.raises(ValueError, match="at least 16"):
        Report(max_side=1)


def test_page_style_names_only_what_the_page_uses(page):
    """Every class in the page is styled, so that no part of it is forgotten."""
    (style,) = [w for w in page.words if ":root" in w]
    used = {c for _, attrs in page.elements for c in attrs.get("class", "").split()}
    assert used <= set(re.findall(r"\.([a-z][a-z0-9]*)", style)) | {"large"}
