"""Numbers of a scene as tensors, so that a loss can be differentiated in them."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from diffuphy.mpm.scene import Scene


@dataclass(frozen=True)
class Controls:
    """What replaces the numbers of a scene; None leaves them.

    The gradient in a velocity is that of the law of contact: which nodes a moving wall governs is held fixed.
    """

    gravity: Tensor | None = None
    """Acceleration, shape (3,) [m/s²]."""
    friction: Tensor | None = None
    """Coulomb coefficient of every wall, shape (W,) [-]."""
    velocity: Tensor | None = None
    """Velocity of every wall, shape (W, 3) [m/s]."""
    angular_velocity: Tensor | None = None
    """Angular velocity of every wall, shape (W, 3) [rad/s]."""

    def tensors(self) -> tuple[Tensor | None, ...]:
        """In the order of the fields."""
        return self.gravity, self.friction, self.velocity, self.angular_velocity

    def applied(self, scene: Scene) -> Scene:
        """The scene with these numbers.

        Raises:
            ValueError: a shape that does not fit the scene.
        """
        W = len(scene.boundaries)
        shapes = {"gravity": (3,), "friction": (W,), "velocity": (W, 3), "angular_velocity": (W, 3)}
        for (name, shape), t in zip(shapes.items(), self.tensors(), strict=True):
            if t is not None and tuple(t.shape) != shape:
                raise ValueError(f"controls.{name} must have shape {shape} for {W} walls, got {tuple(t.shape)}")
        changes: dict[str, Any] = {}
        if self.gravity is not None:
            changes["gravity"] = tuple(self.gravity.tolist())
        walls = []
        for k, b in enumerate(scene.boundaries):
            new: dict[str, Any] = {}
            if self.friction is not None and b.kind == "separate":
                new["friction"] = self.friction[k].item()
            if self.velocity is not None:
                new["velocity"] = tuple(self.velocity[k].tolist())
            if self.angular_velocity is not None:
                new["angular_velocity"] = tuple(self.angular_velocity[k].tolist())
            walls.append(dataclasses.replace(b, **new))
        return dataclasses.replace(scene, boundaries=tuple(walls), **changes)

    def bars(self, gravity: Tensor | None, walls: tuple[Tensor, ...] | None) -> tuple[Tensor | None, ...]:
        """Gradients in the tensors, from that of every node in gravity, and those of ``boundary.wall_gradients``."""
        found = (None if gravity is None else gravity.sum(0), *((None,) * 3 if walls is None else walls))
        return tuple(None if t is None or g is None else g.to(t) for t, g in zip(self.tensors(), found, strict=True))
