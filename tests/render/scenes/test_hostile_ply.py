"""Files that are broken or want to do harm: one line each, bounded memory and time, nothing written."""

import random
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from diffuphy.render.scenes import ply
from diffuphy.render.scenes.ply_table import MAX_HEADER
from diffuphy.text2gs.load import LoadGaussians
from diffuphy.types import Gaussians, Look

MEMORY = 16 * 2**20
"""What a refusal may take beside four times the file [byte]: a header of 64 kB, and a quarter of a megabyte of text
whose words are objects of 40 bytes each."""

SECONDS = 2.0
"""What a refusal may take; it reads no more than a header and some kilobytes, and the machine may be busy."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    """A sound file of 20 Gaussians of degree 1."""
    g = torch.Generator().manual_seed(0)
    shapes = ((20, 3), (20, 4), (20, 3), (20,), (20, 4, 3))
    path = tmp_path_factory.mktemp("whole") / "g.ply"
    ply.write(path, Gaussians(*(torch.randn(*s, generator=g) for s in shapes)))
    return path.read_bytes()


def split(data: bytes) -> tuple[list[bytes], bytes]:
    head, _, body = data.partition(b"end_header\n")
    return head.splitlines(), body


def joined(lines: list[bytes], body: bytes, end: bytes = b"\n") -> bytes:
    return end.join([*lines, b"end_header"]) + b"\n" + body


def text(data: bytes, change: Callable[[list[str]], list[str]]) -> bytes:
    """The same file in ASCII, its words changed."""
    import numpy as np

    lines, body = split(data)
    lines[1] = b"format ascii 1.0"
    words = change([f"{v:.9g}" for v in np.frombuffer(body, "<f4")])
    return joined(lines, " ".join(words).encode())


def cut_off(r: random.Random, data: bytes) -> bytes:
    return data[: r.randrange(len(data))]


def wrong_count(r: random.Random, data: bytes) -> bytes:
    lies = ["21", "4294967296", "-1", "1e9", "", "x", "999999999999999", "9" * 4000, "٣", "20 20", "0x14"]
    lines, body = split(data)
    lines[2] = b"element vertex " + r.choice(lies).encode()
    return joined(lines, body)


def a_property_less(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    needed = [i for i, line in enumerate(lines) if line.startswith(b"property") and b" n" not in line]
    lines[r.choice(needed)] = b"property float other"
    return joined(lines, body)


def a_property_twice(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    i = r.randrange(3, len(lines))
    return joined([*lines[:i], lines[i], *lines[i:]], body * 2)


def unknown_type(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    i = r.randrange(3, len(lines))
    lines[i] = lines[i].replace(
        b"float", r.choice([b"list uchar int", b"object", b"O", b"f4", b"str", b"half", b"\xff"])
    )
    return joined(lines, body)


def unknown_format(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    lines[1] = r.choice([b"format binary", b"", b"format", b"format utf-8 1.0", b"format \0 1.0", b"comment none"])
    return joined(lines, body)


def endless_header(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    return joined([*lines, *[b"comment " + b"a" * r.randrange(50, 90)] * (MAX_HEADER // 50)], body)


def nonsense_in_the_header(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    nonsense = r.choice(
        [b"import os", b"element", b"property", b"property float", b"\0" * 9, b"<script>", bytes(range(128, 256))]
    )
    lines.insert(r.randrange(2, len(lines)), nonsense)
    return joined(lines, body)


def noise(r: random.Random, data: bytes) -> bytes:
    return r.choice([b"", b"ply\n", b"PLY\n"]) + r.randbytes(r.randrange(5000))


def no_number(r: random.Random, data: bytes) -> bytes:
    def change(words: list[str]) -> list[str]:
        words[r.randrange(len(words))] = r.choice(["one", "0x1p3", "1,5", "--1", "\0", "\u00bd", "é" * 400])
        return words

    return text(data, change)


def too_few_words(r: random.Random, data: bytes) -> bytes:
    return text(data, lambda words: words[: r.randrange(len(words))])


def one_long_word(r: random.Random, data: bytes) -> bytes:
    return text(data, lambda words: ["1" * r.randrange(2**19, 2**21)])


def nothing_finite(r: random.Random, data: bytes) -> bytes:
    bad = r.choice(["nan", "inf", "-inf", "1e999", "1e39"])
    return text(data, lambda words: [bad] * len(words))


def wrong_harmonics(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    more = [f"property float f_rest_{i}".encode() for i in range(9, 9 + r.choice([1, 3, 14, 16, 33]))]
    return joined([*lines, *more], body * 4)


def packed(r: random.Random, data: bytes) -> bytes:
    lines, body = split(data)
    return joined([*lines[:3], b"property uint packed_position", b"property uint packed_rotation"], body)


KINDS = [
    cut_off, wrong_count, a_property_less, a_property_twice, unknown_type, unknown_format, endless_header,
    nonsense_in_the_header, noise, no_number, too_few_words, one_long_word, nothing_finite, wrong_harmonics, packed,
]  # fmt: skip
EACH = 14


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.__name__)
def test_a_hostile_file_is_one_line(kind, whole, tmp_path, monkeypatch) -> None:
    """15 kinds, 14 files each: a ValueError of one short line, bounded memory and time, nothing written."""
    monkeypatch.chdir(tmp_path)
    r = random.Random(kind.__name__)
    for i in range(EACH):
        path = Path(f"{i}.ply")
        path.write_bytes(kind(r, whole))
        before = sorted(p.name for p in tmp_path.rglob("*"))
        tracemalloc.start()
        start = time.perf_counter()
        with pytest.raises(ValueError) as caught:
            LoadGaussians(path=str(path))(Look("a", "a"))
        seconds, (_, peak) = time.perf_counter() - start, tracemalloc.get_traced_memory()
        tracemalloc.stop()
        said = str(caught.value)
        assert said.startswith(str(path)) and "\n" not in said and len(said) < 400, said
        assert said.isprintable(), repr(said)
        assert peak < MEMORY + 4 * path.stat().st_size, f"{said}: {peak} bytes"
        assert seconds < SECONDS, f"{said}: {seconds:.1f} s"
        assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_there_are_two_hundred_of_them() -> None:
    assert len(KINDS) * EACH >= 200


def test_a_flipped_byte_is_an_error_or_sound_gaussians(whole, tmp_path) -> None:
    """Whatever byte is changed: a ValueError of one line, or Gaussians of finite numbers."""
    r, path = random.Random(0), tmp_path / "g.ply"
    for _ in range(200):
        data = bytearray(whole)
        data[r.randrange(len(data))] = r.randrange(256)
        path.write_bytes(bytes(data))
        try:
            g = LoadGaussians(path=str(path))(Look("a", "a"))
        except ValueError as error:
            assert "\n" not in str(error)
        else:
            assert all(
                getattr(g, n).isfinite().all() for n in ("means", "quats", "log_scales", "logit_opacities", "sh")
            )


def test_a_count_is_checked_before_anything_is_allocated(whole, tmp_path) -> None:
    """Two terabytes are promised, by a file of 2 kB."""
    lines, body = split(whole)
    lines[2] = b"element vertex 20000000000"
    (tmp_path / "g.ply").write_bytes(joined(lines, body))
    with pytest.raises(ValueError, match="cut off: 20000000000 Gaussians need"):
        LoadGaussians(path=str(tmp_path / "g.ply"))


def test_a_sparse_file_of_too_many_is_refused_by_its_header(whole, tmp_path) -> None:
    """A file may be as long as it promises without there being anything in it."""
    lines, body = split(whole)
    row = len(body) // 20
    lines[2] = b"element vertex 20000000"
    with (tmp_path / "g.ply").open("wb") as file:
        file.write(joined(lines, b""))
        file.truncate(file.tell() + 20_000_000 * row)
    with pytest.raises(ValueError, match="20000000 Gaussians, more than 10000000; raise max_gaussians"):
        LoadGaussians(path=str(tmp_path / "g.ply"))
