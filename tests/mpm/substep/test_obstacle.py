"""What is held is a wall for other matter, which stands on it, bounces off it and hangs on it."""

import pytest
import torch
from torch import Tensor

from diffuphy.mpm import HalfSpace, Held, Release, Scene, Scheme, rollout
from diffuphy.mpm.engine.launch import Arguments
from tests.mpm.bodies import block, field
from tests.mpm.substep.test_adjoint import check_by_differences

DX = 0.05
ROUGH = 1e9
"""Friction of a wall on which nothing slides [-]."""
SCHEMES = {"default": Scheme(), "no retention": Scheme(retain=0.0)}


def over(slab_cells, cells, *, gap: float = 0.0, low: float = 0.0, ball: bool = False):
    """A slab with its lower face at z = ``low`` [m], and above the middle of it, ``gap`` [m] away, a block or a ball:
    positions, volumes, how many belong to the slab, and the height of its upper face [m]."""
    slab, vol = block(slab_cells, DX, (0.0, 0.0, low))
    top = low + slab_cells[2] * DX
    side = [(a - b) / 2 * DX for a, b in zip(slab_cells[:2], cells[:2], strict=True)]
    body, more = block(cells, DX, (side[0], side[1], top + gap))
    if ball:
        inside = (body - body.mean(0)).norm(dim=1) < cells[0] / 2 * DX
        body, more = body[inside], more[inside]
    return torch.cat([slab, body]), torch.cat([vol, more]), len(slab), top


def on_held(x, vol, slab: int, *, seconds: float, E: float, scheme: Scheme = SCHEMES["default"], **held) -> Tensor:
    """Motion of the body over a slab that is held, and that it is no part of."""
    drives = (Held(where=tuple(range(slab)), attached=False, **held),)
    scene = Scene(dx=DX, fps=50.0, boundaries=(), lift=None, drives=drives, scheme=scheme)
    return rollout(scene, x, vol, field(len(x), E=E), frames=round(50 * seconds)).x[:, slab:]


def on_wall(x, vol, slab: int, top: float, *, seconds: float, E: float, scheme: Scheme = SCHEMES["default"]) -> Tensor:
    """Motion of the same body over a rough wall with the surface of the slab."""
    wall = HalfSpace(point=(0.0, 0.0, top), friction=ROUGH)
    scene = Scene(dx=DX, fps=50.0, boundaries=(wall,), lift=None, scheme=scheme)
    return rollout(scene, x[slab:], vol[slab:], field(len(x) - slab, E=E), frames=round(50 * seconds)).x


@pytest.mark.parametrize("name", SCHEMES)
def test_a_soft_block_stands_on_held_matter_as_on_a_rough_wall(name):
    """Two seconds, ρ g H/E = 0.2: each particle within a thousandth of a cell of where a wall lets it be."""
    x, vol, slab, top = over((5, 5, 3), (3, 3, 4))
    how = {"seconds": 2.0, "E": 1e4, "scheme": SCHEMES[name]}
    got, want = on_held(x, vol, slab, **how), on_wall(x, vol, slab, top, **how)
    assert float((want[-1] - want[0]).norm(dim=1).max()) > 0.2 * DX, "it is compressed"
    # nodes may let go at another substep at the turn of a swing: of u·∇m and u·n the last digits differ
    torch.testing.assert_close(got, want, rtol=0, atol=1e-3 * DX)


@pytest.mark.parametrize("low", [0.0, 0.3 * DX, 0.6 * DX])
def test_a_ball_bounces_off_held_matter_as_off_a_wall(low):
    """Wherever the surface lies between the nodes, it turns at the same time and place and rises as high."""
    x, vol, slab, top = over((6, 6, 3), (4, 4, 4), gap=4 * DX, low=low, ball=True)
    got = on_held(x, vol, slab, seconds=0.6, E=1e5).mean(1)[:, 2]
    want = on_wall(x, vol, slab, top, seconds=0.6, E=1e5).mean(1)[:, 2]
    turn = int(want.argmin())
    assert int(got.argmin()) == turn and float(want[turn:].max() - want[turn]) > 2 * DX
    # at the rim of the contact ∇m leans inwards, so that some nodes let go a substep sooner or later
    torch.testing.assert_close(got, want, rtol=0, atol=0.02 * DX)


