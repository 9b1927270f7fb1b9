"""Pictures and films as files: PNG, and what the bundled ffmpeg encodes."""

import subprocess
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from diffuphy.types import Clip


def playback(clip: Clip) -> float:
    """Frames shown in a second [1/s]: fps of physical time over the slow motion."""
    return clip.fps / clip.slow


def to_bytes(rgb: Tensor) -> np.ndarray:
    """Values in [0, 1] as 8-bit integers."""
    return (rgb.detach().clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def straight(clip: Clip) -> Tensor:
    """Colours and coverage (T, H, W, 4) of a film on a transparent background, colours not multiplied by coverage.

    rgb_white = α rgb + (1 − α)   ⇒   rgb = 1 + (rgb_white − 1) / α
    """
    assert clip.alpha is not None
    alpha = clip.alpha[..., None]
    rgb = 1 + (clip.rgb - 1) / alpha.clamp_min(torch.finfo(alpha.dtype).tiny)
    return torch.cat([torch.where(alpha > 0, rgb, torch.zeros_like(rgb)).clamp(0, 1), alpha], dim=-1)


def write_mp4(path: Path | str, rgb: Tensor, fps: float, *, title: str = "", comment: str = "") -> None:
    """Write frames (T, H, W, 3) in [0, 1] as an H.264 film that every browser plays (yuv420p, index at the front).

    Raises:
        ValueError: an odd side, no frame, or fps that is not positive.
    """
    encoding = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-preset", "medium", "-movflags", "+faststart"]
    _encode(path, rgb, fps, encoding, title, comment)


def write_webm(path: Path | str, frames: Tensor, fps: float, *, title: str = "", comment: str = "") -> None:
    """Write frames (T, H, W, 3) or, with coverage, (T, H, W, 4) in [0, 1] as a VP9 film. Raises as ``write_mp4``."""
    layout = "yuva420p" if frames.shape[3] == 4 else "yuv420p"
    encoding = ["-c:v", "libvpx-vp9", "-pix_fmt", layout, "-crf", "24", "-b:v", "0", "-cpu-used", "4", "-row-mt", "1"]
    _encode(path, frames, fps, encoding, title, comment)


def write_gif(path: Path | str, rgb: Tensor, fps: float, *, comment: str = "") -> None:
    """Write frames (T, H, W, 3) in [0, 1] as a GIF that loops, with one palette of 256 colours for the whole film.

    Delays are whole hundredths of a second, none below 0.02 s, which is what browsers keep to: at more than 50 frames
    a second some are left out. GIF has no title. Raises as ``write_mp4``.
    """
    rate = f"fps={min(float(fps), 50.0):.6g},"
    palette = "split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=sierra2_4a:diff_mode=rectangle"
    _encode(path, rgb, fps, ["-filter_complex", rate + palette, "-loop", "0"], "", comment)


def _encode(path: Path | str, frames: Tensor, fps: float, encoding: Sequence[str], title: str, comment: str) -> None:
    """Run ffmpeg on raw frames."""
    import imageio_ffmpeg

    count, height, width, channels = frames.shape
    if count < 1 or height % 2 or width % 2:
        raise ValueError(f"a film needs at least one frame and even sides, got {count} frames of {width} x {height} px")
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}")
    rate = Fraction(fps).limit_denominator(1001)
    tags = [x for key, text in (("title", title), ("comment", comment)) if text for x in ("-metadata", f"{key}={text}")]
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", "-f", "rawvideo", "-s", f"{width}x{height}",
        "-pix_fmt", "rgba" if channels == 4 else "rgb24", "-r", f"{rate.numerator}/{rate.denominator}", "-i", "-",
        *encoding, *tags, "-an", str(path),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdin is not None and running.stderr is not None
        try:
            for frame in frames:
                running.stdin.write(np.ascontiguousarray(to_bytes(frame)).data)
            running.stdin.close()
        except BrokenPipeError:
            pass  # it has stopped, and says why
        said = running.stderr.read().decode(errors="replace").strip()
    if running.returncode:
        raise RuntimeError(f"ffmpeg could not write {path}: {said}")


def write_png(path: Path | str, picture: Tensor, *, title: str = "", comment: str = "") -> None:
    """Write one picture (H, W, 3), or with coverage (H, W, 4), in [0, 1]."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    said = PngInfo()
    for key, text in (("Title", title), ("Comment", comment)):
        if text:
            said.add_itxt(key, text)
    Image.fromarray(to_bytes(picture)).save(path, pnginfo=said)


def write_pngs(folder: Path, frames: Iterable[Tensor], *, title: str = "", comment: str = "") -> int:
    """Write pictures as ``frame_0000.png`` and so on into ``folder``; returns how many."""
    folder.mkdir(parents=True, exist_ok=True)
    count = 0
    for count, frame in enumerate(frames, 1):
        write_png(folder / f"frame_{count - 1:04d}.png", frame, title=title, comment=comment)
    return count


def contact_sheet(rgb: Tensor, columns: int = 4, frames: int = 8, *, fps: float | None = None) -> Tensor:
    """Evenly spaced frames of (T, H, W, 3), first and last included, as one picture; with ``fps`` each bears its
    time [s]."""
    from PIL import Image, ImageDraw

    count = min(frames, len(rgb))
    columns = min(columns, count)
    chosen = [round(k * (len(rgb) - 1) / max(count - 1, 1)) for k in range(count)]
    height, width = rgb.shape[1:3]
    sheet = Image.new("RGB", (columns * width, -(-count // columns) * height), "white")
    for k, t in enumerate(chosen):
        picture = Image.fromarray(to_bytes(rgb[t]))
        if fps is not None:
            ImageDraw.Draw(picture).text((6, 4), f"{t / fps:.2f} s", fill=(60, 60, 60))
        sheet.paste(picture, (k % columns * width, k // columns * height))
    return torch.from_numpy(np.array(sheet)).to(torch.float32) / 255
