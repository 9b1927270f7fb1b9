"""Every kind of boundary condition of a scene file against the law that it stands for: a closed form, or a conservation
law, from the JSON to the states. float64, one block of 6³ particles, 1 m, in cells of ⅓ m.

Rigid motion is kept by transfer and constitutive law to rounding, so what acts on all particles alike is exact: 1e-9 is
a hundred substeps' rounding of numbers up to 10, with a factor of 10⁴ in hand.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from torch import Tensor

from diffuphy.mpm.rollout import rollout
from diffuphy.physgaussian import played
from diffuphy.physgaussian.grammar import CONDITIONS
from diffuphy.physgaussian.matter import matter
from diffuphy.physgaussian.scene_file import parse
from diffuphy.types import Motion, Particles

EXACT: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-9}
SPAN = {"start_time": 0, "end_time": 1e3}
SIDE, N = 1.0, 6
FINE = 10
"""Particles along the side of a block that rubs: five cells nod a third as much as three."""
DX = 2 * SIDE / N
G = 9.8
FLOOR = {"point": [1, 1, 0.5], "normal": [0, 0, 1], **SPAN}
STIFF = {"E": 1e6, "nu": 0.2, "density": 1000}
FREE = {"g": [0, 0, 0], "E": 1e4, "nu": 0.2, "density": 1000}


@dataclass(frozen=True)
class Run:
    """What became of the block, frame by frame."""

    x: Tensor
    v: Tensor
    m: Tensor
    impulses: Tensor
    """Of all walls in each frame, shape (T, 3) [N s]."""
    data: dict
    dt: float

    @property
    def p(self) -> Tensor:
        """Momentum, shape (T + 1, 3) [N s]."""
        return (self.m[:, None] * self.v).sum(1)

    @property
    def home(self) -> Tensor:
        """Places at the beginning, about the middle of the block, shape (N, 3)."""
        return self.x[0] - (self.x[0].amin(0) + self.x[0].amax(0)) / 2

    @property
    def t(self) -> Tensor:
        return self.dt * torch.arange(len(self.x), dtype=torch.float64)

    def all_move(self, v: tuple[float, float, float]) -> Tensor:
        return self.v[0].new_tensor(v).expand_as(self.v[0])


def play(data: dict, condition: dict, frames: int, n: int = N, **settings: Any) -> Run:
    """A block of n³ particles in a scene of one condition."""
    g = (torch.arange(n, dtype=torch.float64) + 0.5) * SIDE / n - SIDE / 2
    x = torch.cartesian_prod(g, g, g)
    vol = torch.full((len(x),), (SIDE / n) ** 3, dtype=torch.float64)
    body = Particles(x, vol, torch.zeros(len(x), dtype=torch.long), 1.0, (0.0, 0.0, 0.0), SIDE / n)
    file = parse(data | {"boundary_conditions": [condition]})
    motion = Motion("falling", "", {}, SIDE)
    field = matter(file)(None, motion, None, body, work=None)
    scene = played(file, **settings).scene(motion, body)
    reports: list = []
    gather = ("impulse",) if scene.boundaries else ()
    out = rollout(scene, x, vol, field, frames=frames, report=reports, gather=gather)
    wall = [r.impulse for r in reports] if gather else [torch.zeros(3, dtype=torch.float64)] * frames
    return Run(out.x, out.v, field.rho.double() * vol, torch.stack(wall), data, 1.0 / scene.fps)


def gravity_and_walls(run: Run) -> None:
    """Newton: the momentum that a frame adds is that of gravity and of the walls."""
    weight = run.m.sum() * torch.tensor(run.data.get("g", [0, 0, -G]), dtype=torch.float64) * run.dt
    torch.testing.assert_close(run.p[1:] - run.p[:-1], run.impulses + weight, rtol=1e-9, atol=1e-9 * float(run.m.sum()))


# --------------------------------------------------------------------------- impulses
def impulse(run: Run) -> None:
    """Σ m v = n F num_dt Δt: 108 particles lie in x ≥ 1; nothing else acts, and the momentum then stays."""
    J = 108 * 2 * 1e-4 * torch.tensor([-0.18, 0.0, 0.09], dtype=torch.float64)
    torch.testing.assert_close(run.p[1:], J.expand_as(run.p[1:]), **EXACT)


def object_impulse(run: Run) -> None:
    """Everything together: v = F num_dt Δt / m, m that of a particle, and no turning."""
    v = 0.5 * 3 * 1e-4 / float(run.m[0])
    torch.testing.assert_close(run.v[-1], run.all_move((v, 0.0, 0.0)), rtol=1e-9, atol=1e-9 * v)


def tear(run: Run) -> None:
    """Two opposite impulses add no momentum; their moment about the middle is none. The halves part."""
    size = float((run.m[:, None] * run.v[-1]).norm(dim=1).sum())
    assert size > 0 and float(run.p.norm(dim=1).max()) < 1e-12 * max(size, 1.0)
    turning = torch.linalg.cross(run.home, run.m[:, None] * run.v[-1]).sum(0)
    assert float(turning.norm()) < 1e-9 * size
    up = run.home[:, 1] > 0
    assert float(run.v[1, up, 1].mean()) > 0 > float(run.v[1, ~up, 1].mean())


# --------------------------------------------------------------------------- particles that are led
def translation(run: Run) -> None:
    """x = x₀ + V t of those in the box, to rounding, whatever the rest does."""
    led = run.home[:, 2] > 0.3
    there = run.x[0, led] + run.t[:, None, None] * run.x.new_tensor([0.0, 0.2, 0.1])
    assert int(led.sum()) == 36
    torch.testing.assert_close(run.x[:, led], there, **EXACT)


def rotation(run: Run) -> None:
    """ω × r: about the axis y by −s t, along it by u t: x = c + R(−s t) (x₀ − c) + u t n."""
    axis = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    led = run.home[:, [0, 2]].norm(dim=1) < 0.3
    e = run.home[led]
    for k, t in enumerate(run.t.tolist()):
        a = -1.9 * t
        turned = e * math.cos(a) + torch.linalg.cross(axis.expand_as(e), e) * math.sin(a)
        turned += (e @ axis)[:, None] * axis * (1 - math.cos(a))
        middle = run.x[0, led] - e
        torch.testing.assert_close(run.x[k, led], middle + turned + 0.3 * t * axis, **EXACT)
    assert 0 < int(led.sum()) < len(e) + len(run.home)


def release(run: Run) -> None:
    """A particle x − x_end = d from the end is free after end_time (1 − d/L): before it has not moved by a bit, and
    what is free has fallen."""
    when = 0.3 * (1 - (run.home[:, 0] + 0.5))
    for k, t in enumerate(run.t.tolist()):
        held = when > t + 0.01  # the clock of releases ticks every substep
        assert torch.equal(run.x[k, held], run.x[0, held])
    first = when == when.min()
    assert float(when.min()) < run.dt < float(when.max()) and bool((run.v[3, first, 2] < 0).all())


# --------------------------------------------------------------------------- walls
def bounding_box(run: Run) -> None:
    """Nothing leaves; walls without friction give no momentum along themselves, and the rest is what they record."""
    gravity_and_walls(run)
    half = 1.0 - 3 * 0.04
    middle = (run.x[0].amin(0) + run.x[0].amax(0)) / 2
    outside = ((run.x - middle).abs().amax(dim=(0, 1)) - half)[:2]
    assert float(outside.max()) < 0.5 * DX  # nodes behind the wall hold; particles follow within half a cell
    assert float(run.p[:, 0].min()) < 0 < float(run.p[0, 0]), "it is thrown back"
    torch.testing.assert_close(run.p[:, 1], run.p[0, 1].expand(len(run.p)), **EXACT)


def cuboid(run: Run) -> None:
    """What lies in it has its velocity, to rounding; after its end, and 15 substeps of rest, it is free: v = g t."""
    moved = run.all_move((0.0, 0.2, 0.0))
    torch.testing.assert_close(run.v[1:3], moved.expand(2, -1, -1), **EXACT)
    # it stops for 15 · 1e-4 s, rounded to substeps, then falls for what is left of two frames
    fallen = -G * (2 * run.dt - 15e-4)
    assert float(run.v[-1, :, 1].abs().max()) < 1e-9
    assert float(run.v[-1, :, 2].mean()) == pytest.approx(fallen, abs=G * 0.01)


def sticky(run: Run) -> None:
    """It carries: pulled sideways the block shears by less than twice ρ g_x H²/2G and goes nowhere."""
    gravity_and_walls(run)
    shear = 1000 * 4.0 * SIDE**2 / (2 * 1e6 / (2 * 1.2))
    assert 0 < float((run.x[-1] - run.x[0])[:, 0].mean()) < 2 * shear


def slip(run: Run) -> None:
    """v_x = g_x t exactly, and no friction; normal momentum is none: pulled upwards at g it goes nowhere either."""
    gravity_and_walls(run)
    torch.testing.assert_close(run.p[:, 0], float(run.m.sum()) * 4.0 * run.t, rtol=1e-9, atol=1e-9 * 1000)
    stretch = 1000 * G * SIDE**2 / (2 * 1e6 / (2 * 1.2))
    assert 0 <= float((run.x[-1] - run.x[0])[:, 2].mean()) < 2 * stretch


def separate(run: Run) -> None:
    """It lets go: pulled upwards the block flies, v = g t, x = ½ g t², as if it had never lain there."""
    free = run.v.new_tensor([0.0, 0.0, G]) * run.t[:, None, None]
    torch.testing.assert_close(run.v, free.expand_as(run.v), **EXACT)
    assert not run.impulses.any()


def friction(run: Run) -> None:
    """Coulomb: it stops after v²/(2 μ g), and stays, but for its shear ρ μ g H²/2G, from which it swings back."""
    shear = 1000 * 0.4 * G * SIDE**2 / (2 * 1e6 / (2 * 1.2))
    way = (run.x - run.x[0])[..., 0].mean(1)
    assert way[-4:].tolist() == pytest.approx([2.0**2 / (2 * 0.4 * G)] * 4, abs=2 * shear)


def collide(run: Run) -> None:
    """An elastic block rebounds: what the wall gives lies between m v, stopped, and 2 m v, mirrored; along it nothing
    changes."""
    gravity_and_walls(run)
    given = float(run.impulses[:, 2].sum()) / float(-run.p[0, 2])
    assert 1.0 < given < 2.0, given
    torch.testing.assert_close(run.p[:, 0], run.p[0, 0].expand(len(run.p)), rtol=1e-9, atol=1e-9)


def sdf(run: Run) -> None:
    """Two walls across an axis: nothing gets out between them, momentum along them stays, the rest they record."""
    gravity_and_walls(run)
    middle = (run.x[0].amin(0) + run.x[0].amax(0)) / 2
    assert float((run.x - middle)[..., 1].abs().max()) < 0.7 + 0.5 * DX
    assert float(run.p[:, 1].min()) < 0 < float(run.p[0, 1])
    for axis in (0, 2):
        torch.testing.assert_close(run.p[:, axis], run.p[0, axis].expand(len(run.p)), **EXACT)


def nothing(run: Run) -> None:
    """Surroundings are no particles here: free fall, v = g t."""
    fall = run.v.new_tensor([0.0, 0.0, -G]) * run.t[:, None, None]
    torch.testing.assert_close(run.v, fall.expand_as(run.v), **EXACT)


Law = Callable[[Run], None]

TABLE: list[tuple[str, Law, dict, dict, int, dict]] = [
    ("particle_impulse", impulse, FREE | {"frame_dt": 1e-2},
     {"force": [-0.18, 0.0, 0.09], "num_dt": 2, "point": [1.5, 1, 1], "size": [0.5, 2, 2]}, 3, {}),
    ("object_impulse", object_impulse, FREE, {"force": [0.5, 0, 0], "num_dt": 3}, 2, {}),
    ("object_tear", tear, FREE, {"force": 40.0, "axis": 1, "num_dt": 2}, 2, {}),
    ("enforce_particle_translation", translation, FREE | {"g": [0, 0, -9.8]},
     {"point": [1, 1, 1.45], "size": [1, 1, 0.1], "velocity": [0, 0.2, 0.1], **SPAN}, 4, {}),
    ("enforce_particle_velocity_rotation", rotation, FREE,
     {"point": [1, 1, 1], "normal": [0, 1, 0], "half_height_and_radius": [1.0, 0.3], "rotation_scale": 1.9,
      "translation_scale": 0.3, **SPAN}, 4, {}),
    ("release_particles_sequentially", release, FREE | {"g": [0, 0, -9.8], "frame_dt": 5e-2},
     {"normal": [1, 0, 0], "start_position": 1.5, "end_position": 0.5, "num_layers": 50, "start_time": 0.0,
      "end_time": 0.3}, 5, {}),
    ("bounding_box", bounding_box, FREE | {"E": 1e5, "frame_dt": 4e-2}, {}, 10, {"velocity": (3.0, 0.2, 0.0)}),
    ("cuboid", cuboid, STIFF | {"frame_dt": 2e-2},
     {"point": [1, 1, 1], "size": [1, 1, 1], "velocity": [0, 0.2, 0], "end_time": 0.04, "reset": 1}, 4, {}),
    ("surface_collider", sticky, STIFF | {"g": [4.0, 0, -9.8]}, FLOOR | {"surface": "sticky", "friction": 0}, 20, {}),
    ("surface_collider", slip, STIFF | {"g": [4.0, 0, 9.8]}, FLOOR | {"surface": "slip", "friction": 0}, 10, {}),
    ("surface_collider", separate, STIFF | {"g": [0, 0, 9.8]}, FLOOR | {"surface": "separate", "friction": 0.4}, 5, {}),
    ("surface_collider", friction, STIFF | {"frame_dt": 4e-2}, FLOOR | {"surface": "separate", "friction": 0.4}, 20,
     {"velocity": (2.0, 0.0, 0.0), "n": FINE}),
    ("surface_collider", collide, STIFF | {"g": [0, 0, 0], "frame_dt": 4e-2},
     FLOOR | {"point": [1, 1, 0.3], "surface": "collide", "friction": 0.0}, 10, {"velocity": (0.5, 0.0, -2.0)}),
    ("sdf_collider", sdf, FREE | {"E": 1e5, "frame_dt": 4e-2}, {"bound": 0.3, "dim": 1, **SPAN}, 12,
     {"velocity": (0.5, 3.0, 0.25)}),
    ("enforce_scene_translation", nothing, STIFF, {"velocity": [1, 0, 0], **SPAN}, 3, {}),
]  # fmt: skip
"""Kind of a condition, its law, the file around it, its settings, frames, settings of the player."""


@pytest.mark.parametrize(
    ("kind", "law", "data", "values", "frames", "settings"), TABLE, ids=[f"{r[0]}-{r[1].__name__}" for r in TABLE]
)
def test_a_condition_obeys_its_law(kind, law, data, values, frames, settings):
    """See the law of each row."""
    law(play(data, {"type": kind, **values}, frames, **settings))


def test_every_kind_has_a_law():
    """Seven of PhysGaussian, three of DecoupledGaussian, two of OmniPhysGS: ``collide`` is a surface."""
    assert {row[0] for row in TABLE} == set(CONDITIONS)
    surfaces = {row[3]["surface"] for row in TABLE if row[0] == "surface_collider"}
    assert surfaces == {"sticky", "slip", "separate", "collide"}