@pytest.mark.parametrize("low", [0.0, 0.25 * DX, 0.5 * DX])
def test_a_single_layer_of_held_particles_has_no_gaps(low):
    """A sheet half a cell thick turns a ball back within a cell and a half of its surface, on the side that it comes
    from: nodes half a cell from a particle are marked, and ∇m leads to what touches them."""
    x, vol, slab, top = over((6, 6, 0.5), (4, 4, 4), gap=3 * DX, low=low, ball=True)
    lowest = on_held(x, vol, slab, seconds=0.6, E=1e5)[:, :, 2].amin(1)
    assert top - 0.5 * DX < float(lowest.min()) < top + 1.5 * DX
    assert float(lowest[int(lowest.argmin()) :].max()) > float(lowest.min()) + 2 * DX


def hanging(attached: bool, seconds: float):
    """Motion of a block under a held one that it touches; the whole has four rows of cells, two of them free."""
    x, vol = block((3, 3, 4), DX)
    free = x[:, 2] < 2 * DX
    drives = (Held(where=~free, attached=attached),)
    scene = Scene(dx=DX, fps=50.0, boundaries=(), lift=None, drives=drives)
    out = rollout(scene, x, vol, field(len(x), E=1e4, nu=0.0), frames=round(50 * seconds))
    return out.x[:, free], out.v[:, free]


def test_what_only_lies_against_held_matter_falls_off_it():
    """v = g t: nothing holds it back and nothing strains it."""
    _, v = hanging(attached=False, seconds=0.2)
    want = v.new_tensor([0.0, 0.0, -9.81 * 0.2]).expand_as(v[-1])
    torch.testing.assert_close(v[-1], want, rtol=1e-9, atol=1e-9)  # rounding of some hundred substeps


def test_what_is_one_piece_with_held_matter_hangs_on_it():
    """Let go at once it swings about its rest, where the mean displacement of a column of height H that hangs is
    ∫ u dz/H = ρ g H²/3E: between none and twice that."""
    x, _ = hanging(attached=True, seconds=0.4)
    down = -(x - x[0]).mean(1)[:, 2]
    rest = 1000.0 * 9.81 * (2 * DX) ** 2 / (3 * 1e4)
    # nodes are set up to half a cell into the free part or the held one: (2 ± ½)² cells² instead of 2²; and the rest
    # of the sideways swing
    assert 2 * rest * 0.75**2 < float(down.max()) < 2 * rest * 1.25**2
    assert float(down.min()) > -0.1 * rest
    assert float(down[int(down.argmax()) :].min()) < rest, "it swings back"


def test_held_matter_takes_the_weight_and_nothing_else_changes_momentum():
    """Σ over the free particles of m Δv = M g T + impulse in every frame, to rounding; in the mean that impulse is the
    weight times the time."""
    x, vol, slab, _ = over((5, 5, 3), (3, 3, 2))
    drives = (Held(where=tuple(range(slab)), attached=False),)
    scene = Scene(dx=DX, fps=50.0, boundaries=(), lift=None, drives=drives)
    f, reports = field(len(x), E=1e5), []
    out = rollout(scene, x, vol, f, frames=50, report=reports, gather=("impulse",))
    m = (f.rho * vol)[slab:, None]
    weight = m.sum() * x.new_tensor([0.0, 0.0, -9.81]) / 50
    P = (m * out.v[:, slab:]).sum(1)
    given = torch.stack([r.impulse for r in reports])
    # some thirty substeps of sums over 27 nodes, of terms that add up to the weight
    torch.testing.assert_close(P[1:] - P[:-1], given + weight, rtol=0, atol=1e-10 * float(weight.norm()))
    # what is left of the swing: its momentum, M g/ω · e^(−ζωt) at most, over half a second
    torch.testing.assert_close(given[25:].mean(0), -weight, rtol=0, atol=0.05 * float(weight.norm()))


def test_held_matter_that_rises_lifts_what_lies_on_it():
    """A body on a slab that moves with V is carried along, x = x₀ + V t."""
    x, vol, slab, _ = over((5, 5, 3), (3, 3, 2))
    V = (0.2, 0.0, 0.5)
    at = on_held(x, vol, slab, seconds=1.0, E=1e5, velocity=V).mean(1)
    # it does not slide; taken along at once it hops by V²/2g = 0.01 m and has come down, and ρ g H/E is 1 %
    torch.testing.assert_close(at[-1] - at[0], at.new_tensor(V), rtol=0, atol=0.1 * DX)


