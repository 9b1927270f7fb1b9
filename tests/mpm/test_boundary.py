"""Walls in closed form: friction, slipping, letting go, moving."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import Box, Grid, HalfSpace, Mesh, Scene, Schedule, Scheme, Sphere, container, rollout, simulate
from diffuphy.mpm.boundary import SLACK, rows, signature
from diffuphy.mpm.substep.kernels import make_kernels
from diffuphy.mpm.substep.nodes import make_nodes
from diffuphy.mpm.substep.variant import Variant
from diffuphy.types import Trajectory
from tests.mpm.bodies import block, field, rotation
from tests.mpm.text import source
from tests.mpm.walls import box_mesh

DX = 0.04
G = 9.81
T = 0.3


def slide(angle: float, mu: float, *, tilt_plane: bool, v0: float = 0.0, shape: str = "HalfSpace") -> float:
    """Distance along the plane that a cube of 5³ cells travels in T, where gravity or the plane, perhaps a side of a
    solid, is tilted."""
    x, vol = block((5, 5, 5), DX)
    along, up = (math.cos(angle), 0.0, -math.sin(angle)), (math.sin(angle), 0.0, math.cos(angle))
    wall = HalfSpace(friction=mu, normal=up if tilt_plane else (0.0, 0.0, 1.0))
    gravity = (0.0, 0.0, -G) if tilt_plane else (G * math.sin(angle), 0.0, -G * math.cos(angle))
    direction = x.new_tensor(along if tilt_plane else (1.0, 0.0, 0.0))
    if tilt_plane:
        x = x @ rotation((0.0, 1.0, 0.0), angle).T
    solid = dict(center=tuple(-0.15 * c for c in up), rotation=(0.0, angle, 0.0), friction=mu)
    if shape == "Box":
        wall = Box(size=(2.0, 1.0, 0.3), **solid)
    elif shape == "Mesh":
        vertices, faces = box_mesh((2.0, 1.0, 0.3))
        wall = Mesh(vertices=vertices, faces=faces, resolution=41, **solid)
    scene = Scene(
        gravity=gravity,
        dx=DX,
        fps=20.0,
        frames=round(20 * T),
        boundaries=(wall,),
        lift=None,
        velocity=tuple((v0 * direction).tolist()),
    )
    out = rollout(scene, x, vol, field(len(x), E=1e6))
    return float(((out.x[-1] - out.x[0]) @ direction).mean())


@pytest.mark.parametrize("tilt_plane", [False, True])
def test_a_block_slides_with_coulombs_deceleration(tilt_plane):
    """a = g (sin θ − μ cos θ), d = a T²/2 at θ = 35°, μ = 0.3."""
    angle = math.radians(35)
    a = G * (math.sin(angle) - 0.3 * math.cos(angle))
    # a Δt/2-late Euler sum adds a T Δt/2 = 0.2 %; a plane that cuts the cells leaves the block off its face by part
    # of a cell
    assert slide(angle, 0.3, tilt_plane=tilt_plane) == pytest.approx(a * T * T / 2, rel=0.03 if tilt_plane else 0.015)


@pytest.mark.parametrize("shape", ["Box", "Mesh"])
def test_a_side_of_a_solid_is_a_half_space_to_what_slides_on_it(shape):
    """Away from its edges φ of a box, and of its triangles, is that of the plane: the same slide to rounding, grown
    over 200 substeps in contact."""
    angle = math.radians(35)
    plane = slide(angle, 0.3, tilt_plane=True)
    assert slide(angle, 0.3, tilt_plane=True, shape=shape) == pytest.approx(plane, rel=1e-9)


def test_a_block_that_has_settled_sticks_below_the_friction_angle():
    """tan 20° = 0.36 < μ = 0.5: tilted at once, it creeps by less than a tenth of a cell and stands. (Set down at once
    it would ring between no weight and twice its weight, and slip each time.)"""
    angle, (x, vol) = math.radians(20), block((5, 5, 5), DX)
    scene = Scene(
        gravity=(0.0, 0.0, -G * math.cos(angle)), dx=DX, fps=20.0, frames=8, boundaries=(HalfSpace(friction=0.5),),
        lift=None,
    )  # fmt: skip
    f = field(len(x), E=1e6)
    *_, settled = simulate(scene, x, vol, f)
    tilted = dataclasses.replace(scene, gravity=(G * math.sin(angle), 0.0, scene.gravity[2]), frames=6)
    *_, end = simulate(tilted, x, vol, f, state=settled)
    assert float((end.x - settled.x)[:, 0].mean()) < 0.1 * DX
    assert abs(float(end.v[:, 0].mean())) < 5e-3


def test_friction_stops_a_block_on_the_level():
    """d = v0 T − μ g T²/2 for v0 = 2 m/s, μ = 0.4, which is still moving at T."""
    assert slide(0.0, 0.4, tilt_plane=False, v0=2.0) == pytest.approx(2.0 * T - 0.4 * G * T * T / 2, rel=0.015)


def test_a_slip_wall_keeps_tangential_velocity_exactly():
    """Bilateral: a block sliding along it in free flight keeps v_x and never leaves."""
    x, vol = block((3, 3, 3), DX)
    scene = Scene(
        gravity=(0.0, 0.0, 0.0),
        dx=DX,
        fps=20.0,
        frames=4,
        boundaries=(HalfSpace(kind="slip"),),
        lift=None,
        velocity=(0.7, 0.2, 0.0),
    )
    out = rollout(scene, x, vol, field(len(x)))
    torch.testing.assert_close(out.v[-1], x.new_tensor([0.7, 0.2, 0.0]).expand_as(x), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind, leaves", [("separate", True), ("slip", False), ("sticky", False)])
def test_only_a_separating_wall_lets_go(kind, leaves):
    """A block that starts upwards from the wall flies off with its speed, or is held back."""
    x, vol = block((3, 3, 3), DX)
    scene = Scene(
        gravity=(0.0, 0.0, 0.0),
        dx=DX,
        fps=20.0,
        frames=4,
        boundaries=(HalfSpace(kind=kind),),
        lift=None,
        velocity=(0.0, 0.0, 0.5),
    )
    out = rollout(scene, x, vol, field(len(x), E=1e5))
    rise = float((out.x[-1] - x)[:, 2].mean())
    if leaves:
        torch.testing.assert_close(out.v[-1], out.v[0], rtol=0, atol=1e-12)
        assert rise == pytest.approx(0.5 * 4 / 20, rel=1e-12)
    else:
        assert rise < 0.05 * 0.5 * 4 / 20 + DX


def test_a_sticky_wall_carries_a_block_at_its_own_speed():
    """A wall of V = (0.5, 0, 0) m/s and the block on it move as one, whatever their common speed."""
    x, vol = block((3, 3, 3), DX)
    wall = HalfSpace(kind="sticky", velocity=(0.5, 0.0, 0.0))
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=DX, fps=20.0, frames=3, boundaries=(wall,), lift=None, velocity=(0.5, 0.0, 0.0)
    )
    out = rollout(scene, x, vol, field(len(x)))
    torch.testing.assert_close(out.v[-1], out.v[0], rtol=0, atol=1e-12)


def test_a_moving_floor_drags_by_friction():
    """a = μ g until the block has the speed of the floor: v = μ g T with μ = 0.2, V = 2 m/s."""
    x, vol = block((5, 5, 5), DX)
    scene = Scene(
        gravity=(0.0, 0.0, -G),
        dx=DX,
        fps=20.0,
        frames=4,
        lift=None,
        boundaries=(HalfSpace(friction=0.2, velocity=(2.0, 0.0, 0.0)),),
    )
    out = rollout(scene, x, vol, field(len(x), E=1e6))
    # sudden weight makes the block ring on the wall; the impulse over whole periods is that of its weight
    assert float(out.v[-1][:, 0].mean()) == pytest.approx(0.2 * G * 0.2, rel=0.03)


def test_a_press_squeezes_and_is_gone_at_its_end():
    """The nodes behind the plate have its speed, so no particle gets further behind it than half a cell; later the
    body is free."""
    x, vol = block((4, 4, 4), DX)
    height, speed, end = 4 * DX, 0.4, 0.15
    press = HalfSpace(point=(0.0, 0.0, height), normal=(0.0, 0.0, -1.0), velocity=(0.0, 0.0, -speed), end=end)
    scene = Scene(dx=DX, fps=20.0, frames=5, boundaries=(HalfSpace(friction=0.5), press), lift=None)
    out = rollout(scene, x, vol, field(len(x), E=2e4))
    top = out.x[:, :, 2].amax(1)
    for frame in (1, 2, 3):
        assert top[frame] <= height - speed * frame / 20 + 0.5 * DX
    assert top[5] > top[3] + 0.5 * DX


def test_a_ball_pushes_particles_out_of_its_way():
    """No particle is deeper in a moving ball than a cell (the nodes within it hold the ball's speed)."""
    x, vol = block((6, 6, 6), DX)
    c, r, V = (-0.08, 0.12, 0.12), 0.08, 0.6
    ball = Sphere(center=c, radius=r, velocity=(V, 0.0, 0.0), friction=0.3)
    scene = Scene(dx=DX, fps=20.0, frames=4, boundaries=(HalfSpace(kind="sticky"), ball), lift=None)
    out = rollout(scene, x, vol, field(len(x), E=2e4))
    at = x.new_tensor(c) + x.new_tensor([V * 4 / 20, 0.0, 0.0])
    before, after = ((p - at).norm(dim=1).min() for p in (out.x[0], out.x[-1]))
    assert before < r - DX < after


def drag_along(**settings) -> tuple[Trajectory, torch.Tensor, list]:
    """Frames of 0.05 s of a block, the lower half of which is in a sticky box of 0.5 m/s."""
    x, vol = block((4, 4, 6), DX)
    box = Box(center=(0.08, 0.08, 0.04), size=(0.4, 0.4, 0.16), kind="sticky", velocity=(0.5, 0.0, 0.0), **settings)
    scene = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=20.0, frames=8, boundaries=(box,), lift=None)
    reports = []
    f = field(len(x), E=1e5)
    out = rollout(scene, x, vol, f, report=reports, gather=("impulse",))
    m = f.rho * vol
    return out, (m[:, None] * out.v).sum(1), reports


