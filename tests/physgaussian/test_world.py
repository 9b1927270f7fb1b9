"""Every kind of boundary condition is here what it was meant to be there."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from diffuphy.mpm import Box, HalfSpace, Held, InBox, Release
from diffuphy.physgaussian import played
from diffuphy.physgaussian.matter import matter
from diffuphy.physgaussian.scene_file import parse
from diffuphy.physgaussian.world import ground, world
from diffuphy.types import Motion, Particles
from diffuphy.workspace import Workspace

SPAN = {"start_time": 0, "end_time": 1e3}


def meaning(kind, data=None, **values):
    """What one condition is made of, in the frame of the particles, and its remark."""
    file = parse({**(data or {}), "boundary_conditions": [{"type": kind, **values}]})
    (m,) = world(file).meanings
    return m.made, m.remark, world(file).frame.height


def block(n=6, side=1.0):
    """A block of n³ particles about the origin."""
    g = (torch.arange(n, dtype=torch.float64) + 0.5) * side / n - side / 2
    x = torch.cartesian_prod(g, g, g)
    vol = torch.full((len(x),), (side / n) ** 3, dtype=torch.float64)
    return Particles(x, vol, torch.zeros(len(x), dtype=torch.long), 1.0, (0.0, 0.0, 0.0), side / n)


def film(data, frames, particles=None):
    """The trajectory of a block in the scene of ``data``, in float64 as far as it is stored, and its states' masses."""
    file, body = parse(data), particles or block()
    play = dataclasses.replace(played(file), double=True, seconds=frames * file["frame_dt"])
    motion = Motion("falling", "", {}, file["scale"])
    field = matter(file)(None, motion, None, body, work=None)
    return play(motion, body, field, work=Workspace()), field, body, play


# --------------------------------------------------------------------------- walls
def test_bounding_box_stands_three_cells_inside_the_grid_and_does_not_rub():
    walls, _, height = meaning("bounding_box", {"grid_lim": 2.0, "n_grid": 50, "g": [0, 0, 0]})
    assert [(w.kind, w.friction) for w in walls] == [("separate", 0.0)] * 6
    faces = {w.normal: float(np.dot(w.point, w.normal) - height * w.normal[2]) for w in walls}
    assert faces == {n: pytest.approx(-0.88, abs=1e-12) for n in faces} and len(faces) == 6  # 3 · 0.04 − 1


def test_cuboid_holds_and_moves_and_stops():
    """Half sizes become edges; reset stops for 15 substeps."""
    values = {"point": [1.1, 1, 0.5], "size": [0.5, 0.4, 0.28], "velocity": [0, 0.2, 0]}
    (box,), _, height = meaning("cuboid", {"substep_dt": 2e-4}, **values, start_time=0.1, end_time=0.5, reset=1)
    assert isinstance(box, Box) and box.kind == "sticky" and box.size == (1.0, 0.8, 0.56)
    assert box.center == pytest.approx((0.1, 0.0, -0.5 + height)) and box.velocity == (0.0, 0.2, 0.0)
    assert (box.start, box.end, box.reset) == (0.1, 0.5, pytest.approx(15 * 2e-4))
    (forever,), remark, _ = meaning("cuboid", **values, reset=1)
    assert forever.end == math.inf and forever.reset == 0.0 and "never ends" in remark


@pytest.mark.parametrize(
    ("surface", "kind", "mu"),
    [
        ("sticky", "sticky", 0.0),
        ("slip", "slip", 0.0),
        ("separate", "separate", 0.4),
        ("collide", "separate", 0.4),
    ],
)
def test_surfaces_are_four_different_things(surface, kind, mu):
    values = {"point": [1, 1, 0.5], "normal": [0, 0, 2], "surface": surface, "friction": 0.4, **SPAN}
    (wall,), remark, height = meaning("surface_collider", **values)
    assert isinstance(wall, HalfSpace) and (wall.kind, wall.friction) == (kind, mu)
    assert wall.normal == (0.0, 0.0, 1.0) and wall.point[2] == pytest.approx(0.0, abs=1e-12) and height == 0.5
    assert ("not used" in remark) == (mu == 0.0)


