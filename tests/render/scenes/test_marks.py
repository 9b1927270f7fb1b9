"""Marks of Gaussians."""

from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.render.scenes.marks import marks


def write_ply(path: Path, values, name: str = "label", kind: str = "int") -> Path:
    """A .ply file of one property."""
    rows = "".join(f"{v}\n" for v in values)
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(values)}\nproperty {kind} {name}\nend_header\n{rows}")
    return path


@pytest.mark.parametrize("kind", [np.bool_, np.uint8, np.int32, np.int64])
def test_an_array_of_numpy_is_read(kind, tmp_path):
    np.save(tmp_path / "m.npy", np.array([0, 1, 1], kind))
    assert marks(tmp_path / "m.npy", 3).tolist() == [0, 1, 1]


def test_a_property_of_a_ply_file_is_read(tmp_path):
    found = marks(write_ply(tmp_path / "m.ply", [3, 0, 7]), 3)
    assert found.dtype == torch.int64 and found.tolist() == [3, 0, 7]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.zeros(4, np.int64), "for 3 Gaussians"),
        (np.zeros((3, 1), np.int64), "for 3 Gaussians"),
        (np.zeros(3), "whole numbers, got float64"),
        (np.zeros(9999, np.int64), "bytes"),
        (np.array([None, 1, 2]), "no .npy file of numbers"),
        (np.array(["a", "b", "c"]), "whole numbers"),
    ],
)
def test_other_arrays_are_refused(values, says, tmp_path):
    np.save(tmp_path / "m.npy", values, allow_pickle=True)
    with pytest.raises(ValueError, match=says):
        marks(tmp_path / "m.npy", 3)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "m.npy").write_bytes(b"no array")
    for path, says in (
        (tmp_path / "m.npy", "no .npy file"),
        (tmp_path / "m.txt", "must be a .npy file"),
        (tmp_path / "n.npy", "there is no file"),
        (write_ply(tmp_path / "a.ply", [1, 2, 3], name="class"), "no property label"),
        (write_ply(tmp_path / "b.ply", [1, 2.5, 3], kind="float"), "not whole"),
        (write_ply(tmp_path / "c.ply", ["1", "nan", "3"], kind="float"), "not whole"),
    ):
        with pytest.raises(ValueError, match=says):
            marks(path, 3)
