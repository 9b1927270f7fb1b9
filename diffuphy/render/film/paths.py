"""Where a motion goes: what a camera must show, and the path on which it may follow."""

import torch
from torch import Tensor

from diffuphy.types import Trajectory

STRAYS = 0.005
"""Share of the particles at each edge of the object that framing ignores, so that a crumb flung far away does not
shrink the film."""


def boxes(trajectory: Trajectory) -> Tensor:
    """Corners of a box around the object in each frame, without its ``STRAYS``, shape (8, T, 3) [m]."""
    x = trajectory.x
    edges = torch.quantile(x.float(), x.new_tensor([STRAYS, 1 - STRAYS]).float(), dim=1).to(x)  # (2, T, 3)
    corners = torch.cartesian_prod(*[torch.arange(2, device=x.device)] * 3)  # (8, 3)
    return edges[corners, :, torch.arange(3, device=x.device)].movedim(1, -1)


def path(trajectory: Trajectory, *, floor: bool) -> Tensor:
    """Points (M, 3) [m] that the film must show: a box around the object at each frame and, if asked, the floor
    below it."""
    points = boxes(trajectory).reshape(-1, 3)
    if not floor:
        return points
    below = trajectory.x.mean(1)
    below[:, 2] = 0
    return torch.cat([points, below])


def smoothed(points: Tensor, sigma: float) -> Tensor:
    """A path (T, 3) smoothed over ``sigma`` frames by local straight lines: what moves steadily stays as it is.

        y_t = Σ_s w_ts (S₂ − S₁ (s − t)) x_s / (S₀ S₂ − S₁²),   w_ts = exp(−(s − t)²/2σ²),   S_k = Σ_s w_ts (s − t)ᵏ

    (Cleveland 1979.) A kernel narrower than half a frame sees one frame alone, and changes nothing.
    """
    T = len(points)
    if sigma < 0.5 or T < 3:
        return points
    d = torch.arange(T, dtype=torch.float64)[None] - torch.arange(T, dtype=torch.float64)[:, None]
    w = torch.exp(-0.5 * (d / sigma) ** 2)
    S0, S1, S2 = ((w * d**k).sum(1, keepdim=True) for k in range(3))
    kernel = w * (S2 - S1 * d) / (S0 * S2 - S1**2)
    return (kernel @ points.double().cpu()).to(points)
