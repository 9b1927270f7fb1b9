"""Drives: what acts on particles besides stress, gravity and walls. Impulses and force fields accelerate them, others
hold them still or move them as a rigid body. ``docs/boundaries.md`` has their formulas.
"""

from diffuphy.mpm.drive.bounds import speed_bound
from diffuphy.mpm.drive.drives import (
    MAX_DRIVES,
    Acceleration,
    Attractor,
    Drag,
    Drive,
    Held,
    Impulse,
    Release,
    Vortex,
    check_drives,
)
from diffuphy.mpm.drive.kernels import make_drives
from diffuphy.mpm.drive.layout import N_DRIVE, TICK, Signature, drive_rows, drive_signature, mass_gradient, tags
from diffuphy.mpm.drive.select import InBall, InBox, InCylinder

__all__ = [
    "MAX_DRIVES", "N_DRIVE", "TICK", "Acceleration", "Attractor", "Drag", "Drive", "Held", "Impulse", "InBall", "InBox",
    "InCylinder", "Release", "Signature", "Vortex", "check_drives", "drive_rows", "drive_signature", "make_drives",
    "mass_gradient", "speed_bound", "tags",
]  # fmt: skip
