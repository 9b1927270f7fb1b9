"""The film."""

import math
from pathlib import Path

import pytest
import torch

from diffuphy.render import Film, contact_sheet, sh, write_mp4, write_png
from diffuphy.render.kinematics import limit_stretch
from diffuphy.render.paths import path
from diffuphy.render.rigs import Resting
from diffuphy.types import Clip, Gaussians, Particles, Trajectory
from diffuphy.workspace import Workspace


def falling_ball(frames: int = 5) -> tuple[Gaussians, Particles, Trajectory]:
    """A red ball of radius 0.15 m that falls from 0.6 m to the floor."""
    g = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(400, 3, generator=g), dim=1)
    gaussians = Gaussians(
        d,
        torch.tensor([1.0, 0, 0, 0]).repeat(400, 1),
        torch.full((400, 3), math.log(0.08)),
        torch.full((400,), 4.0),
        sh.from_rgb(torch.tensor([0.9, 0.1, 0.1])).expand(400, 1, 3),
    )
    inner = torch.nn.functional.normalize(torch.randn(300, 3, generator=g), dim=1) * torch.rand(
        300, 1, generator=g
    ) ** (1 / 3)
    x = 0.15 * torch.cat([d, inner])
    volume = 4 / 3 * math.pi * 0.15**3 / len(x)
    particles = Particles(
        x,
        torch.full((len(x),), volume),
        torch.cat([torch.arange(400), torch.full((300,), -1)]),
        0.15,
        (0.0, 0.0, 0.0),
        volume ** (1 / 3),
    )
    heights = 0.15 + 0.6 * (1 - torch.linspace(0, 1, frames) ** 2)
    moved = x + torch.stack([torch.zeros(frames), torch.zeros(frames), heights], dim=1)[:, None]
    F = torch.eye(3).expand(frames, len(x), 3, 3)
    return gaussians, particles, Trajectory(moved, torch.zeros_like(moved), F, 24.0)


def red(frame: torch.Tensor) -> torch.Tensor:
    return frame[..., 0] > frame[..., 1] + 0.3


SMALL = {"width": 96, "height": 64}


def film(work: Workspace | None = None, **settings: object) -> Clip:
    return Film(**(SMALL | settings))(*falling_ball(), work=work or Workspace(progress=False))


