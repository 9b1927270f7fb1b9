"""A part of the block gives what the whole block gives."""

import dataclasses
import re

import pytest
import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import FrameReport, Grid, HalfSpace, Scene, Sphere, rollout, simulate
from diffuphy.mpm.engine import clock
from diffuphy.mpm.engine.active import active, widened
from diffuphy.mpm.substep.kernels import make_kernels
from diffuphy.mpm.substep.nodes import make_nodes
from diffuphy.mpm.substep.nodes_adjoint import make_nodes_adjoint
from diffuphy.mpm.substep.variant import Variant
from tests.mpm.bodies import block, field
from tests.mpm.text import source

DX = 0.05
WALLS = (
    HalfSpace(kind="slip"),
    HalfSpace(point=(0.0, 0.05, 0.0), normal=(0.0, 1.0, 0.0), kind="sticky"),
    Sphere(center=(1.3, 0.5, 0.3), radius=0.2, friction=0.2),
)
SCENE = Scene(
    dx=DX, fps=60.0, frames=2, lift=None, velocity=(1.0, 0.5, -1.0), spin=(0.0, 1.0, 2.0), boundaries=WALLS
)  # fmt: skip


def two(gap: tuple[float, float, float], cells: int = 3, dtype: torch.dtype = torch.float64):
    """Two cubes, the other one ``gap`` away, and their material."""
    x, vol = block((cells, cells, cells), DX, (0.1, 0.1, 0.02), dtype=dtype)
    x = torch.cat([x, x + x.new_tensor(gap)])
    return x, torch.cat([vol, vol]), field(len(x), dtype=dtype)


def film(monkeypatch, sparse: bool, threads: int = 1, gap: tuple[float, float, float] = (1.0, 0.3, 0.5)):
    """Films and gradients of two cubes between walls, in all of the block or in the part that it takes."""
    monkeypatch.setattr(clock, "SPARSE_NODES", 1)
    monkeypatch.setattr(clock, "SPARSE_SHARE", 2.0 if sparse else 0.0)
    x, vol, f = two(gap)
    E, v = f.theta["E"].clone().requires_grad_(), torch.zeros(3, dtype=x.dtype, requires_grad=True)
    f = dataclasses.replace(f, theta=f.theta | {"E": E})
    reports: list[FrameReport] = []
    out = rollout(SCENE, x, vol, f, velocity=v, grad=True, threads=threads, report=reports)
    bars = torch.autograd.grad(out.x.square().sum() + out.v.square().sum() + out.F.square().sum(), [E, v])
    return reports, (out.x, out.v, out.F, *bars)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_part_of_the_block_gives_the_same_bits(monkeypatch, threads):
    """Positions, velocities, deformation and gradients, with mirror walls, a corner of two of them and a sphere."""
    reports, part = film(monkeypatch, True, threads)
    whole_reports, whole = film(monkeypatch, False, threads)
    assert all(torch.equal(a, b) for a, b in zip(part, whole, strict=True))
    assert all(a.grid.nodes == b.grid.nodes for a, b in zip(reports, whole_reports, strict=True))
    assert all(r.active is not None and r.active < 0.4 * r.grid.nodes for r in reports)
    assert all(r.active is None for r in whole_reports)


def test_the_share_decides_and_a_compact_body_has_no_list(monkeypatch):
    """Two far cubes are run in a part of their block without being told to, one cube is not."""
    monkeypatch.setattr(clock, "SPARSE_NODES", 1)
    for gap, thin in (((2.0, 2.0, 2.0), True), ((0.15, 0.0, 0.0), False)):
        x, vol, f = two(gap)
        reports: list[FrameReport] = []
        rollout(dataclasses.replace(SCENE, boundaries=()), x, vol, f, frames=1, report=reports)
        assert (reports[0].active is not None) == thin


def test_who_leaves_the_active_cells_is_followed(monkeypatch):
    """An acceleration that the free path does not know of carries particles b T²/2 = 0.31 m, six cells, out of their
    slack of two: the frame is run again with more of them, and ends as in the whole block."""
    monkeypatch.setattr(clock, "SPARSE_NODES", 1)
    ends = []
    for share in (2.0, 0.0):
        monkeypatch.setattr(clock, "SPARSE_SHARE", share)
        x, vol, f = two((1.0, 1.0, 1.0))
        push = torch.zeros_like(x)
        push[:, 1] = 40.0
        still = (0.0, 0.0, 0.0)
        scene = dataclasses.replace(SCENE, boundaries=(), velocity=still, spin=still, gravity=still, fps=8.0)
        reports: list[FrameReport] = []
        *_, end = simulate(scene, x, vol, f, frames=1, report=reports, body=lambda _: push)  # noqa: B023, called at once
        assert reports[0].reruns > 0 and reports[0].halvings == 0
        ends.append(end)
    assert torch.equal(ends[0].x, ends[1].x) and torch.equal(ends[0].He, ends[1].He)
    assert float((ends[0].x - x)[:, 1].min()) > 5 * DX


