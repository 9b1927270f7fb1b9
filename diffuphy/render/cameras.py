"""Cameras that look at a point: OpenCV axes (x right, y down, z forward) in a world with z up."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from diffuphy.types import Camera


def look_at(
    eye: Tensor | Sequence[float], at: Tensor | Sequence[float] = (0.0, 0.0, 0.0), up: Sequence[float] = (0.0, 0.0, 1.0)
) -> Tensor:
    """World-to-camera matrices, shape (..., 4, 4), of cameras at ``eye`` (..., 3) that look at ``at`` (..., 3).

    Computed in the dtype of ``eye`` (the default dtype for a sequence).

    Raises:
        ValueError: the direction of view is zero or parallel to ``up``.
    """
    origin = torch.as_tensor(eye)
    target, upward = torch.as_tensor(at).to(origin), torch.as_tensor(up).to(origin)
    forward = target - origin
    right = torch.linalg.cross(forward, upward.expand_as(forward))
    if not (torch.linalg.vector_norm(right, dim=-1) > 1e-6 * torch.linalg.vector_norm(forward, dim=-1)).all():
        raise ValueError(
            "the direction of view must be neither zero nor parallel to up: "
            f"got eye {origin.tolist()}, at {target.tolist()}, up {upward.tolist()}"
        )
    forward = forward / torch.linalg.vector_norm(forward, dim=-1, keepdim=True)
    right = right / torch.linalg.vector_norm(right, dim=-1, keepdim=True)
    down = torch.linalg.cross(forward, right)
    R = torch.stack([right, down, forward], dim=-2)
    view = torch.zeros(*R.shape[:-2], 4, 4, dtype=origin.dtype, device=origin.device)
    view[..., :3, :3] = R
    view[..., :3, 3] = -(R @ origin[..., None])[..., 0]
    view[..., 3, 3] = 1
    return view


def intrinsics(fov: float, width: int, height: int) -> Tensor:
    """Pinhole matrix (3, 3) [px] with the angle ``fov`` [deg] across the shorter side and the axis through the
    centre."""
    if not 0 < fov < 180:
        raise ValueError(f"fov must be in (0, 180) degrees, got {fov}")
    f = 0.5 * min(width, height) / math.tan(math.radians(fov) / 2)
    return torch.tensor([[f, 0.0, width / 2], [0.0, f, height / 2], [0.0, 0.0, 1.0]])


def direction(azimuth: Tensor | float, elevation: Tensor | float) -> Tensor:
    """Unit vectors (..., 3) at ``azimuth`` from +x towards +y and ``elevation`` above the horizon [deg]."""
    a = torch.deg2rad(torch.as_tensor(azimuth, dtype=torch.get_default_dtype()))
    e = torch.deg2rad(torch.as_tensor(elevation, dtype=torch.get_default_dtype()))
    return torch.stack(
        [torch.cos(e) * torch.cos(a), torch.cos(e) * torch.sin(a), torch.sin(e).expand_as(torch.cos(e) * a)], dim=-1
    )


def orbit(
    azimuth: Tensor | Sequence[float],
    elevation: Tensor | Sequence[float] | float,
    distance: Tensor | Sequence[float] | float,
    *,
    fov: float = 40.0,
    width: int,
    height: int,
    at: Sequence[float] = (0.0, 0.0, 0.0),
) -> Camera:
    """C cameras around ``at``, one for each azimuth [deg]; elevation [deg] and distance are (C,) or shared."""
    d = direction(torch.as_tensor(azimuth, dtype=torch.get_default_dtype()).reshape(-1), torch.as_tensor(elevation))
    distances = torch.as_tensor(distance, dtype=d.dtype).expand(len(d))
    target = torch.tensor(at, dtype=d.dtype)
    viewmats = look_at(target + distances[:, None] * d, target)
    return Camera(viewmats, intrinsics(fov, width, height).expand(len(d), 3, 3).clone(), width, height)


def fit(
    points: Tensor,
    azimuth: float,
    elevation: float,
    *,
    fov: float,
    width: int,
    height: int,
    margin: float = 1.1,
    distance: float | None = None,
) -> Camera:
    """One camera in the given direction that sees all of ``points`` (M, 3) [m], as near as it can be.

    In camera axes a point (X, Y, Z) is inside when |X - c_x| ≤ t_x (Z + D) and likewise for Y: for each sign a lower
    bound of D that is linear in the point, so that the nearest camera follows from four maxima.

    Args:
        azimuth, elevation: where the camera stands, seen from the points [deg].
        fov: angle across the shorter side [deg].
        margin: size of the image over the size of what must be seen.
        distance: stand this far from the middle of the points instead [m].
    """
    out = direction(azimuth, elevation).to(points)
    R = look_at(out, torch.zeros_like(out))[:3, :3]
    p = points @ R.mT
    K = intrinsics(fov, width, height).to(points)
    slope = points.new_tensor([width, height]) / (2 * margin * torch.stack([K[0, 0], K[1, 1]]))
    upper = (p[:, :2] - slope * p[:, 2:]).amax(0)
    lower = (-p[:, :2] - slope * p[:, 2:]).amax(0)
    back = ((upper + lower) / (2 * slope)).amax()
    if distance is not None:
        back = back.new_tensor(distance) - (p[:, 2].amin() + p[:, 2].amax()) / 2
    eye = torch.cat([(upper - lower) / 2, -back[None]])  # in camera axes
    view = torch.eye(4, dtype=points.dtype, device=points.device)
    view[:3, :3] = R
    view[:3, 3] = -eye
    return Camera(view[None], K[None], width, height)
