"""Gaussians as .ply files in the layout of 3D Gaussian splatting (Kerbl et al. 2023), read by every splat viewer.

float32, little endian, in the order ``x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3``: opacity a
logit, scales logarithms, rotation wxyz, ``f_rest`` channel by channel (all red, then green, then blue), absent at
degree 0.
"""

import math
from pathlib import Path
from typing import Literal

import torch

from diffuphy.render import sh as harmonics
from diffuphy.render.scenes.ply_table import Table
from diffuphy.types import N_SH, Gaussians

Up = Literal["z_up", "y_up", "y_down"]

QUARTER_TURNS = {"z_up": 0, "y_up": -1, "y_down": 1}
"""Quarter turns about x that bring z-up to each convention."""

CENTRE, NORMAL, DC = ("x", "y", "z"), ("nx", "ny", "nz"), ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE, TURN = ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
"""Names of properties."""


def names(rest: int) -> list[str]:
    """Properties in file order, with ``rest`` coefficients above degree 0."""
    return [*CENTRE, *NORMAL, *DC, *(f"f_rest_{i}" for i in range(rest)), "opacity", *SCALE, *TURN]


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


def read(path: Path | str, *, up: Up = "y_down", degree: int | None = None) -> Gaussians:
    """Gaussians, float32 and z-up, from a file whose axes follow ``up``.

    Properties may come in any order and type, with others among them; ASCII or binary of either byte order.

    Args:
        degree: highest degree of spherical harmonics to read; None reads all there are.

    Raises:
        ValueError: not a .ply file of Gaussians, a property is missing, or the file is too short.
    """
    table = Table.of(Path(path))
    have = highest(table)
    if degree is None and have not in N_SH:
        raise ValueError(f"{path} has spherical harmonics of degree {have}; give degree=3 to leave out higher ones")
    kept = have if degree is None else min(degree, have)
    bands = [f"f_rest_{c * ((have + 1) ** 2 - 1) + k}" for c in range(3) for k in range((kept + 1) ** 2 - 1)]
    rows = torch.from_numpy(table.columns([*CENTRE, *TURN, *SCALE, "opacity", *DC, *bands]))
    higher = rows[:, 14:].reshape(table.count, 3, len(bands) // 3).transpose(1, 2)
    g = Gaussians(
        means=rows[:, :3].contiguous(),
        quats=rows[:, 3:7].contiguous(),
        log_scales=rows[:, 7:10].contiguous(),
        logit_opacities=rows[:, 10].contiguous(),
        sh=torch.cat([rows[:, None, 11:14], higher], dim=1),
    )
    return upright(g, up)


def highest(table: Table) -> int:
    """Degree of the spherical harmonics in a file of Gaussians.

    Raises:
        ValueError: a property is missing.
    """
    have = set(table.names)
    if "packed_position" in have:
        raise ValueError(
            f"{table.path} is a compressed .ply; make it a plain one first: splat-transform in.compressed.ply out.ply"
        )
    if missing := [name for name in (*CENTRE, *DC, "opacity", *SCALE, *TURN) if name not in have]:
        hint = "; a mesh is read with gaussians=mesh" if {*DC, "opacity"} <= set(missing) else ""
        raise ValueError(f"{table.path} holds no Gaussians: the properties {', '.join(missing)} are missing{hint}")
    rest = sum(name.startswith("f_rest_") for name in have)
    degree = math.isqrt(rest // 3 + 1) - 1
    if 3 * ((degree + 1) ** 2 - 1) != rest:
        raise ValueError(f"{table.path} has {rest} f_rest properties; 0, 9, 24 or 45 make degree 0, 1, 2 or 3")
    if gaps := [i for i in range(rest) if f"f_rest_{i}" not in have]:
        raise ValueError(f"{table.path} holds no Gaussians: the property f_rest_{gaps[0]} is missing")
    return degree


def upright(gaussians: Gaussians, up: Up) -> Gaussians:
    """Gaussians z-up, from axes that follow ``up``."""
    return turned(gaussians, upright_turn(up))


def upright_turn(up: str) -> int:
    """Quarter turns about x that bring axes that follow ``up`` to z-up."""
    return -_quarter_turns(up)


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
