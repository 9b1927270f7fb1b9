"""How many rounds the frames of a scene will take."""

import math
from typing import Any

IMPACT = 0.5
"""Speed that is left after an impact, over that before it [-]."""


def rounds(scene: Any, wave: float, spin_radius: float) -> float:
    """Rounds between particles and grid of all frames of a scene.

        Σ_frames ⌈ (c + V) T / (cfl Δx) ⌉ + 1,   V = |v| + |g| T + |v_wall|

    as ``mpm.engine.clock`` counts them: v falls freely up to the ground and keeps a share of its speed after that.

    Args:
        scene: ``mpm.Scene``.
        wave: fastest wave at rest c [m/s].
        spin_radius: distance of the farthest particle from the axis that it turns about [m].
    """
    T = 1.0 / scene.fps
    walls = max((math.hypot(*b.velocity) for b in scene.boundaries if hasattr(b, "velocity")), default=0.0)
    gravity, total = math.hypot(*scene.gravity), 0.0
    for speed in speeds(scene, spin_radius):
        total += math.ceil((wave + speed + gravity * T + walls) * T / (scene.cfl * scene.dx))
        total += scene.scheme.half_kick
    return total


def speeds(scene: Any, spin_radius: float) -> list[float]:
    """Guess of the fastest particle at the beginning of each frame [m/s]."""
    g, T = -scene.gravity[2], 1.0 / scene.fps
    sideways = math.hypot(scene.velocity[0], scene.velocity[1]) + math.hypot(*scene.spin) * spin_radius
    down, height = -scene.velocity[2], max(0.0, scene.lift or 0.0)
    landed, found = bool(scene.boundaries) and height == 0.0 and down >= 0.0, []
    for _ in range(scene.frames):
        found.append(math.hypot(sideways, down))
        if landed:
            continue
        height -= down * T + 0.5 * g * T * T
        down += g * T
        if height <= 0.0 and scene.boundaries:
            landed, down = True, IMPACT * down
    return found
