"""The law of contact of every shape on single vectors, and its adjoints against central differences."""

import dataclasses

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.mpm import Box, Cylinder, HalfSpace, Mesh, Sphere
from diffuphy.mpm.boundary import N_WALL, rows, signature, wall_gradients
from diffuphy.mpm.boundary.layout import ANGULAR_VELOCITY, FRICTION, VELOCITY
from tests.mpm.walls import HERE, box_mesh, contact, coulomb, kernels

KINDS = [("sticky", 0.0), ("slip", 0.0), ("separate", 0.0), ("separate", 0.4)]
AT = (1.1, 0.9, 1.3)
MOTION = dict(velocity=(0.3, -0.2, 0.1), angular_velocity=(0.5, 0.4, -0.9))


def shapes() -> list:
    """One of each, moving and turning."""
    x, f = box_mesh((1.2, 0.9, 1.0))
    turned = dict(rotation=(0.3, -0.5, 0.2))
    return [
        HalfSpace(point=AT, normal=(0.2, -0.3, 1.0), **MOTION),
        Sphere(center=AT, radius=0.7, **MOTION),
        Box(center=AT, size=(1.2, 0.9, 1.0), **turned, **MOTION),
        Cylinder(center=AT, axis=(1.0, 2.0, 0.5), radius=0.6, height=1.1, **MOTION),
        Mesh(center=AT, vertices=x, faces=f, resolution=25, **turned, **MOTION),
    ]


WALLS = tuple(
    dataclasses.replace(shape, kind=kind, friction=mu, start=4.0 * i + j, end=4.0 * i + j + 1)
    for i, shape in enumerate(shapes())
    for j, (kind, mu) in enumerate(KINDS)
)
"""Each shape with each law; wall k acts from k to k + 1 s only, so that one compiled kernel serves them all."""

ROWS = rows(WALLS, HERE, np.arange(len(WALLS)) + 0.4)


def exponential(r) -> np.ndarray:
    """exp [r]×, by a general routine."""
    x, y, z = r
    return torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)).numpy()


def distance(wall, r: np.ndarray) -> np.ndarray:
    """φ of the shape 0.4 s after its start, by the definition in its docstring, of points (M, 3)."""
    R = exponential(0.4 * np.asarray(wall.angular_velocity))
    e = r - (np.asarray(AT) + 0.4 * np.asarray(wall.velocity))
    if isinstance(wall, HalfSpace):
        return e @ R @ np.asarray(wall.normal)
    if isinstance(wall, Sphere):
        return np.linalg.norm(e, axis=1) - wall.radius
    if isinstance(wall, Cylinder):
        h = e @ R @ np.asarray(wall.axis)
        rho = np.sqrt(np.maximum((e * e).sum(1) - h * h, 0))
        q = np.stack([rho - wall.radius, np.abs(h) - wall.height / 2], 1)
    else:
        q = np.abs(e @ R @ exponential((0.3, -0.5, 0.2))) - np.array([1.2, 0.9, 1.0]) / 2
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)


def normal(wall, r: np.ndarray, h: float = 1e-5) -> np.ndarray:
    """∇φ by central differences, not of length 1 across a kink."""
    return np.stack([(distance(wall, r + h * e) - distance(wall, r - h * e)) / (2 * h) for e in np.eye(3)], 1)