def test_the_film_shows_the_whole_fall() -> None:
    """One frame a state; the ball is wholly in view in each, and lower in the image each time."""
    clip = film()
    assert clip.rgb.shape == (5, 64, 96, 3) and clip.fps == 24.0
    assert ((clip.rgb >= 0) & (clip.rgb <= 1)).all()
    rows = []
    for frame in clip.rgb:
        mask = red(frame)
        assert mask.sum() > 50
        assert not (mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
        rows.append(mask.any(1).nonzero().double().mean().item())
    assert rows == sorted(rows) and rows[-1] - rows[0] > 15


def test_the_shadow_gathers_as_the_ball_comes_down() -> None:
    """The darkest place of the floor gets darker as the ball falls; without a shadow it stays as it is."""
    darkest = []
    with_shadow, without = film(), film(shadow=0.0)
    for lit, plain in zip(with_shadow.rgb, without.rgb, strict=True):
        darkest.append(((plain - lit).amax(-1) * ~red(plain)).max().item())
    assert darkest == sorted(darkest) and darkest[-1] > darkest[0] + 0.05


def test_two_runs_are_bit_identical() -> None:
    assert torch.equal(film().rgb, film().rgb)


def test_supersampling_converges_to_the_same_picture() -> None:
    """More samples change edges only."""
    one, two = film(), film(supersample=2)
    assert two.rgb.shape == one.rgb.shape
    assert (one.rgb - two.rgb).abs().mean() < 0.01


def test_a_plain_background_is_that_colour() -> None:
    clip = film(background=(0.1, 0.2, 0.3), floor=False)
    torch.testing.assert_close(clip.rgb[0, 0, 0], torch.tensor([0.1, 0.2, 0.3]))


def test_a_flung_crumb_does_not_shrink_the_film() -> None:
    """The framed path ignores the outermost particles at each edge, but follows the body as a whole."""
    _, _, trajectory = falling_ball()
    x = trajectory.x.clone()
    x[-1, 0] = torch.tensor([100.0, 0.0, 0.0])
    crumb = Trajectory(x, trajectory.v, trajectory.F, trajectory.fps)
    assert path(crumb, floor=False).abs().max() < 1.0
    x[-1] += 5.0
    assert path(Trajectory(x, trajectory.v, trajectory.F, 24.0), floor=False).max() > 5.0


def test_stretch_is_limited_and_everything_else_kept() -> None:
    """Singular values min(σ, limit), same singular vectors; matrices below the limit are returned as they are."""
    F = torch.linalg.matrix_exp(torch.randn(50, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    cut = limit_stretch(F, 2.0)
    U, S, V = torch.linalg.svd(F)
    torch.testing.assert_close(cut, (U * S.clamp_max(2.0)[:, None]) @ V)
    tame = S[:, 0] <= 1.1
    assert torch.equal(limit_stretch(torch.eye(3).expand(4, 3, 3), 3.0), torch.eye(3).expand(4, 3, 3))
    assert torch.equal(cut[tame], F[tame]) or not tame.any()


def test_a_preview_is_left_in_the_workspace(tmp_path: Path) -> None:
    film(Workspace(tmp_path, progress=False))
    assert (tmp_path / "previews" / "film.png").stat().st_size > 1000


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="even"):
        Film(width=385)
    with pytest.raises(ValueError, match="elevation must be in"):
        Resting(elevation=90.0)
    with pytest.raises(ValueError, match="shadow must be in"):
        Film(shadow=2.0)
    with pytest.raises(ValueError, match="distance must be positive"):
        Resting(distance=-1.0)


def test_mp4_has_every_frame_and_plays_in_a_browser(tmp_path: Path) -> None:
    """H.264, yuv420p, index before data, and the pictures that were put in, to the loss of crf 18."""
    import imageio_ffmpeg
    import numpy as np

    g = torch.Generator().manual_seed(0)
    small = torch.rand(1, 3, 6, 8, generator=g)
    picture = torch.nn.functional.interpolate(small, size=(64, 96), mode="bicubic").clamp(0, 1)[0].permute(1, 2, 0)
    rgb = torch.stack([picture.roll(k, 1) for k in range(7)])
    file = tmp_path / "f.mp4"
    write_mp4(file, rgb, 24.0)
    data = file.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    reader = imageio_ffmpeg.read_frames(str(file))
    meta = next(reader)
    frames = [torch.from_numpy(np.frombuffer(f, np.uint8).copy()).reshape(64, 96, 3) / 255 for f in reader]
    assert meta["codec"] == "h264" and meta["pix_fmt"].startswith("yuv420p") and meta["fps"] == 24.0
    assert len(frames) == 7
    assert 10 * math.log10(1 / (torch.stack(frames) - rgb).square().mean().item()) > 30  # dB; 4:2:0 halves the chroma


def test_film_errors_say_what_to_change(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="even sides, got 2 frames of 7 x 4"):
        write_mp4(tmp_path / "f.mp4", torch.zeros(2, 4, 7, 3), 24.0)
    with pytest.raises(ValueError, match="fps must be positive"):
        write_mp4(tmp_path / "f.mp4", torch.zeros(2, 4, 8, 3), 0.0)


def test_contact_sheet_holds_first_and_last_frame(tmp_path: Path) -> None:
    rgb = torch.linspace(0, 1, 11)[:, None, None, None].expand(11, 20, 30, 3)
    sheet = contact_sheet(rgb, columns=3, frames=6)
    assert sheet.shape == (40, 90, 3)
    assert sheet[:20, :30].unique().tolist() == [0.0] and sheet[20:, 60:].unique().tolist() == [1.0]
    assert (contact_sheet(rgb, columns=3, frames=6, fps=24.0)[:20, :30] > 0).any()  # the time
    assert contact_sheet(rgb[:1]).shape == (20, 30, 3)
    write_png(tmp_path / "s.png", sheet)
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")
