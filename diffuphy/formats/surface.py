"""The surface of every frame as a mesh with colours: where matter begins, by marching cubes.

    φ(x) = Σ_p V_p J_p N(x; x_p, σ²),   surface φ = c with |{φ > c}| = Σ_p V_p J_p

The density that is asked is that of the particles, which fill the body, not that of the Gaussians, which are its skin
and would have a second surface inside (DreamGaussian, Tang et al. 2024, section 3.2, queries them). φ is 1 inside and
½ on a flat boundary; the level c that keeps the volume of the matter is a little lower where the boundary is curved.
Colours are those of the nearest Gaussians.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffuphy.formats.options import Options
from diffuphy.formats.run import Run
from diffuphy.geometry import volume_ratio
from diffuphy.render.sh import to_rgb

BLUR = 1.0
"""σ over the spacing of the particles [-]: φ varies by some per cent between them, and what is finer is
smoothed."""

REACH = 4.0
"""Distance at which a particle's density ends, over σ [-]: e⁻⁸ of its middle."""

NEAREST = 4
"""Gaussians whose mean colour a vertex has."""

CLEAR = 1e-3
"""Least distance of φ at a node from the level [-]: moves the surface by less than a hundredth of a cell."""

MOST = 2**27
"""Most cells of a grid: half a gigabyte."""


@dataclass(frozen=True)
class Mesh:
    """A closed surface, or several."""

    vertices: Tensor
    """Shape (V, 3) [m]."""
    faces: Tensor
    """Corners of each triangle, counter-clockwise seen from outside, shape (F, 3)."""
    colors: Tensor
    """Of each vertex, shape (V, 3), in [0, 1]."""


def meshes(kind: str) -> Callable[[Run, Options], list[Path]]:
    """The writer of one kind of mesh: glb, obj or mesh.ply."""

    def write(run: Run, options: Options) -> list[Path]:
        trimesh = _trimesh()
        folder = options.folder / kind.replace(".", "_")
        folder.mkdir(parents=True, exist_ok=True)
        for t in options.frames(len(run.trajectory.x)):
            mesh = surface(run, t, options.resolution)
            points = mesh.vertices.numpy()
            if kind == "glb":
                points = points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
            made = trimesh.Trimesh(
                points, mesh.faces.numpy(), vertex_colors=(mesh.colors * 255).round().byte().numpy(), process=False
            )
            made.export(folder / f"frame_{t:04d}.{kind.rpartition('.')[2]}")
        return [folder]

    write.__doc__ = f"One mesh with colours a frame, ``{kind.replace('.', '_')}/frame_0000.{kind.rpartition('.')[2]}``."
    return write


def _trimesh() -> Any:
    try:
        import trimesh  # pyright: ignore[reportMissingImports]  # an extra
    except ModuleNotFoundError:
        raise ValueError(
            "meshes are written by trimesh, which is not installed: pip install 'diffuphy[mesh]'"
        ) from None
    return trimesh


def surface(run: Run, t: int, resolution: int) -> Mesh:
    """The surface of frame ``t`` on a grid of ``resolution`` cells along the longest side of the object at rest."""
    from scipy.spatial import KDTree

    particles, film = run.particles, run.trajectory
    x, Fe = film.x[t], film.Fe
    rest = particles.x
    cell = float((rest.amax(0) - rest.amin(0)).amax()) / resolution
    volume = particles.vol * volume_ratio(film.F[t], None if Fe is None else Fe[t]).to(particles.vol)
    vertices, faces = level(x, volume, cell, max(BLUR * particles.spacing, cell))
    means, _ = run.moved(t)
    count = min(NEAREST, len(means))
    index = KDTree(means.numpy()).query(vertices.numpy(), k=list(range(1, count + 1)))[1]
    rgb = to_rgb(run.skin.gaussians.sh).clamp(0, 1)
    return Mesh(vertices, faces, rgb[torch.from_numpy(index)].mean(1))


def level(x: Tensor, volume: Tensor, cell: float, sigma: float) -> tuple[Tensor, Tensor]:
    """Vertices (V, 3) [m] and triangles (F, 3) of φ = c, which enclose the volume of the matter.

    Args:
        x: particles, shape (N, 3) [m].
        volume: of each, in this state, shape (N,) [m³].
        cell: side of a cell of the grid [m].
        sigma: of the blur [m].

    Raises:
        ValueError: a grid that would be too large, or nothing that is dense enough for a surface.
    """
    phi, origin = density(x, volume, cell, sigma)
    if not float(phi.amax()) > 0.5:
        raise ValueError(
            f"there is no surface: the densest place is filled by {float(phi.amax()):.0%}: the particles have come "
            "apart"
        )
    inside = round(float(volume.sum()) / cell**3)
    c = float(phi.flatten().kthvalue(max(1, phi.numel() - inside)).values)
    # where φ = c at a node, several vertices would be in one place, and readers that join them would open the surface
    phi = torch.where((phi - c).abs() < CLEAR, c + CLEAR * torch.where(phi > c, 1.0, -1.0), phi)
    import warp as wp
    from warp.geometry import IsoSurfaceMarchingCubes

    upper = origin + cell * (torch.tensor(phi.shape) - 1)
    vertices, faces = IsoSurfaceMarchingCubes.extract(
        wp.from_torch(phi.contiguous()), c, lower=wp.vec3(*origin.tolist()), upper=wp.vec3(*upper.tolist())
    )
    return wp.to_torch(vertices).clone(), wp.to_torch(faces).reshape(-1, 3).flip(1)  # matter is where φ is high


def density(x: Tensor, volume: Tensor, cell: float, sigma: float) -> tuple[Tensor, Tensor]:
    """φ at the nodes of a grid (nx, ny, nz), float32, and where its first node is, (3,) [m]: shares of the volumes at
    the eight nodes around each particle, blurred by a Gaussian."""
    margin = REACH * sigma + 2 * cell
    origin = x.amin(0) - margin
    shape = [math.ceil(n) + 1 for n in ((x.amax(0) + margin - origin) / cell).tolist()]
    if math.prod(shape) > MOST:
        raise ValueError(
            f"the surface needs a grid of {shape[0]} x {shape[1]} x {shape[2]} cells, at most {MOST} are made; "
            "lower the resolution: the matter has spread far"
        )
    at = (x - origin) / cell
    corner = at.floor()
    f, i = at - corner, corner.long()
    phi = torch.zeros(math.prod(shape), dtype=x.dtype)
    for k in range(8):
        step = torch.tensor([k >> 2 & 1, k >> 1 & 1, k & 1])
        w = torch.where(step.bool(), f, 1 - f).prod(1)
        a, b, c = (i + step).unbind(1)
        phi.index_add_(0, (a * shape[1] + b) * shape[2] + c, volume / cell**3 * w)
    # a Gaussian is a product of three, and its transform is known
    spectrum = torch.fft.rfftn(phi.reshape(shape))
    for axis, n in enumerate(shape):
        frequency = (torch.fft.rfftfreq if axis == 2 else torch.fft.fftfreq)(n).to(x)
        blur = torch.exp(-0.5 * (2 * math.pi * frequency * sigma / cell) ** 2)
        spectrum = spectrum * blur.reshape([-1 if a == axis else 1 for a in range(3)])
    return torch.fft.irfftn(spectrum, s=shape).float(), origin