def nodes(k: int, rng: np.random.Generator, m: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes in and around wall k, no closer than 0.02 m to its surface and away from the kinks of φ; their velocities,
    and normals."""
    wall = WALLS[k]
    r = np.asarray(AT) + rng.uniform(-1, 1, (10 * m if isinstance(wall, Mesh) else m, 3))
    phi, n = distance(wall, r), normal(wall, r)
    keep = (np.abs(phi) > 0.02) & (np.abs(np.linalg.norm(n, axis=1) - 1) < 1e-8)
    if isinstance(wall, Mesh):
        # samples are 0.05 m apart: trilinear interpolation rounds off a kink of φ less than 2 of them away
        keep &= np.abs(normal(wall, r, 0.12) - n).max(1) < 1e-8
    return r[keep], rng.normal(size=(int(keep.sum()), 3)), n[keep]


def surface_velocity(wall, r: np.ndarray) -> np.ndarray:
    V, w = np.asarray(wall.velocity), np.asarray(wall.angular_velocity)
    return V + np.cross(w, r - (np.asarray(AT) + 0.4 * V))


@pytest.mark.parametrize("k", range(len(WALLS)), ids=[f"{type(w).__name__}-{w.kind}-{w.friction}" for w in WALLS])
def test_every_shape_obeys_the_law_of_contact(k):
    """Governed nodes (φ ≤ 0): u ← 0 | u_t | u_t max(0, 1 − μ |u_n|/|u_t|), u = v − V − ω × (x − c); others keep v."""
    wall = WALLS[k]
    r, v, n = nodes(k, np.random.default_rng(k))
    inside = distance(wall, r) <= 0
    assert 20 < inside.sum() < len(r) - 20
    want = np.where(inside[:, None], coulomb(v, n, surface_velocity(wall, r), wall.kind, wall.friction), v)
    got, _, _ = contact(WALLS, v, r, np.full(len(r), k), ROWS)
    # central differences of φ leave 1e-10 in the normal
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-8)
    if wall.kind == "separate":
        touched = inside & (((v - surface_velocity(wall, r)) * n).sum(1) < 0)
        assert 5 < touched.sum() and np.array_equal(got[~touched], v[~touched])


def test_float32_obeys_the_same_law():
    """A rough wall of each shape in float32, to a few rounding errors of numbers of size 3."""
    rough = WALLS[3::4]
    row = rows(rough, HERE, np.array([wall.start + 0.4 for wall in rough]))
    for b in range(len(rough)):
        r, v, _ = nodes(4 * b + 3, np.random.default_rng(b), 60)
        single, double = (
            contact(rough, v, r, np.full(len(r), b), row, real=real)[0] for real in (wp.float32, wp.float64)
        )
        np.testing.assert_allclose(single, double, rtol=0, atol=3e-5)


def sliding(r, v, k, h=1e-4):
    """Nodes at which the branch of the law is the same within h of v."""
    wall = WALLS[k]
    n, S = normal(wall, r), surface_velocity(wall, r)
    u = v - S
    u_n, t = (u * n).sum(1), np.linalg.norm(u - (u * n).sum(1, keepdims=True) * n, axis=1)
    return (np.abs(u_n) > h) & (t > 0.1) & (np.abs(t + wall.friction * np.minimum(u_n, 0)) > h)


def test_the_adjoint_is_that_of_the_law():
    """v̄·δv = ō·δo for all laws and shapes, central differences of 1e-5: error 1e-10/|u_t|² ≤ 1e-8."""
    h = 1e-5
    for k in range(len(WALLS)):
        rng = np.random.default_rng(100 + k)
        r, v, _ = nodes(k, rng)
        keep = sliding(r, v, k)
        r, v = r[keep], v[keep]
        s, v_bar, dv = np.full(len(r), k), rng.normal(size=v.shape), rng.normal(size=v.shape)
        o_bar = contact(WALLS, v, r, s, ROWS, v_bar)[1]
        up, down = (contact(WALLS, v + a * dv, r, s, ROWS)[0] for a in (h, -h))
        np.testing.assert_allclose((o_bar * dv).sum(1), (v_bar * (up - down)).sum(1) / (2 * h), rtol=1e-8, atol=1e-8)


V_AND_W = [*range(*VELOCITY.indices(N_WALL)), *range(*ANGULAR_VELOCITY.indices(N_WALL))]


def differences(walls, row, v, r, s, v_bar, at, h=1e-5) -> list[float]:
    """∂(Σ v̄·v)/∂row at each (step, wall, column), by central differences."""
    out = []
    for place in at:
        moved = row.copy()
        ends = []
        for a in (h, -h):
            moved[place] = row[place] + a
            ends.append((v_bar * contact(walls, v, r, s, moved)[0]).sum())
        out.append((ends[0] - ends[1]) / (2 * h))
    return out


def test_velocity_friction_and_spin_of_a_wall_have_gradients():
    """∂/∂V, ∂/∂ω and, of rough walls, ∂/∂μ of Σ v̄·v, for each law and shape alone; other walls get none."""
    for k, wall in enumerate(WALLS):
        rng = np.random.default_rng(200 + k)
        r, v, _ = nodes(k, rng, 60)
        keep = sliding(r, v, k)
        r, v = r[keep], v[keep]
        v_bar, s, row = rng.normal(size=v.shape), np.zeros(len(v), int), ROWS[k : k + 1]
        columns = [*V_AND_W, FRICTION] if wall.friction else V_AND_W
        got = contact(WALLS, v, r, s, row, v_bar)[2][0]
        want = differences(WALLS, row, v, r, s, v_bar, [(0, k, c) for c in columns])
        # up to 300 nodes of 1e-10 each, and rounding 1e-16/1e-5 of their sum
        np.testing.assert_allclose(got[k, columns], want, rtol=1e-8, atol=3e-8)
        assert not np.delete(got, k, 0).any() and np.abs(want).max() > 0.1


def test_gradients_of_settings_are_sums_over_the_steps_in_which_they_matter():
    """∂(Σ v̄·v)/∂(μ, V, ω) of the settings of a wall that stops and stands, over steps before and after its end."""
    rng = np.random.default_rng(9)
    settings = dict(friction=0.3, velocity=(0.3, 0.1, 0.2), angular_velocity=(0.2, 0.5, -0.3))
    times = np.array([0.0, 1e-9, 1.0])  # so early that the wall has not got anywhere
    r, v, v_bar = np.asarray(AT) + rng.uniform(-0.3, 0.3, (30, 3)), *rng.normal(size=(2, 30, 3))
    s = rng.integers(0, 3, 30)

    def wall(**changed):
        return (HalfSpace(point=AT, normal=(0.0, 0.1, 1.0), end=1e-6, reset=2.0, **(settings | changed)),)

    def total(walls):
        return (v_bar * contact(walls, v, r, s, rows(walls, HERE, times))[0]).sum()

    row_bar = contact(wall(), v, r, s, rows(wall(), HERE, times), v_bar)[2]
    friction, velocity, spin = wall_gradients(wall(), times, torch.from_numpy(row_bar))
    h = 1e-5
    want = (total(wall(friction=0.3 + h)) - total(wall(friction=0.3 - h))) / (2 * h)
    # a wall that moves 1e-6 s differently turns by 1e-11; rounding is 1e-15/h
    assert friction[0] == pytest.approx(want, rel=1e-8)
    for name, got in (("velocity", velocity), ("angular_velocity", spin)):
        for k, e in enumerate(np.eye(3)):
            ends = [total(wall(**{name: tuple(settings[name] + a * e)})) for a in (h, -h)]
            assert got[0, k] == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-5, abs=1e-5)


MANY = (
    HalfSpace(point=(1.0, 1.0, 1.2), friction=0.3, **MOTION),
    Sphere(center=AT, radius=0.9, friction=0.5, velocity=(0.1, 0.4, -0.2), angular_velocity=(1.0, 0.0, 0.5)),
    Box(center=AT, size=(1.6, 1.6, 1.6), kind="slip", angular_velocity=(0.2, -0.7, 0.3)),
)


def test_walls_one_after_the_other_have_the_gradient_of_their_composition():
    """Three walls over the same nodes: what each receives is pulled back through those after it."""
    rng = np.random.default_rng(7)
    row = rows(MANY, HERE, np.array([0.0, 0.3]))
    r = np.asarray(AT) + rng.uniform(-0.5, 0.5, (40, 3))
    v = rng.normal(size=r.shape)
    s = rng.integers(0, 2, len(r))
    # a kink within 1e-3 of v would bend the law there by about 1e-3, smooth branches bend it by 1e-6/|u_t|
    still, h = contact(MANY, v, r, s, row)[0], 1e-3
    bends = [sum(contact(MANY, v + a * e, r, s, row)[0] for a in (h, -h)) - 2 * still for e in np.eye(3)]
    keep = np.max([np.abs(bend).max(1) for bend in bends], axis=0) < 5e-6
    assert keep.sum() > 20
    r, v, s = r[keep], v[keep], s[keep]
    v_bar = rng.normal(size=v.shape)
    at = [(step, b, c) for step in (0, 1) for b in range(3) for c in V_AND_W]
    at += [(step, b, FRICTION) for step in (0, 1) for b in (0, 1)]
    got = contact(MANY, v, r, s, row, v_bar)[2]
    want = differences(MANY, row, v, r, s, v_bar, at)
    np.testing.assert_allclose([got[place] for place in at], want, rtol=1e-8, atol=1e-8)
    assert np.abs(want).min() > 1e-4


def test_gradients_of_a_smooth_still_wall_are_limits():
    """∂/∂μ at μ = 0 and ∂/∂ω at ω = 0, whose terms are not compiled, are those of μ → 0 and ω → 0."""
    rng = np.random.default_rng(3)
    r, v, v_bar = np.asarray(AT) + rng.uniform(-0.4, 0.4, (20, 3)), *rng.normal(size=(2, 20, 3))
    bars = []
    for tiny in (0.0, 1e-14):
        wall = Box(center=AT, size=(1.0, 1.05, 1.1), friction=tiny, angular_velocity=(0.0, 0.0, tiny))
        row = rows((wall,), HERE, np.zeros(1))
        bars.append(contact((wall,), v, r, np.zeros(20, int), row, v_bar)[2][0, 0])
    np.testing.assert_allclose(bars[0], bars[1], rtol=1e-11, atol=1e-12)
    assert np.abs(bars[0][[FRICTION, *V_AND_W]]).min() > 1e-3


@pytest.mark.slow
def test_walls_compile_for_cuda(tmp_path):
    """All shapes and laws, forward and backward, to PTX; it needs no device."""
    kernel = kernels(signature(WALLS), wp.float32)[0]
    wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == 1
