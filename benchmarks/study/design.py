"""Which films are shown beside which, without a word of who made them."""

import dataclasses
import hashlib
import itertools
import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

CRITERIA = {
    "motion": "Motion: does it move as the sentence says, and as such a thing would?",
    "visual": "Picture: how good does it look?",
}
"""Question of each criterion (DiffuPhyGS, 2025, §4.2: motion quality and visual quality)."""

TEMPLATE = Path(__file__).with_name("page.html")


class Refused(Exception):
    """The study cannot be made or scored; the message says what to change."""


@dataclass(frozen=True)
class Film:
    """A film of one prompt by one method."""

    prompt: str
    method: str
    path: Path


@dataclass(frozen=True)
class Item:
    """What is rated at once: one film on a scale, or two against each other."""

    kind: Literal["score", "pair"]
    prompt: str
    films: tuple[str, ...]
    """Names of one or two films in the page; which stands left is drawn for each participant."""


def make(
    films: Sequence[Film],
    out: Path,
    *,
    parts: Literal["scores", "pairs", "both"] = "both",
    catch: int = 2,
    seed: int = 0,
) -> Path:
    """Write ``out/page`` (for participants) and ``out/key.json`` (not for them); returns the page.

    Every film is scored, every two films of one prompt are compared, and ``catch`` films are compared with themselves.

    Raises:
        Refused: films of one prompt that differ in size or rate, which would tell them apart; a film twice; a prompt
        with fewer than two methods; a folder that is already there.
    """
    _check(films)
    if out.exists() and any(out.iterdir()):
        raise Refused(f"{out} is not empty: a study in progress must not change; choose another folder")
    draw = np.random.default_rng(seed)
    tokens = [draw.bytes(6).hex() for _ in films]
    prompts = list(dict.fromkeys(f.prompt for f in films))
    of = {p: sorted(t for f, t in zip(films, tokens, strict=True) if f.prompt == p) for p in prompts}
    items = [Item("score", p, (t,)) for p in prompts for t in of[p]] if parts != "pairs" else []
    if parts != "scores":
        items += [Item("pair", p, pair) for p in prompts for pair in itertools.combinations(of[p], 2)]
        same = [(p, t) for p in prompts for t in of[p]]
        chosen = draw.choice(len(same), min(catch, len(same)), replace=False)
        items += [Item("pair", same[i][0], (same[i][1],) * 2) for i in sorted(chosen)]
    (out / "page" / "films").mkdir(parents=True)
    digest = hashlib.sha256()
    for film, token in zip(films, tokens, strict=True):
        copy = out / "page" / "films" / f"{token}.mp4"
        _without_metadata(film.path, copy)
        digest.update(f"{film.prompt}\0{film.method}\0".encode() + copy.read_bytes())
    study = digest.hexdigest()[:12]
    shown = [{"id": f"{i:03d}", **dataclasses.asdict(item)} for i, item in enumerate(items)]
    asked = json.dumps({"study": study, "criteria": CRITERIA, "items": shown}).replace("<", "\\u003c")
    page = out / "page" / "index.html"
    page.write_text(TEMPLATE.read_text(encoding="utf-8").replace("{{study}}", asked), encoding="utf-8")
    key = {t: {"prompt": f.prompt, "method": f.method} for f, t in zip(films, tokens, strict=True)}
    (out / "key.json").write_text(
        json.dumps({"study": study, "films": key, "items": shown}, indent=1), encoding="utf-8"
    )
    return page


def _check(films: Sequence[Film]) -> None:
    seen: dict[tuple[str, str], Path] = {}
    looks: dict[str, tuple[tuple, Path]] = {}
    for film in films:
        if (film.prompt, film.method) in seen:
            raise Refused(f"{film.method!r} has two films of {film.prompt!r}: {seen[film.prompt, film.method]} too")
        seen[film.prompt, film.method] = film.path
        look = _look(film.path)
        first, where = looks.setdefault(film.prompt, (look, film.path))
        if look != first:
            raise Refused(
                f"films of {film.prompt!r} differ: {where} is {first[0]} at {first[1]:g} fps, {film.path} is "
                f"{look[0]} at {look[1]:g} fps, which tells them apart; film them with the same settings"
            )
    for prompt in looks:
        methods = [m for p, m in seen if p == prompt]
        if len(methods) < 2:
            raise Refused(f"{prompt!r} has films of {methods} only; a comparison needs two methods")


def _look(path: Path) -> tuple[tuple[int, int], float]:
    """Size [px] and rate [1/s]."""
    import imageio_ffmpeg

    if not path.is_file():
        raise Refused(f"there is no film {path}")
    try:
        reader = imageio_ffmpeg.read_frames(str(path))
        meta = next(reader)
        reader.close()
    except (OSError, RuntimeError) as trouble:
        raise Refused(f"{path} is no film that can be read: {str(trouble).splitlines()[0]}") from None
    return tuple(meta["size"]), float(meta["fps"])


def _without_metadata(film: Path, copy: Path) -> None:
    """The same stream in a file that says nothing of its origin."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", film, "-map", "0:v", "-c", "copy"]
    command += ["-map_metadata", "-1", "-bitexact", "-movflags", "+faststart", copy]
    subprocess.run([str(c) for c in command], check=True, stdin=subprocess.DEVNULL, capture_output=True)
