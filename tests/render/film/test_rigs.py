"""What holds the camera of a film."""

import math

import pytest
import torch

from diffuphy.render.cameras import intrinsics, look_at, orbit
from diffuphy.render.film.captured import Captured, resized, travelled
from diffuphy.render.film.paths import boxes, path, smoothed
from diffuphy.render.film.rigs import Follow, Increments, Resting, Turntable, checked, frame_of
from diffuphy.types import Camera, Particles, Trajectory

T, FPS, SIZE = 12, 24.0, {"width": 96, "height": 64, "floor": False}


def motion(frames: int = T) -> tuple[Trajectory, Particles]:
    """A cloud 0.4 m wide that moves 3 m to the right and falls."""
    g = torch.Generator().manual_seed(0)
    x = 0.4 * (torch.rand(200, 3, generator=g, dtype=torch.float64) - 0.5)
    t = torch.linspace(0, 1, frames, dtype=torch.float64)
    moved = x + torch.stack([3 * t, 0 * t, 2 - t * t], 1)[:, None]
    F = torch.eye(3, dtype=torch.float64).expand(frames, 200, 3, 3)
    particles = Particles(x, torch.full((200,), 1e-4), torch.arange(200), 0.2, (0.0, 0.0, 0.0), 0.05)
    return Trajectory(moved, torch.zeros_like(moved), F, FPS), particles


def seen(camera: Camera, points: torch.Tensor) -> torch.Tensor:
    """Pixels (C, M, 2) of points (C or 1, M, 3)."""
    p = points @ camera.viewmats[:, :3, :3].mT + camera.viewmats[:, None, :3, 3]
    assert (p[..., 2] > 0).all()
    xy = p @ camera.Ks.to(p).mT
    return xy[..., :2] / xy[..., 2:]


def eyes(camera: Camera) -> torch.Tensor:
    return -(camera.viewmats[:, :3, :3].mT @ camera.viewmats[:, :3, 3:])[..., 0]


@pytest.mark.parametrize("rig", [Resting(), Turntable(), Follow(), Follow(smoothing=0.0)])
def test_the_object_is_in_the_picture_in_every_frame(rig) -> None:
    """All corners of its boxes lie inside, some near the edge of the safe part: as near as can be."""
    trajectory, particles = motion()
    camera = checked(rig(trajectory, particles, **SIZE), T)
    xy = seen(camera, boxes(trajectory).movedim(1, 0))
    size = torch.tensor([96.0, 64.0], dtype=xy.dtype)
    assert (xy >= 0).all() and (xy <= size).all()
    off = ((xy - size / 2).abs() / (size / 2)).max()
    assert off == pytest.approx(1 / rig.margin, abs=0.02) or isinstance(rig, Resting)


def test_a_turntable_goes_round_once_and_closes() -> None:
    """Equal steps of 360°/T about the middle, at one height and distance; the step after the last is the first."""
    trajectory, particles = motion()
    camera = Turntable(azimuth=10.0)(trajectory, particles, **SIZE)
    points = path(trajectory, floor=False)
    arm = eyes(camera) - (points.amin(0) + points.amax(0)) / 2
    angle = torch.rad2deg(torch.atan2(arm[:, 1], arm[:, 0]))
    steps = torch.remainder(torch.cat([angle[1:], angle[:1]]) - angle, 360)
    # azimuths are made in float32
    torch.testing.assert_close(steps, torch.full_like(steps, 360 / T), rtol=0, atol=1e-3)
    assert float(angle[0]) == pytest.approx(10.0, abs=1e-3)
    assert arm[:, 2].std() < 1e-6 and arm.norm(dim=1).std() < 1e-5


def test_degrees_a_second_are_those_of_physical_time() -> None:
    trajectory, particles = motion()
    camera = Turntable(azimuth=0.0, degrees=48.0, per="second")(trajectory, particles, **SIZE)
    points = path(trajectory, floor=False)
    arm = eyes(camera) - (points.amin(0) + points.amax(0)) / 2
    assert math.degrees(math.atan2(arm[1, 1], arm[1, 0])) == pytest.approx(48 / FPS, abs=1e-4)


