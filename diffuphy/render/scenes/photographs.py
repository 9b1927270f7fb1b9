"""Pictures with their cameras, as other programs leave them.

- ``transforms.json``, or ``transforms_train.json`` with ``transforms_test.json`` beside it: NeRF's synthetic scenes
  (Mildenhall et al. 2020) and instant-ngp (Müller et al. 2022): camera to world, axes of OpenGL, x right, y up, z
  backwards; one field of view, or focal lengths.
- ``cameras.json`` of the original code of 3D Gaussian splatting, with the pictures in ``images``.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffuphy.render.scenes.capture import MAX_CAMERAS, entries_of, placed_camera
from diffuphy.types import Camera

MAX_PICTURES = 5000
"""Most pictures of a folder."""

MAX_PIXELS = 2**26
"""Most pixels of one picture: 8192 x 8192."""

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
"""What is tried for a picture whose name has no ending, and read."""

LENSES = ("k1", "k2", "k3", "k4", "p1", "p2")
"""Coefficients of lenses that are no pinholes."""

CLEAR = 10 / 255
"""Difference from the colour of the background, in any channel, from which a pixel is the object: above what JPEG adds
to an even colour."""


@dataclass(frozen=True)
class Shot:
    """One picture."""

    file: Path
    """Where it is."""
    camera: Camera
    """Its camera, of the size of the file."""
    held: bool | None = None
    """Whether the scene says that it is for tests; None: it does not say."""


def listing(path: Path | str) -> tuple[Path, ...]:
    """The JSON files that say what pictures there are.

    Raises:
        ValueError: none.
    """
    path = Path(path).expanduser()
    if path.is_file():
        return (path,)
    for names in (("transforms_train.json", "transforms_test.json"), ("transforms.json",), ("cameras.json",)):
        if (path / names[0]).is_file():
            return tuple(path / name for name in names if (path / name).is_file())
    raise ValueError(
        f"{path} has no transforms.json, transforms_train.json or cameras.json that says where its cameras are"
    )


def files(path: Path | str) -> tuple[Path, ...]:
    """The JSON files of a scene and all its pictures: what a result depends on."""
    return (*listing(path), *(shot.file for shot in shots(path)))


def shots(path: Path | str) -> tuple[Shot, ...]:
    """All pictures of a scene with their cameras; of the pictures only the headers are read.

    Args:
        path: a folder, or the JSON file itself.

    Raises:
        ValueError: no such scene, a picture that is missing or outside the folder, a camera that is none.
    """
    found: list[Shot] = []
    for listed in listing(path):
        data = _json(listed)
        held = {"transforms_train.json": False, "transforms_test.json": True}.get(listed.name)
        if isinstance(data, list):
            found += [_trained(listed, i, e) for i, e in enumerate(data)]
        elif isinstance(data, dict) and isinstance(data.get("frames"), list):
            found += [_transformed(listed, data, i, frame, held) for i, frame in enumerate(data["frames"])]
        else:
            raise ValueError(f"{listed} has neither a list of cameras nor one of frames")
    if not 0 < len(found) <= MAX_PICTURES:
        raise ValueError(f"{path} must have 1 to {MAX_PICTURES} pictures, got {len(found)}")
    return tuple(found)


def rgba(shot: Shot, width: int, height: int, background: tuple[float, float, float] | None) -> Tensor:
    """A picture at another size, premultiplied, shape (height, width, 4); each pixel is the mean of what it covers.

    Args:
        background: the colour [0, 1] that stands behind the object in pictures without transparency; what differs from
            it is the object.

    Raises:
        ValueError: an opaque picture, and no background.
    """
    import numpy as np
    from PIL import Image

    try:
        with Image.open(shot.file) as image:
            clear = "A" in image.getbands() or "transparency" in image.info
            pixels = torch.from_numpy(np.array(image.convert("RGBA"), np.float32) / 255)
    except (OSError, SyntaxError, Image.DecompressionBombError) as e:
        raise ValueError(f"{shot.file} is no picture that can be read: {type(e).__name__}") from None
    if not clear or bool((pixels[..., 3] == 1).all()):
        if background is None:
            raise ValueError(
                f"{shot.file.name} is opaque everywhere: pictures must show the object alone, with transparency, or on "
                "one colour: gaussians.background=[1,1,1] for white"
            )
        pixels[..., 3] = ((pixels[..., :3] - torch.tensor(background)).abs().amax(-1) > CLEAR).float()
    pixels[..., :3] *= pixels[..., 3:]
    small = torch.nn.functional.interpolate(pixels.permute(2, 0, 1)[None], size=(height, width), mode="area")
    return small[0].permute(1, 2, 0).contiguous()


def _json(path: Path) -> Any:
    if path.stat().st_size > MAX_CAMERAS:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; at most {MAX_CAMERAS} are read")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as e:
        raise ValueError(f"{path} is no JSON: {type(e).__name__}") from None


def _picture(listed: Path, name: Any, folders: tuple[str, ...]) -> Path:
    """The file of a picture, which must lie in the folder of the scene."""
    root = listed.parent.resolve()
    for folder in folders:
        stem = root / folder / str(name)
        for file in (stem, *(stem.with_name(stem.name + s) for s in SUFFIXES)):
            try:
                if file.suffix.lower() in SUFFIXES and file.is_file() and file.resolve().is_relative_to(root):
                    return file
            except (OSError, ValueError):  # a name that no file can have
                continue
    raise ValueError(
        f"{listed.name} names the picture {str(name)[:80]!r}, which is not in {root}, as {', '.join(SUFFIXES)}"
    )


def _size(file: Path) -> tuple[int, int]:
    from PIL import Image

    try:
        with Image.open(file) as image:
            width, height = image.size
    except (OSError, SyntaxError, Image.DecompressionBombError) as e:
        raise ValueError(f"{file} is no picture that can be read: {type(e).__name__}") from None
    if width * height > MAX_PIXELS:
        raise ValueError(f"{file} has {width} x {height} pixels, more than {MAX_PIXELS}; make it smaller")
    return width, height


def _trained(listed: Path, index: int, entry: Any) -> Shot:
    """One of ``cameras.json``, whose sizes may be others than those of the pictures."""
    (camera,) = entries_of(listed, [entry], first=index)
    file = _picture(listed, entry.get("img_name", ""), ("images", "."))
    width, height = _size(file)
    return Shot(file, resized(camera, width, height))


def _transformed(listed: Path, data: dict, index: int, frame: Any, held: bool | None) -> Shot:
    """One of ``transforms.json``."""
    try:
        own = {**data, **frame}
        file = _picture(listed, own["file_path"], (".",))
        width, height = _size(file)
        back = torch.tensor(own["transform_matrix"], dtype=torch.float64)
        if bent := [name for name in LENSES if float(own.get(name, 0.0)) != 0.0]:
            raise ValueError(f"{listed}: frame {index} has a lens ({', '.join(bent)}); undistort the pictures first")
        told = (int(own.get("w", width)), int(own.get("h", height)))
        if "fl_x" in own:
            fx = float(own["fl_x"])
            fy = float(own.get("fl_y", fx))
        else:
            fx = fy = 0.5 * told[0] / math.tan(0.5 * float(own["camera_angle_x"]))
        centre = float(own.get("cx", told[0] / 2)), float(own.get("cy", told[1] / 2))
    except (KeyError, TypeError, OverflowError, RuntimeError, ZeroDivisionError) as e:
        raise ValueError(f"{listed}: frame {index} is incomplete: {type(e).__name__} {e}") from None
    if back.shape not in ((4, 4), (3, 4)):
        raise ValueError(f"{listed}: frame {index} needs a transform_matrix of 4 x 4 numbers, got {tuple(back.shape)}")
    R = back[:3, :3] * torch.tensor([1.0, -1.0, -1.0])  # OpenGL looks along −z, y up
    camera = placed_camera(f"{listed}: frame {index}", R, back[:3, 3], (fx, fy), told, centre)
    return Shot(file, resized(camera, width, height), held)


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The same views in pictures of another size: rows of K follow the sides."""
    Ks = camera.Ks.clone()
    Ks[:, 0] *= width / camera.width
    Ks[:, 1] *= height / camera.height
    return Camera(camera.viewmats, Ks, width, height)