def test_a_sticky_box_drags_a_block_along():
    """It goes as far as the box, here in the last 0.2 s = 10 L/c; the momentum of the body is the impulse that the wall
    records."""
    out, p, reports = drag_along()
    way = float((out.x[8] - out.x[4])[:, 0].mean())
    swing = 0.12 / (math.pi / 2 * 6.2 / 0.12)  # [m] the free half, 0.12 m, goes on shearing at 0.12 m/s, ω = πc/2L
    assert way == pytest.approx(0.5 * 0.2, abs=2 * swing)
    torch.testing.assert_close(p[1:] - p[:-1], torch.stack([r.impulse for r in reports]), rtol=0, atol=1e-10)


def test_a_box_with_reset_stops_what_it_has_moved():
    """Nodes inside are at rest from end to end + reset: what lies wholly inside stands still, then is free."""
    x, vol = block((4, 4, 4), DX)
    box = Box(center=(0.08,) * 3, size=(0.6,) * 3, kind="sticky", velocity=(0.5, 0.0, 0.0), end=0.1, reset=0.1)
    scene = Scene(gravity=(0.0, 0.0, -G), dx=DX, fps=20.0, frames=5, boundaries=(box,), lift=None)
    out = rollout(scene, x, vol, field(len(x)))
    carried = x.new_tensor([0.5, 0.0, 0.0]).expand_as(x)
    for frame in (1, 2):
        torch.testing.assert_close(out.v[frame], carried, rtol=0, atol=1e-12)
    assert float(out.v[3:5].abs().max()) < 1e-12
    torch.testing.assert_close(out.x[4], x + 0.1 * carried, rtol=0, atol=0.5 * 0.05 / 20)  # to a substep
    assert float(out.v[5, :, 2].mean()) == pytest.approx(-G * 0.05, rel=1e-9)


