"""Trained scenes in the layout of the original code (Kerbl et al. 2023), written by the tests."""

import json
from pathlib import Path

import torch

from diffuphy.render.scenes import ply
from diffuphy.types import Camera, Gaussians


def write_scene(folder: Path, gaussians: Gaussians, camera: Camera | None = None, iteration: int = 30000) -> Path:
    """``gaussians``, z up, as a scene with y down; and its cameras, which see that scene."""
    inside = folder / f"point_cloud/iteration_{iteration}"
    inside.mkdir(parents=True)
    ply.write(inside / "point_cloud.ply", gaussians)
    if camera is not None:
        write_cameras(folder / "cameras.json", camera)
    return folder


def write_cameras(path: Path, camera: Camera) -> None:
    """As ``utils/camera_utils.py: camera_to_JSON`` of the original code does."""
    entries = []
    for i, view in enumerate(camera.viewmats.double()):
        back = torch.linalg.inv(view)
        entries.append(
            {"id": i, "img_name": f"{i:04d}", "width": camera.width, "height": camera.height,
             "position": back[:3, 3].tolist(), "rotation": back[:3, :3].tolist(),
             "fy": float(camera.Ks[i, 1, 1]), "fx": float(camera.Ks[i, 0, 0])}
        )  # fmt: skip
    path.write_text(json.dumps(entries))
