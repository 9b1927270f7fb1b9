"""The film."""

import dataclasses
import math
from pathlib import Path

import pytest
import torch

from diffuphy.render import Film, contact_sheet, sh, write_mp4, write_png
from diffuphy.render.film.brush import normals
from diffuphy.render.film.paths import path
from diffuphy.render.film.rigs import Resting, Turntable
from diffuphy.render.film.video import playback, straight
from diffuphy.render.film.views import OtherViews
from diffuphy.render.kinematics import limit_stretch
from diffuphy.types import Camera, Clip, Gaussians, Particles, Trajectory
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


def test_what_lies_beside_a_particle_is_carried_no_farther_than_it_is_drawn_long() -> None:
    """Matter that was stretched 10^6 times looks like matter stretched film.stretch = 3 times, Gaussians in its arms
    too: no splat is flung away by F times a centimetre."""
    gaussians, particles, trajectory = falling_ball()
    alone = dataclasses.replace(particles, gaussian=torch.full_like(particles.gaussian, -1))
    beside = dataclasses.replace(alone, x=alone.x + 0.02)
    films = []
    for length in (3.0, 1e6):
        F = torch.diag(torch.tensor([length, 0.5, 0.5])).expand_as(trajectory.F).contiguous()
        motion = dataclasses.replace(trajectory, F=F)
        settings = Film(width=64, height=64, fillers=False)
        films.append(settings(gaussians, beside, motion, work=Workspace()).rgb)
    torch.testing.assert_close(films[0], films[1], rtol=0, atol=1e-4)  # the rounding of a 1e6 in the decomposition
    assert float(films[0].std()) > 0.05  # something is seen


@pytest.mark.parametrize("name", ["stretch", "supersample", "neighbours"])
def test_what_must_be_at_least_one_is_a_number(name: str) -> None:
    for value in (0, math.nan):
        with pytest.raises(ValueError, match="must be at least 1"):
            Film(**{name: value})


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


def test_floor_and_shadow_follow_a_moving_camera() -> None:
    """A turntable that does not turn has the floor at rest; one that turns, and begins there, sees it move."""
    still = film(camera=Turntable(degrees=0.0, distance=2.0))
    one = film(camera=Turntable(degrees=90.0, distance=2.0))
    torch.testing.assert_close(still.rgb[0], one.rgb[0])
    corner = (slice(44, 64), slice(0, 24))  # floor, without the ball
    moved = (one.rgb[-1][corner] - still.rgb[-1][corner]).abs().max()
    assert moved > 0.05
    torch.testing.assert_close(still.rgb[0][corner], still.rgb[1][corner], rtol=0, atol=5e-3)  # the shadow comes nearer


@pytest.mark.parametrize("view", ["depth", "normals", "J", "velocity"])
def test_a_view_shows_something_else_in_the_same_place(view: str) -> None:
    """Same coverage, other colours; views of depth and normals stand on white."""
    plain, other = (
        film(floor=False, background=(1.0, 1.0, 1.0)),
        film(view=view, legend=False, floor=False, background=(1.0, 1.0, 1.0)),
    )
    for a, b in zip(plain.rgb, other.rgb, strict=True):
        assert torch.equal(a.amin(2) > 0.999, b.amin(2) > 0.999) or view == "J"  # white itself is a colour of no map
    assert (plain.rgb - other.rgb).abs().max() > 0.3
    if view in ("depth", "normals"):
        assert torch.equal(film(view=view).rgb[0, 0, 0], torch.ones(3))


def test_a_view_of_the_material_asks_for_it() -> None:
    with pytest.raises(ValueError, match="give their material"):
        film(view="E")
    assert Film(view="E").matter and not Film(view="J").matter


def test_depth_of_a_wall_is_its_distance_and_its_normal_faces_the_eye() -> None:
    """A flat wall across the axis 2 m away: depth 2 everywhere, n = (0, 0, −1)."""
    u = torch.arange(30.0).expand(20, 30)
    K = torch.tensor([[[25.0, 0, 15], [0, 25.0, 10], [0, 0, 1]]])
    camera = Camera(torch.eye(4)[None], K, 30, 20)
    n = normals(torch.full((20, 30), 2.0), torch.ones(20, 30), camera)
    torch.testing.assert_close(n, torch.tensor([0.0, 0.0, -1.0]).expand(20, 30, 3))
    # a wall that recedes to the right, z = 2 + x: x = z (u + ½ − 15)/25, n ∝ (1, 0, −1)
    z = 2 / (1 - (u + 0.5 - 15) / 25)
    slanted = normals(z, torch.ones(20, 30), camera)
    torch.testing.assert_close(slanted, torch.tensor([0.5**0.5, 0, -(0.5**0.5)]).expand(20, 30, 3), rtol=0, atol=1e-3)


def test_what_is_transparent_stands_on_any_background_as_if_filmed_there() -> None:
    """rgb and coverage put over grey are the picture that is filmed on grey, without a shadow to the last bit of
    float32; the shadow is black of its coverage."""
    grey = (0.4, 0.4, 0.4)
    clear, expected = film(background="transparent", shadow=0.0), film(background=grey, shadow=0.0)
    assert clear.alpha is not None
    rgba = straight(clear)
    over = rgba[..., 3:] * rgba[..., :3] + (1 - rgba[..., 3:]) * torch.tensor(grey)
    torch.testing.assert_close(over, expected.rgb, rtol=0, atol=1e-5)
    shaded = film(background="transparent")
    assert shaded.alpha is not None and (shaded.alpha >= clear.alpha - 1e-6).all()
    assert (shaded.alpha[-1] - clear.alpha[-1]).max() > 0.05 and clear.alpha[0, 0, 0] == 0


def test_slow_motion_keeps_the_pictures_and_says_so() -> None:
    fast, slow = film(), film(slow=4.0)
    assert torch.equal(fast.rgb, slow.rgb) and playback(slow) == playback(fast) / 4 == 6.0


def test_nothing_of_a_view_is_computed_when_none_is_asked_for(monkeypatch) -> None:
    """Painting, legends and expected depth are not called by a film in its own colours."""
    import diffuphy.render.film.brush as module

    def forbidden(*_: object) -> None:
        raise AssertionError("a film in its own colours paints nothing")

    for name in ("painter", "expected_depth", "reach"):
        monkeypatch.setattr(module, name, forbidden)
    film()


def test_further_views_are_films_of_their_own() -> None:
    """Those named, with the camera and the speed of the film, in 8 bit."""
    others = OtherViews.of(Film(**SMALL, also=("J", "velocity"), slow=2.0))
    made = others(*falling_ball(), None, work=Workspace(progress=False))
    assert list(made.rgb) == ["J", "velocity"] and made.slow == 2.0
    assert made.clip("J").rgb.shape == (5, 64, 96, 3)
    alone = film(view="velocity")
    assert (made.clip("velocity").rgb - alone.rgb).abs().max() < 1 / 255
