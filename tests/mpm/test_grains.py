"""Grains as a body: they keep their volume, hardly jump, and stand as a pile."""

import dataclasses
import math

import pytest
import torch

from diffuphy.material.plastic.drucker_prager import slope
from diffuphy.mpm import HalfSpace, Scene, Scheme, simulate
from tests.mpm.bodies import block, field

DX = 0.04
LAWS = (("hencky",), ("drucker_prager",))
FLOOR = Scene(dx=DX, fps=30.0, frames=30, boundaries=(HalfSpace(friction=0.8),), lift=None)


def heap(radius: float, angle: float, z: float):
    """Particles of a cone of this slope [deg], its foot at height z."""
    height = radius * math.tan(math.radians(angle))
    cells = (2 * radius / DX, 2 * radius / DX, height / DX)
    x, vol = block(cells, DX, (-radius, -radius, 0.0), dtype=torch.float32)
    inside = x[:, 2] < height * (1 - x[:, :2].norm(dim=1) / radius)
    x, vol = x[inside], vol[inside]
    return x + x.new_tensor([0.0, 0.0, z]), vol, height


def sand(n: int, **theta: float):
    return field(n, *LAWS, E=1e6, nu=0.2, rho=1600.0, dtype=torch.float32, **theta)


def test_a_dropped_heap_keeps_its_bulk():
    """After a fall of 0.25 m the mean volume is 1 within 10 %, and it is still a heap, lower than it was.

    A cone that forgets volume ends at 2.95 here. Grains that return all the work (χ = 1) are flung apart to 2.8 and
    fall into a flat cake.
    """
    x, vol, height = heap(0.24, 40.0, 0.25)
    *_, end = simulate(FLOOR, x, vol, sand(len(x), friction_angle=40.0))
    assert abs(float(end.memory[:, 0].exp().mean()) - 1) < 0.1
    assert 0.5 * height < float(end.x[:, 2].max()) < height
    assert float(end.v.norm(dim=1).mean()) < 0.05


def test_a_heap_below_its_angle_of_repose_stands():
    """Slope 20° at a friction angle of 35° (more in this cone): it sinks by compression alone, ρ g h/(χ M) = 6 % at
    its foot."""
    x, vol, _ = heap(0.4, 20.0, 0.0)
    *_, end = simulate(FLOOR, x, vol, sand(len(x), friction_angle=35.0))
    spread = (end.x[:, :2].norm(dim=1).mean() / x[:, :2].norm(dim=1).mean()).item()
    sunk = (end.x[:, 2].mean() / x[:, 2].mean()).item()
    assert abs(spread - 1) < 0.02 and 0.94 < sunk <= 1


def test_a_heap_on_an_elastic_floor_comes_to_a_stand():
    """Its foot is thinner than the kernel and rises by up to X(0) − ¼ = 0.16 Δx, which makes it creep out by less than
    that at each side, 0.16 Δx/(R/2) = 3 % for R = 10 Δx, with as much for the weight it is set down with; then it
    stands."""
    x, vol, _ = heap(0.4, 20.0, 0.0)
    floor = dataclasses.replace(FLOOR, scheme=Scheme(contact="elastic"))
    states = list(simulate(floor, x, vol, sand(len(x), friction_angle=35.0)))
    spread = [(s.x[:, :2].norm(dim=1).mean() / x[:, :2].norm(dim=1).mean()).item() for s in states]
    assert spread[-1] - 1 < 0.06 and abs(spread[-1] - spread[-8]) < 1e-3
    assert float(states[-1].v.norm(dim=1).mean()) < 2e-3


def test_a_steep_heap_flows_until_it_has_its_angle_of_repose():
    """A heap of 55° stops at the angle whose plane-strain cone is that of φ = 15° in compression, 19°, within 5°: at
    Δx the heap is five cells high. Of a cone of slope h/R the means are z = h/4 and r = R/2."""
    x, vol, _ = heap(0.24, 55.0, 0.0)
    *_, end = simulate(FLOOR, x, vol, sand(len(x), friction_angle=15.0))
    angles = torch.linspace(1, 45, 4401)
    alpha = slope(torch.tensor(15.0), "compression")
    repose = float(angles[(slope(angles, "plane_strain") - alpha).abs().argmin()])
    found = math.degrees(math.atan(float(2 * end.x[:, 2].mean() / end.x[:, :2].norm(dim=1).mean())))
    assert abs(found - repose) < 5
    assert abs(float(end.memory[:, 0].exp().mean()) - 1) < 0.1


def test_the_memory_of_volume_is_the_logarithm_of_the_determinant():
    """ln J summed over substeps is ln det F in float64 to rounding, through impact, flow and flight."""
    x, vol, _ = heap(0.16, 40.0, 0.02)
    x, vol = x.double(), vol.double()
    scene = dataclasses.replace(FLOOR, velocity=(0.0, 0.0, -3.0), frames=6)
    *_, end = simulate(scene, x, vol, field(len(x), *LAWS, E=1e5))
    J = torch.linalg.det(end.F)
    assert float(end.memory.abs().max()) > 0.1
    # a thousand substeps of rounding 1e-16, amplified by the condition of F, below 1e3
    torch.testing.assert_close(end.memory[:, 0], J.log(), rtol=0, atol=1e-9)


def test_only_grains_remember_volume():
    x, vol, _ = heap(0.12, 40.0, 0.0)
    for laws, memory in ((LAWS, True), ((("hencky",), ("von_mises",)), False)):
        *_, end = simulate(dataclasses.replace(FLOOR, frames=1), x, vol, field(len(x), *laws, dtype=x.dtype))
        assert (end.memory is not None) is memory


def test_a_state_without_the_memory_it_needs_is_refused():
    x, vol, _ = heap(0.12, 40.0, 0.0)
    f = sand(len(x))
    *_, end = simulate(FLOOR, x, vol, f, frames=0)
    with pytest.raises(ValueError, match="need memory"):
        next(simulate(FLOOR, x, vol, f, state=dataclasses.replace(end, memory=None)))
