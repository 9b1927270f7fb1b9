"""The box of a scene file in the frame of a film: x = Q (x_box − (1, 1, 1)) + (0, 0, height), metres in both.

There the object's middle is put at (1, 1, 1) and any direction may be up; here z is up and the floor is z = 0. Q is the
smallest turn that takes their vertical to z. It maps axes to axes, so that boxes stay boxes.
"""

from dataclasses import dataclass

import numpy as np

from diffuphy.mpm.boundary import Vec

MIDDLE = (1.0, 1.0, 1.0)
"""Where the middle of the object is in the box [m]."""


@dataclass(frozen=True)
class Frame:
    """The map of a scene file."""

    up: Vec = (0.0, 0.0, 1.0)
    """The vertical of the box, along one of its axes."""
    height: float = 0.0
    """Height of the middle of the object [m]; 0 is the frame of the particles."""

    def __post_init__(self) -> None:
        if np.count_nonzero(self.up) != 1:
            raise ValueError(
                f"mpm_space_vertical_upward_axis must lie along an axis, got {self.up}: turn the object until it does"
            )

    @property
    def turn(self) -> np.ndarray:
        """Q, shape (3, 3): a signed permutation."""
        z, up = np.array([0.0, 0.0, 1.0]), np.sign(self.up)
        axis, cosine = np.cross(up, z), float(up @ z)
        if cosine < 0.0:  # upside down: half a turn about x
            return np.diag([1.0, -1.0, -1.0])
        K = np.cross(np.eye(3), axis)  # rows e_k × axis, so that K v = axis × v
        return np.eye(3) * cosine + K + np.outer(axis, axis) if axis.any() else np.eye(3)

    def vector(self, v: Vec) -> Vec:
        """A direction, a velocity, an acceleration."""
        x, y, z = (float(c) + 0.0 for c in self.turn @ np.asarray(v))
        return x, y, z

    def point(self, x: Vec) -> Vec:
        """A place [m]."""
        return _tuple(self.turn @ (np.asarray(x) - MIDDLE) + (0.0, 0.0, self.height))

    def edges(self, half: Vec) -> Vec:
        """Edges of a box from its half ones [m]."""
        return _tuple(2.0 * np.abs(self.turn) @ np.asarray(half))

    def corners(self, point: Vec, half: Vec) -> tuple[Vec, Vec]:
        """Lowest and highest corner of the box point ± half [m]."""
        center, edge = np.asarray(self.point(point)), np.asarray(self.edges(half))
        return _tuple(center - edge / 2), _tuple(center + edge / 2)


def _tuple(v: np.ndarray) -> Vec:
    """A length along each axis, to the picometre: 0.48 − 1 is −0.52 again."""
    x, y, z = (round(float(c), 12) + 0.0 for c in v)
    return x, y, z
