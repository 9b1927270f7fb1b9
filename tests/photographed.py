"""Pictures of library objects with their cameras, written as NeRF's synthetic scenes are."""

import json
import math
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Camera, Look


def rendered(name: str, count: int, side: int) -> tuple[torch.Tensor, torch.Tensor, Camera]:
    """Premultiplied colours (C, H, W, 3), coverage (C, H, W), and the cameras."""
    cameras = Orbits(bank=count, size=side, seed=5, elevation=(-20, 75))()
    return *Library().object(Look(name, name)).render(cameras, 2), cameras


def write_pictures(folder: Path, name: str = "burger", count: int = 24, side: int = 32, background=None) -> Camera:
    """transforms.json and its pictures: transparent, or over a colour; returns their cameras."""
    rgb, a, cameras = rendered(name, count, side)
    folder.mkdir(parents=True, exist_ok=True)
    frames = []
    for i, view in enumerate(cameras.viewmats.double()):
        if background is None:
            pixels = torch.cat([rgb[i] / a[i, ..., None].clamp_min(1e-6), a[i, ..., None]], -1)
        else:
            pixels = rgb[i] + (1 - a[i, ..., None]) * torch.tensor(background)
        Image.fromarray((pixels.clamp(0, 1) * 255).round().to(torch.uint8).numpy()).save(folder / f"r_{i}.png")
        back = torch.linalg.inv(view) @ torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
        frames.append({"file_path": f"./r_{i}", "transform_matrix": back.tolist()})
    angle = 2 * math.atan(side / 2 / float(cameras.Ks[0, 0, 0]))
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    return cameras


def one_picture(path: Path, side: int = 8) -> None:
    """A square in the middle of a transparent picture."""
    pixels = np.zeros((side, side, 4), np.uint8)
    pixels[side // 4 : -side // 4, side // 4 : -side // 4] = 255
    Image.fromarray(pixels).save(path)
