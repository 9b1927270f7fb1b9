"""Captured scenes as other programs leave them: a file of Gaussians, or the folder of a trained scene.

A folder is that of the original code (Kerbl et al. 2023): ``point_cloud/iteration_N/point_cloud.ply`` and
``cameras.json``.
"""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diffuphy.render.scenes import ply, spz
from diffuphy.render.scenes.ply_table import Table
from diffuphy.render.sh import from_rgb
from diffuphy.types import Camera, Gaussians

SPLAT = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
"""One Gaussian of a .splat file, 32 bytes: scales as they are, opacity and colour in 255ths, a quaternion wxyz in
128ths about 128 (github.com/antimatter15/splat, ``convert.py``)."""

MAX_CAMERAS = 2**26
"""Longest cameras.json [byte]; 100 000 cameras take about 40 MB."""


def source(path: Path | str) -> Path:
    """The file of Gaussians that ``path`` means: itself, or in a folder that of the newest iteration.

    Raises:
        ValueError: nothing there, a folder without such a file, or a format that is not read.
    """
    path = Path(path).expanduser()
    if path.is_dir():
        found = {
            int(m[1]): file
            for file in path.glob("point_cloud/iteration_*/point_cloud.ply")
            if (m := re.fullmatch(r"iteration_(\d{1,9})", file.parent.name))
        }
        if not found:
            raise ValueError(f"the folder {path} has no point_cloud/iteration_N/point_cloud.ply; name a .ply file")
        path = found[max(found)]
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    if path.suffix.lower() not in (".ply", ".splat", ".spz"):
        raise ValueError(
            f"{path} is no .ply, .splat or .spz file; a mesh is read with gaussians=mesh, others are converted "
            f"first: splat-transform {path.name} out.ply"
        )
    return path


def count(path: Path | str) -> int:
    """Gaussians in a file; reads its header alone."""
    path = source(path)
    kind = path.suffix.lower()
    return Table.of(path).count if kind == ".ply" else spz.header(path)[1] if kind == ".spz" else _splats(path)


def read(path: Path | str, *, up: ply.Up = "y_down", degree: int | None = None) -> Gaussians:
    """Gaussians, float32 and z-up, of a .ply, .splat or .spz file or of a folder; see ``ply.read``."""
    path = source(path)
    if path.suffix.lower() == ".spz":
        return spz.read(path, up=up, degree=degree)
    return ply.read(path, up=up, degree=degree) if path.suffix.lower() == ".ply" else read_splat(path, up=up)


def read_splat(path: Path, *, up: ply.Up = "y_down") -> Gaussians:
    """Gaussians of a .splat file; their colours do not depend on the view.

    Opacities 0 and 255 are read as half a level inside, so that they have a logit.

    Raises:
        ValueError: the length is no multiple of 32 bytes.
    """
    n = _splats(path)
    rows = np.fromfile(path, SPLAT, n)
    rgba = torch.from_numpy(rows["rgba"].astype(np.float32))
    g = Gaussians(
        means=torch.from_numpy(rows["mean"].astype(np.float32)),
        quats=(torch.from_numpy(rows["quat"].astype(np.float32)) - 128) / 128,
        log_scales=torch.from_numpy(rows["scale"].astype(np.float32)).log(),
        logit_opacities=torch.logit(rgba[:, 3].clamp(0.5, 254.5) / 255),
        sh=from_rgb(rgba[:, :3] / 255),
    )
    return ply.upright(g, up)


def _splats(path: Path) -> int:
    size = path.stat().st_size
    if size % SPLAT.itemsize:
        raise ValueError(f"{path} is no .splat file, or is cut off: {size} bytes are no multiple of {SPLAT.itemsize}")
    return size // SPLAT.itemsize


def cameras_file(path: Path | str) -> Path:
    """The cameras.json that ``path`` means: itself, or that of a scene's folder.

    Raises:
        ValueError: no such file.
    """
    path = Path(path).expanduser()
    path = path / "cameras.json" if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    return path


def cameras(path: Path | str) -> tuple[Camera, ...]:
    """The cameras of a trained scene, one a picture, in the axes of its file.

    The original code stores centre and orientation of the camera in the world, rows of the rotation, and focal lengths
    in pixels; the optical axis goes through the middle of the picture.

    Args:
        path: the scene's folder, or its cameras.json.

    Raises:
        ValueError: no such file, or one that holds no cameras.
    """
    path = cameras_file(path)
    if path.stat().st_size > MAX_CAMERAS:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; at most {MAX_CAMERAS} are read")
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as e:
        raise ValueError(f"{path} is no JSON: {type(e).__name__}") from None
    if not isinstance(entries, list):
        raise ValueError(f"{path} must hold a list of cameras, got {type(entries).__name__}")
    return entries_of(path, entries)


def entries_of(path: Path, entries: list[Any], first: int = 0) -> tuple[Camera, ...]:
    """The cameras of entries of a cameras.json, the first of which is number ``first`` there."""
    return tuple(_camera(path, first + i, entry) for i, entry in enumerate(entries))


def _camera(path: Path, index: int, entry: Any) -> Camera:
    try:
        width, height = int(entry["width"]), int(entry["height"])
        focal = float(entry["fx"]), float(entry["fy"])
        R = torch.tensor(entry["rotation"], dtype=torch.float64)
        centre = torch.tensor(entry["position"], dtype=torch.float64)
    except (KeyError, TypeError, ValueError, OverflowError, RuntimeError) as e:
        raise ValueError(f"{path}: camera {index} is incomplete: {type(e).__name__} {e}") from None
    return placed_camera(f"{path}: camera {index}", R, centre, focal, (width, height), (width / 2, height / 2))


def placed_camera(
    what: str,
    R: torch.Tensor,
    centre: torch.Tensor,
    focal: tuple[float, float],
    size: tuple[int, int],
    principal: tuple[float, float],
) -> Camera:
    """One camera.

    Args:
        what: which, for errors.
        R: its axes in the world, OpenCV's, as columns, shape (3, 3).
        centre: where it is, shape (3,).
        focal: f_x and f_y [px].
        size: width and height [px].
        principal: where the optical axis meets the picture [px].

    Raises:
        ValueError: no rotation, or numbers that no camera has.
    """
    width, height = size
    if R.shape != (3, 3) or centre.shape != (3,) or not (0 < width < 2**16 and 0 < height < 2**16):
        raise ValueError(f"{what} needs a 3 x 3 rotation, a position, and sides of 1 to 65535 px")
    unit = (R @ R.mT - torch.eye(3, dtype=R.dtype)).abs().amax() < 1e-3 and torch.det(R) > 0
    if not (
        unit and centre.isfinite().all() and all(0 < f < math.inf for f in focal) and math.isfinite(sum(principal))
    ):
        raise ValueError(f"{what} has no proper rotation, a centre or a focal length that is no number")
    view = torch.eye(4, dtype=torch.float64)
    view[:3, :3], view[:3, 3] = R.mT, -R.mT @ centre
    K = torch.tensor([[focal[0], 0.0, principal[0]], [0.0, focal[1], principal[1]], [0.0, 0.0, 1.0]])
    return Camera(view[None].float(), K[None], width, height)
