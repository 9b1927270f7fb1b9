"""The vertices of a .ply file as columns: ASCII or binary of either byte order, any properties in any order and type.

Turk, The PLY polygon file format (1994). A file is somebody else's: what its header promises is checked against the
length of the file before a byte is allocated for it, and nothing is read twice.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SCALARS = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1"},
    **{"short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2"},
    **{"int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
"""NumPy type of each scalar type of the format."""

FORMATS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
"""Byte order by the name of the format."""

MAX_HEADER = 2**16
"""Longest header [byte]; that of degree 3 has 1.5 kB."""

BLOCK = 2**18
"""What is read at once [byte]."""

END = re.compile(rb"\nend_header[ \t]*\r?\n")


@dataclass(frozen=True)
class Table:
    """Where the vertices of a file are; nothing of them is read yet."""

    path: Path
    count: int
    """Vertices."""
    row: np.dtype
    """Their properties, in file order."""
    start: int
    """First byte after the header."""
    text: bool
    """Numbers are written out."""

    @property
    def names(self) -> tuple[str, ...]:
        return self.row.names or ()

    @classmethod
    def of(cls, path: Path) -> "Table":
        """Read the header.

        Raises:
            ValueError: no .ply file, a header that makes no sense, or fewer bytes than it promises.
        """
        with path.open("rb") as file:
            head = file.read(MAX_HEADER)
        end = END.search(head)
        if not re.match(rb"ply\s", head) or end is None:
            where = f" in its first {MAX_HEADER} bytes" if len(head) == MAX_HEADER else ""
            raise ValueError(
                f"{path} is not a .ply file: it lacks the word 'ply' at its start or a line 'end_header'{where}"
            )
        format_, count, row = _header(path, head[: end.start()].decode("ascii", "replace").splitlines()[1:])
        if not row:
            raise ValueError(f"{path} is a .ply file without vertices; Gaussians are needed, one vertex each")
        order = FORMATS[format_]
        table = cls(path, count, np.dtype([(n, (order or "<") + t) for n, t in row]), end.end(), not order)
        # written out, a number takes two bytes at least, itself and what parts it from the next
        least = max(0, count * len(row) * 2 - 1) if table.text else count * table.row.itemsize
        there = path.stat().st_size - table.start
        if there < least:
            raise ValueError(f"{path} is cut off: {count} Gaussians need {least} bytes at least, {there} are there")
        return table

    def columns(self, names: Iterable[str]) -> np.ndarray:
        """The properties ``names`` of every vertex, shape (count, len(names)), float32.

        Raises:
            ValueError: text that is no number, or too little of it.
        """
        names = list(names)
        out = np.empty((self.count, len(names)), np.float32)
        # what float32 cannot hold becomes infinite, for the caller to see
        with np.errstate(over="ignore", invalid="ignore"):
            if self.text:
                wanted = [self.names.index(name) for name in names]
                for first, numbers in self._written():
                    out[first : first + len(numbers)] = numbers[:, wanted]
            else:
                for first, rows in self._packed():
                    for i, name in enumerate(names):
                        out[first : first + len(rows), i] = rows[name]
        return out

    def _packed(self) -> Iterator[tuple[int, np.ndarray]]:
        """Index of the first, and the rows, of some binary vertices, a block at a time."""
        size = 1 + BLOCK // self.row.itemsize
        with self.path.open("rb") as file:
            file.seek(self.start)
            for first in range(0, self.count, size):
                rows = np.fromfile(file, self.row, min(size, self.count - first))
                if len(rows) < min(size, self.count - first):
                    raise ValueError(f"{self.path} became shorter while it was read; read it again")
                yield first, rows

    def _written(self) -> Iterator[tuple[int, np.ndarray]]:
        """Index of the first, and the numbers, of some vertices that are written out, a block at a time."""
        width, first, rest = len(self.names), 0, b""
        numbers = np.empty(0)
        with self.path.open("rb") as file:
            file.seek(self.start)
            while first < self.count:
                block = file.read(BLOCK)
                text = rest + block
                cut = max(text.rfind(b" "), text.rfind(b"\n"), text.rfind(b"\t")) + 1 if block else len(text)
                words, rest = text[:cut].split(), text[cut:]
                if len(rest) > BLOCK or not (words or block):
                    raise ValueError(
                        f"{self.path} is cut off: {self.count} Gaussians of {width} numbers are promised, "
                        f"{first} are there"
                    )
                wanted = (self.count - first) * width - len(numbers)
                numbers = np.concatenate([numbers, self._numbers(words[:wanted])])
                whole = len(numbers) // width
                yield first, numbers[: whole * width].reshape(whole, width)
                first, numbers = first + whole, numbers[whole * width :]

    def _numbers(self, words: list[bytes]) -> np.ndarray:
        try:
            return np.array(words, dtype=np.float64) if words else np.empty(0)
        except ValueError:
            wrong = next((word for word in words if not _is_number(word)), words[0])
            raise ValueError(
                f"{self.path} has {wrong[:20].decode('ascii', 'replace')!r} where a number must be"
            ) from None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _header(path: Path, lines: list[str]) -> tuple[str, int, list[tuple[str, str]]]:
    """Format, number of vertices, and name and type of each of their properties."""
    format_, count, element, fields, before = "", 0, "", {}, ""
    for line in lines:
        match line.split():
            case ["format", kind, *_]:
                format_ = kind
            case ["element", "vertex", number] if not fields:
                element, count = "vertex", _count(path, line, number)
                if before:
                    raise ValueError(f"{path}: the element 'vertex' must come first, but {before!r} does")
            case ["element", name, number] if name != "vertex":
                element = name
                before = before or (name if _count(path, line, number) and not fields else "")
            case ["property", "list", *_]:
                if element == "vertex":
                    raise ValueError(f"{path}: a vertex with a list property is not a Gaussian")
            case ["property", kind, name]:
                if kind not in SCALARS or name in fields:
                    why = (
                        "occurs twice"
                        if name in fields and element == "vertex"
                        else f"has the unknown type {kind[:20]!r}"
                    )
                    if element == "vertex":
                        raise ValueError(f"{path}: property {name[:40]!r} {why}")
                elif element == "vertex":
                    fields[name] = SCALARS[kind]
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"{path}: the header has a line that means nothing, {line[:60]!r}")
    if format_ not in FORMATS:
        raise ValueError(f"{path} has the format {format_[:40]!r}; {', '.join(FORMATS)} are read")
    return format_, count, list(fields.items())


def _count(path: Path, line: str, number: str) -> int:
    if not (number.isascii() and number.isdecimal() and len(number) < 16):
        raise ValueError(f"{path}: the header has {line[:60]!r}; a number of elements must be there")
    return int(number)
