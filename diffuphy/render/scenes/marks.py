"""A whole number for each Gaussian of a file, painted with another program: masks and labels."""

import zipfile
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from diffuphy.render.scenes.ply_table import Table

SUFFIXES = (".npy", ".ply")


def marks_file(path: Path | str | None) -> tuple[Path, ...]:
    """The file of marks; none for None.

    Raises:
        ValueError: nothing there, or another format.
    """
    if path is None:
        return ()
    path = Path(path).expanduser()
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path} must be a .npy file, or a .ply file with the property label")
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    return (path,)


def marks(path: Path | str, count: int) -> Tensor:
    """The marks of ``count`` Gaussians, in the order of their file, shape (count,), int64.

    A .npy file holds them as booleans or whole numbers; a .ply file, which may be that of the Gaussians, has them as
    the property ``label``.

    Raises:
        ValueError: no such file, numbers that are not whole, or another number of them.
    """
    (file,) = marks_file(path)
    values = _ply(file) if file.suffix.lower() == ".ply" else _npy(file, count)
    if values.shape != (count,):
        raise ValueError(
            f"{file} has marks of shape {values.shape} for {count} Gaussians; it must have one for each, in the order "
            "of the scene's file"
        )
    with np.errstate(invalid="ignore"):  # what is no number differs from itself, and is refused
        whole = values.astype(np.int64)
    if not np.array_equal(whole, values):
        raise ValueError(f"{file} has marks that are not whole numbers, such as {values[whole != values][0]}")
    return torch.from_numpy(whole)


def _npy(file: Path, count: int) -> np.ndarray:
    most = 8 * count + 4096  # int64, and a header
    if file.stat().st_size > most:
        raise ValueError(f"{file} has {file.stat().st_size} bytes; {count} marks take at most {most}")
    try:
        values = np.load(file)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as e:
        raise ValueError(f"{file} is no .npy file of numbers: {type(e).__name__}") from None
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "biu":
        kind = values.dtype if isinstance(values, np.ndarray) else type(values).__name__
        raise ValueError(f"{file} must hold booleans or whole numbers, got {kind}")
    return values


def _ply(file: Path) -> np.ndarray:
    table = Table.of(file)
    if "label" not in table.names:
        raise ValueError(f"{file} has no property label; it has {', '.join(table.names[:20])}")
    return table.columns(["label"])[:, 0]