def test_follow_keeps_the_middle_of_the_object_in_the_middle_of_the_picture() -> None:
    """Without smoothing exactly; the direction of view never changes."""
    trajectory, particles = motion()
    camera = Follow(smoothing=0.0)(trajectory, particles, **SIZE)
    xy = seen(camera, trajectory.x.mean(1)[:, None])[:, 0]
    torch.testing.assert_close(xy, torch.tensor([48.0, 32.0], dtype=xy.dtype).expand(T, 2), rtol=0, atol=1e-6)
    R = camera.viewmats[:, :3, :3]
    torch.testing.assert_close(R, R[:1].expand_as(R), rtol=0, atol=1e-9)


def test_what_moves_steadily_is_followed_without_delay() -> None:
    """Local straight lines reproduce a + b t, ends included; a constant line is what a plain mean would bend there."""
    t = torch.arange(40, dtype=torch.float64)[:, None]
    line = torch.tensor([[1.0, -2.0, 3.0]]).double() + t * torch.tensor([[0.1, 0.2, -0.3]]).double()
    torch.testing.assert_close(smoothed(line, 6.0), line, rtol=0, atol=1e-10)


def test_what_is_faster_than_the_smoothing_is_not_followed() -> None:
    """Gaussian weights damp a wave of frequency f to exp(−2π² f² σ²): 1/8 per frame, σ = 6 frames → e⁻¹¹ in the middle,
    where the ends are four σ away."""
    t = torch.arange(80, dtype=torch.float64)
    wave = torch.sin(2 * math.pi * t / 8)[:, None].expand(80, 3)
    assert smoothed(wave, 6.0)[24:-24].abs().max() < 1e-3


def test_increments_go_step_by_step() -> None:
    """Azimuth, elevation and radius in frame t are start + t · step, about the given point."""
    trajectory, particles = motion()
    rig = Increments(30.0, 10.0, 2.0, step=(5.0, 1.0, 0.1), center=(0.0, 0.0, 1.0))
    arm = eyes(rig(trajectory, particles, **SIZE)) - torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    t = torch.arange(T, dtype=torch.float64)
    torch.testing.assert_close(arm.norm(dim=1), 2 + 0.1 * t, rtol=1e-6, atol=0)
    torch.testing.assert_close(torch.rad2deg(torch.asin(arm[:, 2] / arm.norm(dim=1))), 10 + t, rtol=0, atol=1e-4)
    torch.testing.assert_close(torch.rad2deg(torch.atan2(arm[:, 1], arm[:, 0])), 30 + 5 * t, rtol=0, atol=1e-4)
    assert len(Increments()(trajectory, particles, **SIZE)) == 1  # without a step it rests


class Scene:
    """Two cameras around the object, in its frame."""

    def cameras(self) -> tuple[Camera, ...]:
        both = orbit([0.0, 90.0], [10.0, 30.0], [4.0, 6.0], width=200, height=100, fov=40.0)
        return tuple(both[k : k + 1] for k in range(2))

    def floor(self) -> None:
        return None


def test_a_captured_camera_sees_what_it_saw(tmp_path) -> None:
    """A point of the object at rest, placed in metres on the floor, has its old place in the middle part of the
    picture, which is scaled by the smaller ratio of the sides."""
    (tmp_path / "cameras.json").write_text("[]")
    trajectory, particles = motion()
    camera = Captured(Scene(), str(tmp_path), views=(1,))(trajectory, particles, **SIZE)
    own = Scene().cameras()[1]
    X = torch.tensor([[0.3, -0.2, 0.5]], dtype=torch.float64)
    placed = particles.scale * X - torch.tensor([0.0, 0.0, float(particles.x[:, 2].min())])
    old = seen(Camera(own.viewmats.double(), own.Ks.double(), 200, 100), X[None])[0, 0]
    share = min(96 / 200, 64 / 100)
    expected = torch.tensor([48.0, 32.0]) + share * (old - torch.tensor([100.0, 50.0]))
    # its cameras are float32
    torch.testing.assert_close(seen(camera, placed[None])[0, 0], expected, rtol=0, atol=1e-4)


