"""The README shows the films of the gallery, each with the command that makes it."""

import re
import shlex
from pathlib import Path

import pytest
from PIL import Image

from benchmarks.gallery import FILMS, SIDE, Film, beside, sheet, square

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def colours(image):
    """How many pixels each colour has."""
    return {rgb: count for count, rgb in image.getcolors(image.width * image.height)}


@pytest.mark.parametrize("film", FILMS, ids=lambda f: f.name)
def test_the_readme_shows_each_film_with_its_command(film):
    picture = f"docs/images/gallery/{film.name}.png"
    assert any(picture in cell and f"`{film.command}`" in cell for cell in README.replace("| ", "\n").splitlines())
    with Image.open(ROOT / picture) as image:
        assert image.height == SIDE and image.width == 3 * SIDE + 4


@pytest.mark.parametrize("film", [f for f in FILMS if isinstance(f, Film)], ids=lambda f: f.name)
def test_its_settings_are_options_of_the_program(film):
    given = shlex.split(film.command)[2:] if film.file is None else film.settings
    groups = [s.split("=") for s in given if re.fullmatch(r"\w+=\w+", s)]
    assert all((ROOT / "conf" / g / f"{o}.yaml").exists() for g, o in groups if (ROOT / "conf" / g).is_dir())
    assert all((ROOT / "conf" / s.lstrip("+").split(".")[0]).is_dir() for s in given if "." in s.split("=")[0])


def test_pictures_are_light():
    """A README with a megabyte and a half of pictures opens at once on a slow line."""
    assert sum(p.stat().st_size for p in (ROOT / "docs/images").rglob("*gallery*/*.png")) < 1.5e6


def test_a_sheet_holds_every_strip_whole():
    """Cropped square about the middle, side by side, rows of two: what is drawn is found again at its place."""
    wide = Image.new("RGB", (300, 200), "red")
    wide.paste("blue", (50, 0, 250, 200))
    strip = beside([square(wide)] * 3)
    assert strip.size == (3 * SIDE + 4, SIDE) and colours(strip).keys() == {(0, 0, 255), (255, 255, 255)}
    page = sheet([("one", strip)] * 3)
    assert colours(page)[0, 0, 255] == 3 * 3 * SIDE**2