def test_a_turning_sticky_floor_turns_a_block_with_it():
    """V = ω × (x − c): a block that turns as the floor does goes on turning, about the point of the floor."""
    x, vol = block((4, 4, 4), DX)
    spin = (0.0, 0.0, 2.0)
    middle = x.mean(0)
    floor = HalfSpace(kind="sticky", point=(float(middle[0]), float(middle[1]), 0.0), angular_velocity=spin)
    scene = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=20.0, frames=5, boundaries=(floor,), lift=None, spin=spin)
    out = rollout(scene, x, vol, field(len(x), E=1e6))
    e = out.x[-1] - middle
    rate = float((e[:, 0] * out.v[-1, :, 1] - e[:, 1] * out.v[-1, :, 0]).sum() / e[:, :2].square().sum())
    # centrifugal strain ρ ω² r²/E = 1e-5, and Euler steps of a rotation, ω² Δt² a substep, 1e-3 in all
    assert rate == pytest.approx(2.0, rel=5e-3)
    turned = (x - middle) @ rotation((0.0, 0.0, 1.0), 2.0 * 0.25).T
    assert float((e - turned).norm(dim=1).max()) < 0.02 * DX


def test_a_scheduled_press_is_a_moving_press():
    """A schedule of one straight piece is a constant velocity, to rounding."""
    x, vol = block((3, 3, 3), DX)
    down = dict(point=(0.0, 0.0, 3 * DX), normal=(0.0, 0.0, -1.0))
    presses = (
        HalfSpace(velocity=(0.1, 0.0, -0.4), **down),
        HalfSpace(schedule=Schedule(times=(0.0, 1.0), offsets=((0.0, 0.0, 0.0), (0.1, 0.0, -0.4))), **down),
    )
    a, b = (
        rollout(Scene(dx=DX, fps=20.0, frames=2, boundaries=(HalfSpace(), p), lift=None), x, vol, field(len(x), E=2e4))
        for p in presses
    )
    assert float((a.x[-1] - x).abs().max()) > 0.3 * DX
    torch.testing.assert_close(a.x, b.x, rtol=0, atol=1e-10)


