"""``python -m diffuphy.export RUN FORMAT ...``, or ``diffuphy-export`` when installed: the files of a finished run."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="diffuphy-export", description="Write a finished run in other formats.")
    p.add_argument("run", help="its folder, outputs/runs/NAME")
    p.add_argument("formats", nargs="*", help="mp4, webm, gif, png, ply, npz, html, sog, spz, ... (default: list them)")
    p.add_argument("-o", "--out", metavar="FOLDER", help="where to write (default: the folder of the run)")
    p.add_argument("--up", default="y_down", help="axes of .ply and compressed files: y_down, y_up or z_up (y_down)")
    p.add_argument("--every", type=int, default=1, metavar="N", help="write every N-th frame (1)")
    p.add_argument("--gaussians", type=int, default=20_000, metavar="N", help="most Gaussians of html (20000)")
    p.add_argument("--page-frames", type=int, default=60, metavar="N", help="most frames of html (60)")
    p.add_argument("--resolution", type=int, default=96, metavar="N", help="cells along the object, for meshes (96)")
    p.add_argument("--alone", action="store_true", help="leave out what stands around the object")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Returns:
        Exit status: 0 done, 2 an error the user can mend.
    """
    given = parser().parse_args(argv)
    from diffuphy.formats import FORMATS, Options, Run, check, write

    try:
        run = Run.at(Path(given.run))
        if not given.formats:
            for name, writer in FORMATS.items():
                print(f"{name:<16}{(writer.__doc__ or '').splitlines()[0]}")
            return 0
        options = Options(
            Path(given.out or given.run), given.up, given.every, given.gaussians, given.page_frames, given.resolution,
            not given.alone,
        )  # fmt: skip
        for name in check(given.formats):
            for path in write(run, [name], options)[name]:
                print(f"{name:<16}{os.path.relpath(path)}  {size(path) / 1e6:.2f} MB")
    except (ValueError, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def size(path: Path) -> int:
    """Bytes of a file, or of all in a folder."""
    return sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) if path.is_dir() else path.stat().st_size


if __name__ == "__main__":
    sys.exit(main())
