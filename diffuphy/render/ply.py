"""Gaussians as .ply files in the layout of 3D Gaussian splatting (Kerbl et al. 2023), read by every splat viewer.

float32, little endian, in the order ``x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3``: opacity a
logit, scales logarithms, rotation wxyz, ``f_rest`` channel by channel (all red, then green, then blue), absent at
degree 0.
"""

import math
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from diffuphy.render import sh as harmonics
from diffuphy.types import N_SH, Gaussians

Up = Literal["z_up", "y_up", "y_down"]

SCALARS = {
    **{
        "char": "i1",
        "int8": "i1",
        "uchar": "u1",
        "uint8": "u1",
        "short": "i2",
        "int16": "i2",
        "ushort": "u2",
        "uint16": "u2",
    },
    **{
        "int": "i4",
        "int32": "i4",
        "uint": "u4",
        "uint32": "u4",
        "float": "f4",
        "float32": "f4",
        "double": "f8",
        "float64": "f8",
    },
}
"""NumPy type of each scalar type of the format."""

QUARTER_TURNS = {"z_up": 0, "y_up": -1, "y_down": 1}
"""Quarter turns about x that bring z-up to each convention."""


def names(rest: int) -> list[str]:
    """Properties in file order, with ``rest`` coefficients above degree 0."""
    return [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(rest)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]


def write(path: Path | str, gaussians: Gaussians, *, up: Up = "y_down") -> None:
    """Write ``gaussians`` to ``path``.

    Args:
        up: axis convention of the file. Viewers expect images' y-down (SuperSplat turns a file by 180° about z); the
            other two are for tools that keep the axes.

    Raises:
        ValueError: a value is not finite, or ``up`` is unknown.
    """
    g = turned(gaussians, _quarter_turns(up))
    count = len(g)
    columns = torch.cat(
        [
            g.means,
            torch.zeros_like(g.means),
            g.sh[:, 0],
            g.sh[:, 1:].transpose(1, 2).flatten(1),
            g.logit_opacities[:, None],
            g.log_scales,
            g.quats,
        ],
        dim=1,
    )
    if not torch.isfinite(columns).all():
        row, column = (~torch.isfinite(columns)).nonzero()[0].tolist()
        name = names(columns.shape[1] - 17)[column]
        raise ValueError(
            f"{name} of Gaussian {row} is {columns[row, column].item()}; a .ply file holds finite numbers only"
        )
    table = columns.detach().cpu().numpy().astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in names(table.shape[1] - 17)]
    Path(path).write_bytes("\n".join([*header, "end_header\n"]).encode("ascii") + table.tobytes())


def read(path: Path | str, *, up: Up = "y_down") -> Gaussians:
    """Gaussians, float32 and z-up, from a file whose axes follow ``up``; properties may come in any order and type.

    Raises:
        ValueError: not a binary .ply file, a property is missing, or the file is too short.
    """
    vertices = _vertices(Path(path))
    have = set(vertices.dtype.names or ())
    rest = sorted((name for name in have if name.startswith("f_rest_")), key=lambda name: int(name[7:]))
    if missing := [name for name in names(0) if name not in have and name not in ("nx", "ny", "nz")]:
        raise ValueError(f"{path} holds no Gaussians: the properties {', '.join(missing)} are missing")
    if len(rest) // 3 + 1 not in N_SH.values() or len(rest) % 3:
        raise ValueError(f"{path} has {len(rest)} f_rest properties; 0, 9, 24 or 45 are allowed (degree 0 to 3)")

    def columns(*wanted: str) -> Tensor:
        return torch.from_numpy(np.stack([vertices[name].astype(np.float32) for name in wanted], axis=1))

    dc = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    if rest:
        dc = torch.cat([dc, columns(*rest).reshape(len(vertices), 3, len(rest) // 3).transpose(1, 2)], dim=1)
    g = Gaussians(
        means=columns("x", "y", "z"),
        quats=columns("rot_0", "rot_1", "rot_2", "rot_3"),
        log_scales=columns("scale_0", "scale_1", "scale_2"),
        logit_opacities=columns("opacity")[:, 0],
        sh=dc.contiguous(),
    )
    return turned(g, -_quarter_turns(up))


def turned(gaussians: Gaussians, quarters: int) -> Gaussians:
    """Gaussians rotated about x by so many quarter turns: centres, orientations and colours."""
    if quarters % 4 == 0:
        return gaussians
    c, s = round(math.cos(quarters * math.pi / 2)), round(math.sin(quarters * math.pi / 2))
    R = gaussians.means.new_tensor([[1, 0, 0], [0, c, -s], [0, s, c]])
    w, x = math.cos(quarters * math.pi / 4), math.sin(quarters * math.pi / 4)
    qw, qx, qy, qz = gaussians.quats.unbind(1)
    quats = torch.stack([w * qw - x * qx, w * qx + x * qw, w * qy - x * qz, w * qz + x * qy], dim=1)
    return Gaussians(
        gaussians.means @ R.mT,
        quats,
        gaussians.log_scales,
        gaussians.logit_opacities,
        harmonics.rotate(gaussians.sh, R),
    )


def _quarter_turns(up: str) -> int:
    if up not in QUARTER_TURNS:
        raise ValueError(f"up must be one of {', '.join(QUARTER_TURNS)}, got {up!r}")
    return QUARTER_TURNS[up]


def _vertices(path: Path) -> np.ndarray:
    """The vertex table of a binary .ply file, as a structured array."""
    data = path.read_bytes()
    end = data.find(b"end_header\n")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError(f"{path} is not a .ply file: it lacks the word 'ply' at its start or a line 'end_header'")
    order, count, fields, element, before = "", 0, [], "", True
    for line in data[:end].decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", kind, *_]:
                order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind, "")
                if not order:
                    raise ValueError(
                        f"{path} has the format {kind}; binary_little_endian or binary_big_endian is needed"
                    )
            case ["element", name, number]:
                element, before = name, before and (name == "vertex" or int(number) == 0)
                count = int(number) if name == "vertex" else count
            case ["property", kind, name] if element == "vertex":
                if kind not in SCALARS:
                    raise ValueError(f"{path}: property {name} has the unknown type {kind}")
                fields.append((name, order + SCALARS[kind]))
            case ["property", "list", *_] if element == "vertex":
                raise ValueError(f"{path}: a vertex with a list property is not a Gaussian")
        if element == "vertex" and not before:
            raise ValueError(f"{path}: the element 'vertex' must come first")
    table = np.dtype(fields)
    body = data[end + len(b"end_header\n") :]
    if len(body) < count * table.itemsize:
        raise ValueError(
            f"{path} is cut off: {count} Gaussians need {count * table.itemsize} bytes, {len(body)} are there"
        )
    return np.frombuffer(body, dtype=table, count=count)
