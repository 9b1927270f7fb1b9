"""Gaussians of a .spz file: Niantic's packed format, versions 2 and 3 (github.com/nianticlabs/spz, README).

One gzip stream: a header of 16 bytes, then array after array, of all Gaussians: positions as 24-bit integers in steps
of 2^−b, opacities, colours, logarithms of the scales in sixteenths, orientations, and spherical harmonics, 8 bits each.
Its axes are x right, y up, z backwards; converters turn a scene into them, half a turn about x, and it is turned back
here, so that ``up`` means what it means for the .ply file that was packed.
"""

import math
import zlib
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from diffuphy.render.scenes import ply
from diffuphy.types import N_SH, Gaussians

HEADER = np.dtype([("magic", "<u4"), ("version", "<u4"), ("count", "<u4"), ("degree", "u1"), ("bits", "u1"),
                   ("flags", "u1"), ("reserved", "u1")])  # fmt: skip
MAGIC = 0x5053474E
"""The bytes NGSP."""

TURN = {2: 3, 3: 4}
"""Bytes of an orientation, by version."""

SMALL = 0.15
"""Range of the colours: a byte is 255 (½ + 0.15 c), c the coefficient of degree 0."""

SPREAD = 1100
"""More than a gzip stream grows [-]; deflate reaches 1032."""


def header(path: Path) -> tuple[int, int, int, int]:
    """Version, number of Gaussians, degree of their harmonics, and fractional bits of positions.

    Raises:
        ValueError: not such a file, another version, or less in it than it promises.
    """
    with path.open("rb") as file:
        if file.read(4) == b"NGSP":
            raise ValueError(f"{path} is a .spz file of version 4 or later; make it one of 3: --spz-version 3")
    start = _inflated(path, HEADER.itemsize)
    found = np.frombuffer(start, HEADER) if len(start) == HEADER.itemsize else None
    if found is None or found["magic"][0] != MAGIC:
        raise ValueError(f"{path} is no .spz file")
    version, count, degree, bits = (int(found[name][0]) for name in ("version", "count", "degree", "bits"))
    if version not in TURN:
        raise ValueError(
            f"{path} is a .spz file of version {version}; {' and '.join(map(str, TURN))} are read: splat-transform "
            "in.spz out.ply"
        )
    if degree not in N_SH or bits > 24:
        raise ValueError(f"{path} has harmonics of degree {degree}, {bits} fractional bits; 3 and 24 are the most")
    if (needs := _size(version, count, degree)) > SPREAD * path.stat().st_size:
        raise ValueError(
            f"{path} is cut off: {count} Gaussians take {needs} bytes, it has {path.stat().st_size} packed"
        )
    return version, count, degree, bits


def read(path: Path, *, up: ply.Up = "y_down", degree: int | None = None) -> Gaussians:
    """Gaussians, float32 and z-up, of a .spz file.

    Args:
        degree: highest degree of spherical harmonics to keep; None keeps all.

    Raises:
        ValueError: see ``header``.
    """
    version, n, have, bits = header(path)
    size = _size(version, n, have)
    data = np.frombuffer(_inflated(path, HEADER.itemsize + size), np.uint8)[HEADER.itemsize :]
    if len(data) != size:
        raise ValueError(f"{path} is cut off: {n} Gaussians take {size} bytes, {len(data)} are there")
    bands = N_SH[have] - 1
    widths = (9, 1, 3, 3, TURN[version], 3 * bands)
    starts = np.cumsum([0, *(w * n for w in widths)])
    parts = [data[a:b].reshape(n, w) for a, b, w in zip(starts[:-1], starts[1:], widths, strict=True)]
    places, opacities, colours, scales, turns, harmonics = parts
    fixed = places.reshape(n, 3, 3).astype(np.int32) @ np.array([1, 2**8, 2**16], np.int32)
    fixed = np.where(fixed >= 2**23, fixed - 2**24, fixed)  # two's complement
    alpha = torch.from_numpy(opacities[:, 0].astype(np.float32)).clamp(0.5, 254.5) / 255
    dc = (torch.from_numpy(colours.astype(np.float32)) / 255 - 0.5) / SMALL
    sh = (torch.from_numpy(harmonics.astype(np.float32)).reshape(n, bands, 3) - 128) / 128
    kept = N_SH[have if degree is None else min(degree, have)] - 1
    g = Gaussians(
        means=torch.from_numpy((fixed / 2.0**bits).astype(np.float32)),
        quats=_old_turns(turns) if version == 2 else _new_turns(turns),
        log_scales=torch.from_numpy(scales.astype(np.float32)) / 16 - 10,
        logit_opacities=alpha.logit(),
        sh=torch.cat([dc[:, None], sh[:, :kept]], dim=1),
    )
    return ply.upright(ply.turned(g, 2), up)


def _size(version: int, count: int, degree: int) -> int:
    """Bytes of so many Gaussians."""
    return count * (9 + 1 + 3 + 3 + TURN[version] + 3 * (N_SH[degree] - 1))


def _inflated(path: Path, most: int) -> bytes:
    """The first ``most`` bytes of a gzip file, or all there are."""
    inflate = zlib.decompressobj(wbits=31)  # with the header of gzip
    out = bytearray()
    try:
        with path.open("rb") as file:
            while len(out) < most and (block := inflate.unconsumed_tail or file.read(2**20)):
                out += inflate.decompress(block, most - len(out))
    except zlib.error:
        raise ValueError(f"{path} is no .spz file, or is damaged") from None
    return bytes(out)


def _old_turns(rows: np.ndarray) -> Tensor:
    """wxyz of x, y, z in 127.5ths about 1; w is not negative."""
    xyz = torch.from_numpy(rows.astype(np.float32)) / 127.5 - 1
    w = (1 - xyz.square().sum(1, keepdim=True)).clamp_min(0).sqrt()
    return torch.cat([w, xyz], dim=1)


def _new_turns(rows: np.ndarray) -> Tensor:
    """wxyz of the three smaller of x, y, z, w, each a sign and 9 bits of 1/√2, the last lowest; the highest two bits
    are the index of the largest, which is not negative."""
    packed = rows.astype(np.uint32) @ np.array([1, 2**8, 2**16, 2**24], np.uint32)
    largest = torch.from_numpy((packed >> 30).astype(np.int64))
    fields = torch.from_numpy(np.stack([(packed >> s) & 1023 for s in (20, 10, 0)], 1).astype(np.int64))
    small = (fields & 511).float() / 511 * math.sqrt(0.5) * (1 - 2 * (fields >> 9)).float()
    others = torch.tensor([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    xyzw = torch.zeros(len(rows), 4).scatter_(1, others, small)
    rest = (1 - small.square().sum(1, keepdim=True)).clamp_min(0).sqrt()
    return xyzw.scatter_(1, largest[:, None], rest)[:, [3, 0, 1, 2]]
