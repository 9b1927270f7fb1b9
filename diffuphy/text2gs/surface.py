"""A mesh of one's own as Gaussians: flat ones, evenly over its surface, in its colours."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from diffuphy.render.scenes import ply
from diffuphy.render.scenes.placement import Axis, Placement
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.normalise import check_turns, normalised
from diffuphy.types import Gaussians, Look
from diffuphy.workspace import Workspace

SPREAD = 0.8
"""Standard deviation along the surface over the distance a of the points, √(area / count): the optical depth is
2π · 0.8² = 4 times the opacity, and 98 % of the light stops."""

FLATNESS = 5.0
"""Standard deviation along the surface over that across it; flatter ones would be torn by a deforming body."""

FORMATS = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""What trimesh reads without further packages."""


def mesh_file(path: Path | str) -> Path:
    """The file itself.

    Raises:
        ValueError: nothing there, or a format that is not read.
    """
    path = Path(path).expanduser()
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"{path} must be one of {', '.join(FORMATS)}; convert it first")
    return path


@dataclass(frozen=True)
class LoadMesh:
    """Gaussians on the surface of a mesh, as the object of the film; what it encloses the particle stage fills.

    Points are drawn in proportion to area, one in each of ``count`` equal shares of it; colours come from the texture,
    the vertices or the faces, whichever the mesh has.
    """

    VERSION: ClassVar[int] = 1

    path: str = field(metadata={"content": mesh_file})
    """A .glb, .gltf, .obj, .off, .ply or .stl file. The result depends on what this file holds; of a format that keeps
    its textures beside it, changed ones alone are not noticed."""
    up: ply.Up = "y_up"
    """Which way is up in the file; y_up is what .glb prescribes."""
    turns: tuple[tuple[Axis, float], ...] = ()
    """Further rotations about the then upright axes, [axis, angle [deg]], the first one first."""
    count: int = 8000
    """Gaussians."""
    opacity: float = 0.95
    """Of each of them [-]."""
    sh_degree: int = 0
    """Degree of spherical harmonics: 0, a mesh has no colours that depend on the view."""
    seed: int = 0
    """Of the points."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "turns", check_turns(self.turns))
        ply.upright_turn(self.up)
        if self.count < 1 or not 0.0 < self.opacity < 1.0 or self.sh_degree != 0:
            raise ValueError(
                "count must be at least 1, opacity in (0, 1) and sh_degree 0, "
                f"got {self.count}, {self.opacity} and {self.sh_degree}"
            )
        mesh_file(self.path)

    def __call__(self, look: Look, *, work: Workspace | None = None) -> Gaussians:
        """The object: centred, longest side 2, z up.

        Raises:
            ValueError: a file that cannot be read, or a mesh without area.
        """
        work = work or Workspace()
        points, normals, rgb, area = self._points(self._mesh())
        spread = SPREAD * math.sqrt(area / self.count)
        log_scales = torch.tensor([spread, spread, spread / FLATNESS], dtype=torch.float64).log()
        g = Gaussians(
            means=points.float(),
            quats=from_z(normals).float(),
            log_scales=log_scales.float().expand(self.count, 3).clone(),
            logit_opacities=torch.full((self.count,), self.opacity).logit(),
            sh=from_rgb(rgb.float()),
        )
        g = Placement.turns(self.turns)(ply.upright(g, self.up))
        work.log(0, gaussians=len(g))
        return normalised(g.means, self.path)(g).to(work.device)

    def _mesh(self) -> Any:
        import trimesh  # pyright: ignore[reportMissingImports]  # an extra

        try:
            mesh = trimesh.load_mesh(mesh_file(self.path))
        except ImportError:
            raise
        except Exception as e:  # its readers raise whatever a broken file makes them stumble over
            raise ValueError(f"{self.path} is no mesh that can be read: {type(e).__name__}") from None
        if not len(mesh.faces) or not np.isfinite(mesh.vertices).all() or not float(mesh.area) > 0.0:
            raise ValueError(f"{self.path} has no surface: {len(mesh.faces)} triangles of no area, or broken vertices")
        return mesh

    def _points(self, mesh: Any) -> tuple[Tensor, Tensor, Tensor, float]:
        """Positions (n, 3), normals (n, 3) and rgb (n, 3) in [0, 1], float64; and the area."""
        g = torch.Generator().manual_seed(self.seed)
        corners = torch.from_numpy(np.array(mesh.vertices[mesh.faces], np.float64))  # (F, 3, 3)
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        share = torch.linalg.vector_norm(cross, dim=1).cumsum(0)
        u, a, b = torch.rand(3, self.count, generator=g, dtype=torch.float64)
        at = (torch.arange(self.count) + u) / self.count * share[-1]
        face = torch.searchsorted(share, at, right=True).clamp_max(len(share) - 1)
        root = a.sqrt()  # uniform in a triangle (Osada et al. 2002, eq. 1)
        weights = torch.stack([1 - root, root * (1 - b), root * b], dim=1)
        points = (weights[..., None] * corners[face]).sum(1)
        normals = torch.nn.functional.normalize(cross[face], dim=1)
        return points, normals, colours(mesh, face.numpy(), weights.numpy()), float(share[-1]) / 2


def colours(mesh: Any, face: np.ndarray, weights: np.ndarray) -> Tensor:
    """rgb (n, 3) in [0, 1], float64, at points of triangles ``face`` (n,) of a ``trimesh.Trimesh``, with barycentric
    ``weights`` (n, 3)."""
    visual, corner = mesh.visual, mesh.faces[face]
    uv, rgba = getattr(visual, "uv", None), None
    if uv is not None:
        rgba = visual.material.to_color((weights[..., None] * uv[corner]).sum(1))
    elif visual.kind == "vertex":
        rgba = (weights[..., None] * visual.vertex_colors[corner]).sum(1)
    elif visual.kind == "face":
        rgba = visual.face_colors[face]
    elif visual.kind == "texture":
        rgba = visual.material.main_color
    if rgba is None:
        rgba = np.full(4, 255 / 2)  # a mesh without colours is grey
    return torch.from_numpy(np.broadcast_to(np.asarray(rgba, np.float64)[..., :3] / 255, (len(face), 3)).copy())


def from_z(normals: Tensor) -> Tensor:
    """Quaternions wxyz (n, 4) of the shortest rotations that take z to the unit vectors ``normals`` (n, 3)."""
    x, y, z = normals.unbind(1)
    q = torch.stack([1 + z, -y, x, torch.zeros_like(x)], dim=1)
    q[z < -1 + 1e-9] = q.new_tensor([0.0, 1.0, 0.0, 0.0])
    return torch.nn.functional.normalize(q, dim=1)