def test_several_captured_cameras_are_passed_through(tmp_path) -> None:
    """First and last are those named; every one between is a rotation, on the straight line of centres."""
    (tmp_path / "cameras.json").write_text("[]")
    trajectory, particles = motion()
    rig = Captured(Scene(), str(tmp_path), views=(0, 1, 0))
    camera = rig(trajectory, particles, **SIZE)
    ends = [Captured(Scene(), str(tmp_path), views=(k,))(trajectory, particles, **SIZE) for k in (0, 1)]
    torch.testing.assert_close(camera.viewmats[[0, -1]], ends[0].viewmats.expand(2, 4, 4), rtol=0, atol=1e-6)
    R = camera.viewmats[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).double().expand(T, 3, 3), rtol=0, atol=1e-6)
    line = eyes(ends[1]) - eyes(ends[0])
    off = torch.linalg.cross(eyes(camera) - eyes(ends[0]), line.expand(T, 3))
    assert off.abs().max() < 1e-6 * float(line.square().sum())
    with pytest.raises(ValueError, match="cameras 0 to 1"):
        Captured(Scene(), str(tmp_path), views=(2,))(trajectory, particles, **SIZE)


def test_travel_halfway_turns_half_the_angle() -> None:
    """R(½) between views 90° apart is 45° from each."""
    view = look_at(torch.tensor([[2.0, 0, 0], [0, 2.0, 0]]).double(), torch.zeros(3).double())
    K = intrinsics(40.0, 10, 10).double().expand(2, 3, 3)
    middle = travelled(view, K, 3)[0][1, :3, :3]
    for end in view[:, :3, :3]:
        angle = torch.arccos(((middle @ end.mT).trace() - 1) / 2)
        assert float(torch.rad2deg(angle)) == pytest.approx(45.0, abs=1e-6)


def test_a_resized_camera_shows_the_whole_of_its_picture() -> None:
    own = Scene().cameras()[0]
    wide = resized(own, 400, 100)
    assert float(wide.Ks[0, 0, 0]) == pytest.approx(float(own.Ks[0, 0, 0])) and float(wide.Ks[0, 0, 2]) == 200.0


@pytest.mark.parametrize("rig", [Resting(), Turntable(), Follow(), Increments(center=(1.0, 0.5, 1.0))])
def test_a_turned_rig_sees_the_other_side(rig) -> None:
    """180°: the camera looks the other way along the floor."""
    trajectory, particles = motion()
    one, other = (r(trajectory, particles, **SIZE).viewmats[0, 2, :3] for r in (rig, rig.turned(180.0)))
    torch.testing.assert_close(other * torch.tensor([-1.0, -1.0, 1.0]).double(), one, rtol=0, atol=1e-6)


def test_one_camera_serves_all_frames_or_each_has_its_own() -> None:
    camera = Scene().cameras()[0]
    assert frame_of(camera, 5) is camera
    with pytest.raises(ValueError, match="one a frame, got 3 for 12"):
        checked(Camera(camera.viewmats.repeat(3, 1, 1), camera.Ks, 10, 10), T)


def test_rig_errors_say_what_is_allowed() -> None:
    trajectory, particles = motion()
    with pytest.raises(ValueError, match="per"):
        Turntable(per="minute")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="smoothing must not be negative"):
        Follow(smoothing=-1.0)
    with pytest.raises(ValueError, match="in frame 2 the camera's radius is 0 m"):
        Increments(radius=1.0, step=(0.0, 0.0, -0.5))(trajectory, particles, **SIZE)