def test_what_lies_on_a_surface_that_slips_slides():
    """v = g_x t along the wall, exactly; there it would be held."""
    wall = {"type": "surface_collider", "point": [1, 1, 0.5], "normal": [0, 0, 1], "surface": "slip", "friction": 0}
    data = {"g": [4.0, 0, -9.8], "E": 1e6, "nu": 0.2, "density": 1000, "boundary_conditions": [wall | SPAN]}
    trajectory, _, _, _ = film(data, 10)
    v = trajectory.v[..., 0].double().mean(1)
    times = 0.01 * torch.arange(11, dtype=torch.float64)
    torch.testing.assert_close(v, 4.0 * times, rtol=1e-6, atol=1e-9)  # stored in float32
    # set down at once, its middle swings between 0 and twice the sag, which is less than ρ g H²/(2E); ½ g t² is 49 mm
    fallen = float((trajectory.x[0] - trajectory.x[-1])[:, 2].mean())
    assert 0.0 <= fallen < 1000 * 9.8 / 1e6


def test_sdf_collider_is_two_walls():
    walls, _, _ = meaning("sdf_collider", bound=0.3, dim=1, start_time=0, end_time=2)
    assert [(w.normal, w.point[1]) for w in walls] == [
        ((0.0, 1.0, 0.0), pytest.approx(-0.7)),
        ((0.0, -1.0, 0.0), pytest.approx(0.7)),
    ]
    assert all(w.kind == "separate" and w.end == 2.0 for w in walls)


def test_scene_translation_is_said_to_be_unused():
    made, remark, _ = meaning("enforce_scene_translation", velocity=[0, 0, 0], **SPAN)
    assert made == () and remark.startswith("not used")


def test_walls_act_in_the_order_of_the_file():
    surface = {"point": [1, 1, 0.4], "normal": [0, 0, 1], "surface": "slip", "friction": 0, **SPAN}
    cuboid = {"point": [1, 1, 0.4], "size": [1, 1, 0.1], "velocity": [0, 0, 0]}
    conditions = [{"type": "cuboid", **cuboid}, {"type": "surface_collider", **surface}]
    for order in (conditions, conditions[::-1]):
        kinds = [{"cuboid": "Box", "surface_collider": "HalfSpace"}[c["type"]] for c in order]
        walls = world(parse({"boundary_conditions": order})).boundaries
        assert [type(w).__name__ for w in walls] == kinds


def test_everything_turns_with_the_vertical():
    """With y up their floor y = 0.4 is our floor z = 0, and their gravity along −y ours along −z."""
    data = {"mpm_space_vertical_upward_axis": [0, 1, 0], "g": [0, -9.8, 0]}
    values = {"point": [1, 0.4, 1], "normal": [0, 1, 0], "surface": "sticky", "friction": 0, **SPAN}
    (wall,), _, height = meaning("surface_collider", data, **values)
    assert wall.normal == (0.0, 0.0, 1.0) and wall.point[2] == pytest.approx(0.0) and height == pytest.approx(0.6)
    assert played(parse(data)).gravity == (0.0, 0.0, -9.8)


def test_floor_of_the_film_is_the_highest_plane_below_the_object():
    """Else the bottom of a bounding box that something falls on, else as far down as the object reaches."""

    def height(**data):
        file = parse(data)
        return -ground(file, world(file).frame.__class__(file["mpm_space_vertical_upward_axis"]))

    plane = {"type": "surface_collider", "normal": [0, 0, 1], "surface": "slip", "friction": 0, **SPAN}
    low, lower, over = ({**plane, "point": [1, 1, z]} for z in (0.48, 0.2, 1.2))
    assert height(boundary_conditions=[lower, low, over]) == pytest.approx(0.52)
    assert height(boundary_conditions=[{"type": "bounding_box"}]) == pytest.approx(0.88)
    assert height(boundary_conditions=[{"type": "bounding_box"}], g=[0, 0, 0], scale=0.6) == pytest.approx(0.3)


