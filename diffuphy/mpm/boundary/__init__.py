"""Walls that act on the grid: half-spaces, balls, boxes, cylinders and meshes; sticky, slipping or separating, with
Coulomb friction; still, moving, turning, or on a schedule.

``docs/boundaries.md`` says what they do and where they lie relative to the nodes.
"""

from diffuphy.mpm.boundary.kernels import make_contact
from diffuphy.mpm.boundary.kernels_hold import make_hold
from diffuphy.mpm.boundary.layout import (
    DAMPING,
    N_WALL,
    SLACK,
    Boundary,
    Signature,
    can_be_elastic,
    rows,
    signature,
    wall_gradients,
)
from diffuphy.mpm.boundary.mesh import Mesh, sdf_samples
from diffuphy.mpm.boundary.motion import Schedule, Vec, vector
from diffuphy.mpm.boundary.shapes import Box, Cylinder, HalfSpace, Kind, Solid, Sphere, container

__all__ = [
    "DAMPING", "N_WALL", "SLACK", "Boundary", "Box", "Cylinder", "HalfSpace", "Kind", "Mesh", "Schedule",
    "Signature", "Solid", "Sphere", "Vec", "can_be_elastic", "container", "make_contact", "make_hold", "rows",
    "sdf_samples", "signature", "vector", "wall_gradients",
]  # fmt: skip
