"""What a film can be taken home as: video, picture sequences, splats, meshes, arrays, one page that plays in 3D.

    python examples/export_formats.py
    python examples/export_formats.py experiment=tiny

The same of a finished run: ``python -m diffuphy.export outputs/runs/NAME gif glb html --every 2``, and at once with
the film: ``python train.py prompt=... outputs=[mp4,glb]``. Meshes want trimesh, the page viser
(pip install 'diffuphy[mesh,viewer]'). Writes outputs/examples/export/. 15 seconds of one core, with experiment=tiny.
"""

import sys
from pathlib import Path

import diffuphy
from diffuphy.formats import Options, Run, write


def main(
    *settings: str, formats: tuple[str, ...] = ("webm", "gif", "ply", "glb", "npz", "html")
) -> dict[str, list[Path]]:
    made = diffuphy.film("a jelly duck bouncing", "store=outputs/examples", *settings)
    out = Options(Path("outputs/examples/export"), up="y_down", every=5, resolution=64)
    files = write(Run.at(made.folder), formats, out)
    for name, paths in files.items():
        size = sum(f.stat().st_size for p in paths for f in ([p] if p.is_file() else p.rglob("*")) if f.is_file())
        print(f"{name:<6}{len(paths):3d} × {paths[0]}, {size / 1e6:.2f} MB")
    return files


if __name__ == "__main__":
    main(*sys.argv[1:])