# --------------------------------------------------------------------------- drives
def test_impulse_is_that_of_every_particle_together():
    """Σ m v = N F num_dt Δt, whatever their masses; the momentum then stays."""
    impulse = {"type": "particle_impulse", "force": [-0.18, 0.0, 0.09], "num_dt": 2, "size": [2, 2, 2]}
    data = {"g": [0, 0, 0], "E": 1e4, "boundary_conditions": [impulse]}
    trajectory, field, body, _ = film(data, 2)
    J = torch.tensor([-0.18, 0.0, 0.09]) * 2 * 1e-4 * len(body)
    for v in trajectory.v[1:]:
        p = ((field.rho.double() * body.vol)[:, None] * v.double()).sum(0)
        # stored in float32: 216 numbers with a rounding of 6e-8 each
        torch.testing.assert_close(p, J.double(), rtol=1e-6, atol=1e-6 * float(J.norm()))


def test_impulse_for_another_number_of_particles_is_scaled():
    """J = F num_dt Δt · n · of/N: that of the scene for which the file was written."""
    impulse = {"type": "particle_impulse", "force": [1.0, 0, 0], "size": [0.5, 2, 2], "point": [1.5, 1, 1]}
    file, body = parse({"boundary_conditions": [impulse]}), block()
    half = len(body) // 2
    for particles, total in ((None, half), (10 * len(body), 10 * half)):
        play = played(file, particles)
        (drive,) = play.scene(Motion("falling", "", {}, 1.0), body).drives
        assert drive.impulse == pytest.approx((1e-4 * total, 0.0, 0.0), rel=1e-12) and drive.duration == 1e-4


def test_object_impulse_meets_every_particle():
    (push,), _, _ = meaning("object_impulse", force=[0.2, 0, 0], num_dt=2, start_time=0.05)
    assert push.where is None and push.each == pytest.approx((4e-5, 0, 0)) and push.start == 0.05
    assert push.duration == pytest.approx(2e-4)


@pytest.mark.parametrize("force", [3.0, [0.0, 3.0, 0.0]])
def test_tearing_adds_no_momentum(force):
    """The halves get opposite impulses, the one beyond the middle that of the force."""
    file = parse({"boundary_conditions": [{"type": "object_tear", "force": force, "axis": 1}]})
    scene = played(file).scene(Motion("falling", "", {}, 1.0), block())
    up, down = scene.drives
    assert up.impulse == pytest.approx(tuple(-j for j in down.impulse), rel=1e-12) and up.impulse[1] > 0
    assert isinstance(up.where, InBox) and up.where.low[1] == 0.0 and down.where.high[1] == 0.0


def test_damping_is_that_factor_a_substep():
    """v(t) = v(t₀) scale^((t − t₀)/Δt) of a body that moves as a whole, for time steps that are not theirs."""
    push = {"type": "particle_impulse", "force": [1.0, 0, 0], "size": [2, 2, 2]}
    data = {"g": [0, 0, 0], "E": 1e4, "grid_v_damping_scale": 0.998, "substep_dt": 1e-4, "frame_dt": 2e-2}
    trajectory, _, _, _ = film(data | {"boundary_conditions": [push]}, 3)
    v = trajectory.v[1:, :, 0].double().mean(1)
    torch.testing.assert_close(v[1:] / v[:-1], torch.full((2,), 0.998**200, dtype=torch.float64), rtol=1e-6, atol=0)


@pytest.mark.parametrize("scale", [1.0, 1.1])
def test_damping_that_does_nothing_is_none(scale):
    assert world(parse({"grid_v_damping_scale": scale})).drives == ()