def test_what_is_released_is_no_obstacle_any_more():
    """A block lies on what is not yet released, and falls with it, v → g t, once it is."""
    x, vol, slab, _ = over((3, 3, 2), (3, 3, 2))
    gate = Release(where=tuple(range(slab)), point=(0.0, 0.0, -1.0), normal=(0.0, 0.0, 1.0), speed=10.0)
    scene = Scene(dx=DX, fps=50.0, boundaries=(), lift=None, drives=(gate,))
    out = rollout(scene, x, vol, field(len(x), E=1e5), frames=20)
    assert float(out.v[4, slab:, 2].mean().abs()) < 0.1 * 9.81 * 0.08, "at 0.08 s; the plane arrives at 0.1 s"
    gained = (out.v[20] - out.v[8]).mean(0)  # free since 0.11 s
    torch.testing.assert_close(gained, gained.new_tensor([0.0, 0.0, -9.81 * 12 / 50]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("attached", [False, True])
def test_gradients_beside_held_matter_are_those_of_central_differences(attached):
    """A body of uneven material is thrown on a slab that turns, or grows out of it: no gradient goes through nodes that
    stop, and held particles have that of the motion they are given; float64."""
    x, vol, slab, _ = over((3, 3, 1), (2, 2, 2))
    g = torch.Generator().manual_seed(3)
    x = x + 0.005 * torch.rand(x.shape, generator=g, dtype=x.dtype)
    f = field(len(x), E=2e4)
    uneven = lambda t: t * (1 + 0.2 * torch.rand(t.shape, generator=g, dtype=t.dtype))  # noqa: E731
    velocity = 0.2 * torch.randn(x.shape, generator=g, dtype=x.dtype) - x.new_tensor([0.0, 0.0, 1.0])
    inputs = {"x": x, "velocity": velocity, "rho": uneven(f.rho), "E": uneven(f.theta["E"])}
    held = Held(where=tuple(range(slab)), center=(0.05, 0.05, 0.0), angular_velocity=(0.5, 0.0, 2.0), attached=attached)
    scene = Scene(dx=DX, fps=120.0, frames=2, boundaries=(), lift=None, drives=(held,))
    check_by_differences(inputs, vol, f, scene=scene)


def test_a_scene_without_held_matter_has_no_room_for_it(monkeypatch):
    """Rows of held matter are asked for where a drive holds, and nowhere else."""
    asked: list[str] = []
    nodal = Arguments.nodal

    def watched(self, name, *args, **options):
        asked.append(name)
        return nodal(self, name, *args, **options)

    monkeypatch.setattr(Arguments, "nodal", watched)
    x, vol, slab, top = over((3, 3, 1), (2, 2, 2))
    on_wall(x, vol, slab, top, seconds=0.02, E=1e4)
    assert "grid" in asked and not {"pins", "pin"} & set(asked)
    on_held(x, vol, slab, seconds=0.02, E=1e4)
    assert {"pins", "pin"} <= set(asked)


def test_held_matter_on_a_mirror_is_the_same_for_every_number_of_threads():
    """A slab that stands on a slip wall, whose nodes have images, and a body on it: each thread's rows are summed and
    folded; what lies on it stands as on a rough wall in its place."""
    x, vol, slab, top = over((5, 5, 2), (3, 3, 2))
    scene = Scene(
        dx=DX,
        fps=50.0,
        boundaries=(HalfSpace(kind="slip"),),
        lift=None,
        drives=(Held(where=tuple(range(slab)), attached=False),),
    )
    one, three = (
        rollout(scene, x, vol, field(len(x), E=1e4), frames=10, threads=n).x for n in (1, 3)
    )  # rounding of sums in another order, over some fifty substeps
    torch.testing.assert_close(one, three, rtol=0, atol=1e-11)
    want = on_wall(x, vol, slab, top, seconds=0.2, E=1e4)
    torch.testing.assert_close(one[:, slab:], want, rtol=0, atol=1e-3 * DX)