def test_a_container_keeps_what_is_thrown_about_in_it():
    """No particle leaves a box of 8 cells by more than half a cell."""
    x, vol = block((4, 4, 4), DX, corner=(0.1, 0.1, 0.1))
    walls = container((0.0, 0.0, 0.0), (0.32, 0.32, 0.32), friction=0.1)
    scene = Scene(dx=DX, fps=20.0, frames=12, boundaries=walls, lift=None, velocity=(2.0, -1.5, 2.0))
    out = rollout(scene, x, vol, field(len(x), E=3e4))
    assert float(out.x.min()) > -0.5 * DX and float(out.x.max()) < 0.32 + 0.5 * DX
    assert float((out.x[-1].mean(0) - out.x[0].mean(0)).norm()) > DX


def test_walls_as_data_follow_time_and_block():
    """Row of step s: the plane n·r = d and the ball's centre, measured from the lowest node; the last number says
    whether it acts."""
    grid = Grid(0.5, (-2, 0, 2), (4, 4, 4))
    plane = HalfSpace(
        point=(0.0, 0.0, 3.0), normal=(0.0, 0.0, -2.0), velocity=(0.0, 0.0, -1.0), start=1.0, end=2.0, reach=0.5
    )
    ball = Sphere(center=(1.0, 1.0, 1.0), radius=0.4, velocity=(0.0, 2.0, 0.0))
    data = rows((plane, ball), grid, np.array([0.5, 1.5, 2.0]))
    assert data[:, 0, 8].tolist() == [0.0, 1.0, 0.0] and data[:, 1, 8].tolist() == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(data[1, 0, :8], [0, 0, -1, -(2.5 - 1.0) - (0.5 - SLACK) * 0.5, 0, 0, -1, 0])
    np.testing.assert_allclose(data[1, 1, :8], [2.0, 4.0, 0.0, 0.4 + SLACK * 0.5, 0, 2, 0, 0])