def test_held_particles_move_and_turn_as_told():
    """Translation x = x₀ + V t; rotation with the velocity that the file's formula gives in its own two axes,
    v = s r (−sin θ h₁ + cos θ h₂) + t n, h₂ = h₁ × n."""
    normal, s, t = np.array([0.0, 1.0, 0.0]), 1.9, 0.3
    conditions = [
        {"type": "enforce_particle_translation", "point": [1, 1, 1.4], "size": [1, 1, 0.1], "velocity": [0, 0.2, 0],
         **SPAN},
        {"type": "enforce_particle_velocity_rotation", "point": [1, 1, 0.6], "normal": normal.tolist(),
         "half_height_and_radius": [1.0, 0.3], "rotation_scale": s, "translation_scale": t, **SPAN},
    ]  # fmt: skip
    data = {"g": [0, 0, 0], "E": 1e4, "boundary_conditions": conditions}
    trajectory, _, body, play = film(data, 2)
    x0, height = body.x.numpy(), play.height
    moved = x0[:, 2] > 0.3
    there = trajectory.x[-1].double().numpy()[moved]
    expected = x0[moved] + [0.0, 0.2 * 0.02, height]
    np.testing.assert_allclose(there, expected, atol=2e-7)  # stored in float32
    offset = x0 - [0.0, 0.0, -0.4]
    flat = offset - np.outer(offset @ normal, normal)
    r = np.linalg.norm(flat, axis=1)
    turned = (r < 0.3) & ~moved
    assert moved.sum() == 36 and turned.sum() > 36
    h1 = np.array([1.0, 1.0, 1.0]) - normal
    h1 /= np.linalg.norm(h1)
    h2 = np.cross(h1, normal)
    # velocities of the last frame are those of the places at its last substep, at most frame_dt before its end
    now = (trajectory.x[-1].double().numpy() - [0.0, 0.0, height]) - [0.0, t * 0.02, -0.4]
    cos, sin = now @ h1, now @ h2
    v = s * (-np.outer(sin, h1) + np.outer(cos, h2)) + t * normal
    got = trajectory.v[-1].double().numpy()
    np.testing.assert_allclose(got[turned], v[turned], atol=s * s * 0.5 * 0.01)  # |Δv| = ω² r Δt


def test_layers_are_released_as_there():
    """A particle at a distance d from end_position, d < L = |start − end|, is held until end_time (1 − d/L)."""
    release = {"type": "release_particles_sequentially", "normal": [1, 0, 0], "start_position": 1.5,
               "end_position": 0.5, "num_layers": 50, "start_time": 0.0, "end_time": 0.06}  # fmt: skip
    data = {"E": 1e4, "boundary_conditions": [release]}
    trajectory, _, body, _ = film(data, 6)
    when = 0.06 * (1 - (body.x[:, 0] + 0.5))
    for k, x in enumerate(trajectory.x):
        held = when > k * 0.01 + 2e-4  # the clock of releases ticks every 0.12 ms
        assert torch.equal(x[held], trajectory.x[0][held])
    freed = when < 0.01  # the outermost layer, whose neighbours are free as well
    assert bool(freed.any())
    assert bool((trajectory.x[4][freed, 2] < trajectory.x[0][freed, 2]).all())


def test_release_from_the_middle_goes_both_ways():
    """The layers lie on both sides of end_position: two planes close in on it."""
    values = {"normal": [0, 0, 1], "start_position": 1.4, "end_position": 1.0, "num_layers": 50, **SPAN}
    made, _, height = meaning("release_particles_sequentially", {"g": [0, 0, 0]}, **values | {"end_time": 2.0})
    assert all(isinstance(r, Release) and r.speed == pytest.approx(0.2) for r in made)
    assert {(r.normal[2], round(r.point[2] - height, 9)) for r in made} == {(-1.0, 0.4), (1.0, -0.4)}


def test_translation_that_ends_lets_go():
    (held,), _, _ = meaning(
        "enforce_particle_translation", point=[1, 1, 1], size=[1, 1, 1], velocity=[0, 0, 1], start_time=0.2, end_time=2
    )
    assert isinstance(held, Held) and (held.start, held.end, held.velocity) == (0.2, 2.0, (0.0, 0.0, 1.0))