def test_work_follows_the_particles_and_not_the_box():
    """Twice the distance: eight times the box, as many active nodes."""
    counts, boxes = [], []
    for gap in (2.0, 4.0):
        x, _, _ = two((gap, gap, gap))
        grid = Grid.around(tuple((x.amin(0) - DX).tolist()), tuple((x.amax(0) + DX).tolist()), DX)
        part = active(
            x, torch.zeros_like(x), dataclasses.replace(grid, slack=1), 0.01, (0.0, 0.0, 0.0), 2,
            ((-99,) * 3, (10**8,) * 3), 2,
        )  # fmt: skip
        counts.append(len(part.nodes))
        boxes.append(grid.nodes)
    assert counts[0] == counts[1] and boxes[1] > 6 * boxes[0]


@pytest.mark.parametrize("order", [2, 3])
def test_allowed_cells_and_active_nodes_cover_the_path(order):
    """Every point of every free path lies in an allowed cell, and every node around it, and one more, is active."""
    torch.manual_seed(0)
    x, v = torch.rand(40, 3, dtype=torch.float64), 4.0 * torch.randn(40, 3, dtype=torch.float64)
    T, g = 0.1, (0.0, 0.0, -9.81)
    path = [x + t * v + 0.5 * t * t * x.new_tensor(g) for t in torch.linspace(0, T, 500).tolist()]
    low, high = torch.stack(path).amin((0, 1)) - 2 * DX, torch.stack(path).amax((0, 1)) + 2 * DX
    grid = dataclasses.replace(Grid.around(tuple(low.tolist()), tuple(high.tolist()), DX, order), slack=2)
    part = active(x, v, grid, T, g, order, ((-99,) * 3, (10**8,) * 3), 2)
    cells, nodes = part.cells.reshape(grid.shape).bool(), torch.zeros(grid.nodes, dtype=torch.bool)
    nodes[part.nodes.long()] = True
    nodes = nodes.reshape(grid.shape)
    for now in path:
        lowest = ((now - x.new_tensor(grid.low)) / DX - 0.5 * (order - 1)).floor().long()
        assert bool(cells[lowest.unbind(1)].all())
        for corner in ((-1, -1, -1), (order + 1,) * 3, (-1, order + 1, 0)):
            at = (lowest + torch.tensor(corner)).clamp_min(0).minimum(torch.tensor(grid.shape) - 1)
            assert bool(nodes[at.unbind(1)].all())


def test_widened_is_a_sum_of_sets():
    """Down 2, up 3 along each axis, cut at the faces."""
    mask = torch.zeros(9, 7, 8, dtype=torch.bool)
    mask[4, 0, 7] = True
    expected = torch.zeros_like(mask)
    expected[2:8, 0:4, 5:8] = True
    assert torch.equal(widened(mask, 2, 3), expected)


def test_a_compact_body_pays_nothing(tmp_path):
    """Neither list nor table is read by the kernels of the whole block; those of a part compile for CUDA too."""
    mixture = make_mixture(("neo_hookean",), ("identity",), wp.float64)
    for sparse in (False, True):
        v = Variant(mixture, wp.float64, twice=True, sparse=sparse)
        kernels = {**vars(make_kernels(v)), **vars(make_nodes(v)), **vars(make_nodes_adjoint(v))}
        for name, kernel in kernels.items():
            if name in ("p2g", "g2p") or not sparse:
                reads = re.findall(r"address\(var_(?:cells|active)\b", re.sub(r"//.*", "", source(kernel)))
                assert bool(reads) == sparse, name
            if sparse and name in ("p2g", "g2p", "divide"):
                wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path / name, use_ptx=True)
                assert len(list((tmp_path / name).glob("*.ptx"))) == 1


def test_slack_grows_with_the_block():
    """So that a frame that is run again has more allowed cells as well as more nodes."""
    grid = Grid(DX, (0, 0, 0), (9, 9, 9), slack=2)
    assert grid.grown(4).slack == 6 and Grid(DX, (0, 0, 0), (9, 9, 9)).grown(4).slack is None
