"""Gaussians of every frame: .ply, and what splat-transform makes of it."""

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from diffuphy.formats.options import Options
from diffuphy.formats.run import Run
from diffuphy.render.scenes import ply as layout

TOOL = "splat-transform"
"""Compresses Gaussians (PlayCanvas, MIT)."""


def ply(run: Run, options: Options) -> list[Path]:
    """One file of Gaussians a frame, ``ply/frame_0000.ply``, in the layout of 3D Gaussian splatting."""
    folder = options.folder / "ply"
    _frames(run, options, folder)
    return [folder]


def _frames(run: Run, options: Options, folder: Path) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for t in options.frames(len(run.trajectory.x)):
        files.append(folder / f"frame_{t:04d}.ply")
        layout.write(files[-1], run.frame(t, options.around), up=options.up)
    return files


def compressed(kind: str) -> Callable[[Run, Options], list[Path]]:
    """The writer of one compressed kind: sog, spz or compressed.ply."""

    def write(run: Run, options: Options) -> list[Path]:
        tool = find()
        folder = options.folder / kind.replace(".", "_")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as scratch:
            for file in _frames(run, options, Path(scratch)):
                target = folder / f"{file.stem}.{kind}"
                done = subprocess.run([tool, "-q", "-w", file, target], capture_output=True, text=True, check=False)
                if done.returncode or not target.is_file():
                    raise ValueError(f"{TOOL} could not write {target.name}: {(done.stderr or done.stdout).strip()}")
        return [folder]

    write.__doc__ = f"One file a frame, ``{kind.replace('.', '_')}/frame_0000.{kind}``, by {TOOL}."
    return write


def find() -> str:
    """The program that compresses.

    Raises:
        ValueError: it is not installed.
    """
    tool = shutil.which(TOOL)
    if tool is None:
        raise ValueError(
            f"compressed Gaussians are written by {TOOL}, which is not on the PATH: "
            "npm install -g @playcanvas/splat-transform (2.7.1 runs with Node 20)"
        )
    return tool
