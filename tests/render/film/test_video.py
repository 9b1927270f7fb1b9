"""Pictures and films as files, read again by the programs that others have."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from diffuphy.render.film.video import playback, straight, write_gif, write_mp4, write_png, write_pngs, write_webm
from diffuphy.types import Clip


def frames(channels: int = 3, count: int = 8) -> torch.Tensor:
    """Smooth pictures that move, 64 x 96."""
    g = torch.Generator().manual_seed(0)
    small = torch.rand(1, channels, 4, 6, generator=g)
    picture = torch.nn.functional.interpolate(small, size=(64, 96), mode="bilinear")[0].permute(1, 2, 0)
    return torch.stack([picture.roll(3 * k, 1) for k in range(count)])


def told(file: Path) -> str:
    """What ffmpeg says about a file."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-i", str(file)]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr


def decoded(file: Path, layout: str = "rgb24", codec: str | None = None) -> torch.Tensor:
    import imageio_ffmpeg

    channels = {"rgb24": 3, "rgba": 4}[layout]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", *(["-c:v", codec] if codec else []), "-i", str(file)]
    raw = subprocess.run([*command, "-f", "rawvideo", "-pix_fmt", layout, "-"], capture_output=True, check=True).stdout
    return torch.from_numpy(np.frombuffer(raw, np.uint8).copy()).reshape(-1, 64, 96, channels) / 255


def error(a: torch.Tensor, b: torch.Tensor) -> float:
    """Root mean square."""
    return float((a - b).square().mean().sqrt())


def test_the_container_says_title_comment_and_speed(tmp_path: Path) -> None:
    """Slow motion: 24 frames a second of physical time played four times slower are 6 a second, whatever is in the
    words."""
    clip = Clip(frames(), 24.0, slow=4.0)
    title, comment = 'a "rubber" burger; falling = 果冻', "slow motion 4x"
    for name, write in (("f.mp4", write_mp4), ("f.webm", write_webm)):
        write(tmp_path / name, clip.rgb, playback(clip), title=title, comment=comment)
        text = told(tmp_path / name)
        assert re.search(rf"(?i)title\s*: {re.escape(title)}", text) and re.search(rf"(?i)comment\s*: {comment}", text)
        assert re.search(r"\b6 fps", text)


def test_webm_is_vp9_with_the_pictures_that_were_put_in(tmp_path: Path) -> None:
    write_webm(tmp_path / "f.webm", frames(), 24.0)
    assert "vp9" in told(tmp_path / "f.webm")
    assert error(decoded(tmp_path / "f.webm"), frames()) < 0.03  # 30 dB, as for mp4


def test_webm_keeps_coverage(tmp_path: Path) -> None:
    """The alpha plane is decoded by libvpx; half is half to a few levels of lossy 8 bit."""
    rgba = frames(4)
    rgba[..., 3] = torch.linspace(0, 1, 96)
    write_webm(tmp_path / "f.webm", rgba, 24.0)
    assert error(decoded(tmp_path / "f.webm", "rgba", "libvpx-vp9")[..., 3], rgba[..., 3]) < 0.03


def test_gif_loops_and_lasts_as_long(tmp_path: Path) -> None:
    """One palette for all; delays in hundredths of a second sum to the length, to one of them."""
    write_gif(tmp_path / "f.gif", frames(), 24.0)
    with Image.open(tmp_path / "f.gif") as picture:
        assert picture.format == "GIF" and picture.info["loop"] == 0 and picture.n_frames == 8
        total = 0
        for k in range(picture.n_frames):
            picture.seek(k)
            total += picture.info["duration"]
    assert total == pytest.approx(1000 * 8 / 24, abs=10)
    assert error(decoded(tmp_path / "f.gif"), frames()) < 0.05  # 256 colours, dithered


def test_png_is_exact_and_says_what_it_is(tmp_path: Path) -> None:
    rgba = frames(4, 2)
    assert write_pngs(tmp_path / "p", rgba, title="果冻", comment="frame") == 2
    with Image.open(tmp_path / "p" / "frame_0001.png") as picture:
        assert picture.mode == "RGBA" and picture.text == {"Title": "果冻", "Comment": "frame"}  # type: ignore[attr-defined]
        values = torch.from_numpy(np.array(picture)) / 255
    torch.testing.assert_close(values, rgba[1], rtol=0, atol=0.5 / 255 + 1e-6)
    write_png(tmp_path / "one.png", frames()[0])
    with Image.open(tmp_path / "one.png") as picture:
        assert picture.mode == "RGB"


def test_straight_colours_are_those_before_they_were_laid_on_white() -> None:
    """α c + 1 − α is undone where α > 0, and is 0 where nothing is."""
    g = torch.Generator().manual_seed(0)
    color, alpha = torch.rand(2, 8, 8, 3, generator=g), torch.rand(2, 8, 8, generator=g)
    alpha[:, :2] = 0
    white = alpha[..., None] * color + 1 - alpha[..., None]
    found = straight(Clip(white, 24.0, alpha=alpha))
    torch.testing.assert_close(found[:, 2:, :, :3], color[:, 2:], rtol=0, atol=2e-4)  # 1e-7 over the least alpha
    assert found[:, :2].abs().max() == 0


def test_video_errors_say_what_to_change(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="even sides"):
        write_webm(tmp_path / "f.webm", torch.zeros(1, 3, 4, 3), 24.0)
    with pytest.raises(RuntimeError, match="ffmpeg could not write"):
        write_mp4(tmp_path / "no" / "folder" / "f.mp4", frames(), 24.0)
