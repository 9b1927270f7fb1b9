"""Walls of any shape: a closed triangle mesh, sampled once as a signed distance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from diffuphy.mpm.boundary.kernels_mesh import signed_distance
from diffuphy.mpm.boundary.motion import Vec, rotation_matrix, vector
from diffuphy.mpm.boundary.shapes import Solid

MARGIN = 2
"""Samples beyond the mesh on every side, so that its surface lies inside the samples."""

MAX_SAMPLES = 2**24
"""Most samples of all meshes of a scene: a float32 row counts no further, and they take 64 MB there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh(Solid):
    """A solid bounded by triangles.  φ is the trilinear interpolation of its signed distance at samples a spacing h
    apart, with error O(h²) where the surface is smooth; its gradient is the normal.

    The sign is that of the winding number (Barill et al. 2018), so small holes and overlapping parts do no harm.
    Triangles are counter-clockwise seen from outside. From a file, with a package that reads it:
    ``t = trimesh.load_mesh(path); Mesh(vertices=t.vertices, faces=t.faces)``. Two meshes are equal only if they are the
    same object.
    """

    vertices: Any
    """Corners in the frame of the mesh, shape (V, 3) [m]; its origin is put at ``center``."""
    faces: Any
    """Corners of each triangle, shape (F, 3), from 0."""
    rotation: Vec = (0.0, 0.0, 0.0)
    """Rotation vector of its orientation, axis times angle [rad]."""
    resolution: int = 48
    """Samples along the longest side; they are found once, at some 30 µs each on one core. Details finer than the grid
    are not felt, and objects are 28 cells long unless told otherwise: 48 is finer."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "rotation", vector("rotation", self.rotation))
        x, f = np.array(self.vertices, dtype=np.float64), np.array(self.faces)
        if x.ndim != 2 or x.shape[1:] != (3,) or len(x) < 4:
            raise ValueError(f"vertices must have shape (V, 3) with V ≥ 4, got {x.shape}")
        if not np.isfinite(x).all():
            k = int(np.argwhere(~np.isfinite(x))[0, 0])
            raise ValueError(f"vertices must be finite, got {x[k].tolist()} in row {k}")
        if f.ndim != 2 or f.shape[1:] != (3,) or len(f) < 4 or f.dtype.kind not in "iu":
            raise ValueError(f"faces must be integers of shape (F, 3) with F ≥ 4, got {f.dtype} {f.shape}")
        if f.min() < 0 or f.max() >= len(x):
            k = int(np.argwhere((f < 0) | (f >= len(x)))[0, 0])
            raise ValueError(f"faces must name vertices 0 … {len(x) - 1}, got {f[k].tolist()} in row {k}")
        if not 8 <= self.resolution <= 256:
            raise ValueError(f"resolution must be between 8 and 256 samples, got {self.resolution}")
        a, b, c = (x[f[:, k]] for k in range(3))
        volume = float(np.einsum("fi,fi->", a - x.mean(0), np.cross(b - x.mean(0), c - x.mean(0)))) / 6
        if not volume > 0.0:
            raise ValueError(
                f"the triangles enclose {volume:.3g} m³; they must enclose a volume and be counter-clockwise seen from "
                "outside: close the mesh, or swap two columns of faces"
            )
        for name, value in (("vertices", x), ("faces", f.astype(np.int32))):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def extent(self) -> float:
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @property
    def thickness(self) -> float:
        """Smallest side of the box around it [m]: what it cannot be thicker than."""
        return float((self.vertices.max(0) - self.vertices.min(0)).min())

    @property
    def frame(self) -> np.ndarray:
        return rotation_matrix(np.asarray(self.rotation))

    @property
    def spacing(self) -> float:
        """Distance h of samples [m]."""
        return float((self.vertices.max(0) - self.vertices.min(0)).max()) / (self.resolution - 1)

    @property
    def corner(self) -> np.ndarray:
        """Lowest sample in the frame of the mesh, shape (3,) [m]."""
        return self.vertices.min(0) - MARGIN * self.spacing

    @property
    def shape(self) -> tuple[int, int, int]:
        """Samples along each axis."""
        sides = self.vertices.max(0) - self.vertices.min(0)
        nx, ny, nz = (math.ceil(side / self.spacing - 1e-9) + 1 + 2 * MARGIN for side in sides)
        return nx, ny, nz

    @cached_property
    def samples(self) -> np.ndarray:
        """Signed distance at the samples, last axis fastest, shape (nx ny nz,) [m]; found once."""
        return signed_distance(self.vertices, self.faces, self.corner, self.spacing, self.shape)


def sdf_samples(boundaries: Sequence[Any]) -> np.ndarray:
    """The samples of all meshes of a scene, one after the other in its order, shape (n,) float64 [m]; none: (0,).

    Raises:
        ValueError: more than MAX_SAMPLES.
    """
    meshes = [b for b in boundaries if isinstance(b, Mesh)]
    total = sum(math.prod(m.shape) for m in meshes)
    if total > MAX_SAMPLES:
        raise ValueError(
            f"the meshes of a scene have {total} samples, at most {MAX_SAMPLES} are allowed; lower their resolution"
        )
    return np.concatenate([m.samples for m in meshes]) if meshes else np.zeros(0)