def test_a_scene_without_walls_has_no_wall_code_and_lists_of_walls_have_their_own_kernels():
    """The text of the kernel, not a flag, says what it does; equal text would be an equal (wrong) kernel."""
    mixture = make_mixture(("neo_hookean",), ("identity",), wp.float64)
    floor, ball = HalfSpace(), Sphere()
    single = [HalfSpace(friction=0.1), HalfSpace(kind="slip"), HalfSpace(kind="sticky"), floor, ball]
    pairs = [(floor, ball), (ball, floor), (floor, floor), (floor, HalfSpace(kind="slip"))]
    lists = [(), *((wall,) for wall in single), *pairs]
    variants = [Variant(mixture, wp.float64, Scheme.mls(), signature(walls)) for walls in lists]
    moves = [make_nodes(v).move for v in variants]
    hashes = [k.module.get_module_hash() for k in moves]
    assert len(set(hashes)) == len(hashes)
    assert len({make_kernels(v).p2g.module.get_module_hash() for v in variants}) == 1
    texts = [source(k) for k in moves[:2]]
    assert "act" in texts[1] and "wp::dot" in texts[1] and "wp::dot" not in texts[0]


@pytest.mark.parametrize(
    "wrong",
    [
        dict(kind="bouncy"),
        dict(friction=-0.1),
        dict(kind="slip", friction=0.1),
        dict(start=2.0, end=1.0),
        dict(reach=-1.0),
        dict(normal=(0.0, 0.0, 0.0)),
        dict(point=(0.0, math.nan, 0.0)),
        dict(velocity=(1.0, 2.0)),
    ],
)
def test_walls_that_cannot_be_are_refused(wrong):
    with pytest.raises(ValueError):
        HalfSpace(**wrong)


def test_balls_that_cannot_be_are_refused():
    for wrong in (dict(radius=0.0), dict(center=(0.0, 0.0, math.inf))):
        with pytest.raises(ValueError):
            Sphere(**wrong)


def test_unused_fields_stay_out():
    """A wall that has vanished before the film begins changes nothing."""
    x, vol = block((2, 2, 2), DX)
    scene = Scene(dx=DX, fps=20.0, frames=2, boundaries=(HalfSpace(friction=0.5),), lift=None)
    gone = dataclasses.replace(
        scene, boundaries=(*scene.boundaries, Sphere(center=(0.04, 0.04, 0.04), radius=0.1, start=5.0))
    )
    f = field(len(x))
    a, b = (list(simulate(s, x, vol, f)) for s in (scene, gone))
    assert torch.equal(a[-1].x, b[-1].x)


def test_a_plane_of_nodes_on_the_floor_belongs_to_it_in_float32():
    """φ of the plane z = 0 as the kernel computes it, Δx k − offset in float32: never positive, whatever Δx and the
    block. Its rounding once decided whether a body came to rest a whole Δx higher."""
    for dx in np.linspace(0.01, 0.09, 400):
        for k in (1, 2, 3, 5, 7, 11, 29):
            grid = Grid(float(dx), (0, 0, -k), (4, 4, 2 * k))
            offset = np.float32(rows((HalfSpace(),), grid, np.zeros(1))[0, 0, 3])
            assert np.float32(dx) * np.float32(k) - offset <= 0.0
            assert np.float32(dx) * np.float32(k + 1) - offset > 0.9 * dx
