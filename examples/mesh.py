"""A mesh is filmed like anything else: here a knot, in the colours of its vertices.

Its material is stated; ``material=video_sds`` finds it, as in other films.

    python examples/mesh.py gaussians.path=bear.glb                  # yours: .glb .gltf .obj .off .ply .stl
    python examples/mesh.py experiment=tiny                          # without one, a trefoil knot is written

Wants trimesh (pip install 'diffuphy[mesh]'). Writes outputs/examples/knot.glb and the run's folder,
outputs/examples/runs/a-rubber-knot-bouncing-…/. 10 seconds of one core, with experiment=tiny.
"""

import sys
from pathlib import Path

import numpy as np

import diffuphy
from diffuphy.making import Made


def write_knot(file: Path, along: int = 240, around: int = 24, radius: float = 0.5) -> None:
    """A tube about c(t) = (sin t + 2 sin 2t, cos t − 2 cos 2t, −sin 3t), coloured along its length."""
    import trimesh

    t = np.linspace(0, 2 * np.pi, along, endpoint=False)
    c = np.stack([np.sin(t) + 2 * np.sin(2 * t), -np.sin(3 * t), np.cos(t) - 2 * np.cos(2 * t)], 1)
    ahead = np.roll(c, -1, 0) - np.roll(c, 1, 0)
    side = np.cross(ahead, c)
    up = np.cross(side, ahead)
    side, up = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (side, up))
    a = np.linspace(0, 2 * np.pi, around, endpoint=False)[None, :, None]
    points = c[:, None] + radius * (np.cos(a) * side[:, None] + np.sin(a) * up[:, None])
    i, j = np.divmod(np.arange(along * around), around)
    right, above = ((i + 1) % along) * around + j, i * around + (j + 1) % around
    over = ((i + 1) % along) * around + (j + 1) % around
    here = np.arange(along * around)
    faces = np.concatenate([np.stack([here, right, over], 1), np.stack([here, over, above], 1)])
    rgb = 0.55 + 0.4 * np.cos(2 * np.pi * (i / along)[:, None] - np.array([0.0, 2.1, 4.2]))
    knot = trimesh.Trimesh(points.reshape(-1, 3), faces, vertex_colors=(255 * rgb).astype(np.uint8))
    file.parent.mkdir(parents=True, exist_ok=True)
    knot.export(file)


def main(*settings: str) -> Made:
    given = list(settings)
    if not any(s.startswith("gaussians.path=") for s in given):
        mesh = Path("outputs/examples/knot.glb")
        write_knot(mesh)
        given.append(f"gaussians.path={mesh}")
    made = diffuphy.film(
        "a rubber knot bouncing", "gaussians=mesh", "material=stated", "store=outputs/examples", *given
    )
    print(made.folder)
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
