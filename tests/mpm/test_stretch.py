"""Total deformation of matter that flows."""

import dataclasses

import pytest
import torch

from diffuphy.mpm import Scene, Scheme, simulate
from diffuphy.mpm.state import State
from diffuphy.mpm.stretch import LONGEST, bounded
from tests.mpm.bodies import field


def state(H: torch.Tensor) -> State:
    zero = torch.zeros(len(H), 3, dtype=H.dtype)
    return State(zero, zero, torch.zeros_like(H), torch.zeros_like(H), H)


def test_a_drop_that_slides_for_long_keeps_a_finite_deformation():
    """Drops of one particle slide over a rough floor, which shears them more in every frame, none resists, and |F|
    grows by a factor of 2 to 6 in each: left alone it is past LONGEST in 16 frames, and no number in 80."""
    n, dx = 12, 0.04
    x = torch.zeros(n, 3)
    x[:, 0] = torch.arange(n) * 10 * dx
    x[:, 1] = torch.linspace(0.0, 0.9, n) * dx
    vol = torch.full((n,), (dx / 2) ** 3)
    scene = Scene(dx=dx, lift=0.2 * dx, velocity=(0.0, 5.0, 0.0), scheme=Scheme(contact="elastic"))
    f = field(n, plastic=("fluid",), E=1e5, nu=0.4, dtype=torch.float32)
    norms = torch.stack([torch.linalg.matrix_norm(s.F.double()) for s in simulate(scene, x, vol, f, frames=40)])
    assert float(norms.max()) > 0.1 * LONGEST  # it is this case
    assert bool((norms <= LONGEST * (1 + 1e-6)).all())


def test_size_is_bounded_and_direction_kept():
    """F ← F min(1, LONGEST/|F|), also where |F|² leaves float32; shorter ones keep their bits."""
    F = torch.eye(3) + torch.randn(4, 3, 3, generator=torch.Generator().manual_seed(0))
    F = F * torch.tensor([1.0, 0.1 * LONGEST, 10 * LONGEST, 1e30])[:, None, None]
    H = F - torch.eye(3)
    out = bounded(state(H))
    assert torch.equal(out.H[:2], H[:2])
    norm = torch.linalg.matrix_norm(out.F.double())
    torch.testing.assert_close(norm[2:], torch.full((2,), LONGEST, dtype=torch.float64), rtol=1e-6, atol=0)
    expected = LONGEST * F.double() / torch.linalg.matrix_norm(F.double(), keepdim=True)
    torch.testing.assert_close(out.F.double()[2:], expected[2:], rtol=1e-6, atol=1.0)
    same = state(H[:2])
    assert bounded(same) is same
    solid = dataclasses.replace(same, H=None)
    assert bounded(solid) is solid


def test_the_bound_is_differentiated():
    """d(LONGEST F/|F|) against central differences in float64; truncation and rounding are both below 1e-8 of it."""
    F = 1e8 * torch.randn(2, 3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def size(G: torch.Tensor) -> torch.Tensor:
        out = bounded(state(G - torch.eye(3).double())).H
        assert out is not None
        return (out * torch.linspace(-1, 1, 18, dtype=torch.float64).reshape(2, 3, 3)).sum()

    G = F.clone().requires_grad_()
    (grad,) = torch.autograd.grad(size(G), G)
    d = torch.randn(2, 3, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    h = 1e3
    slope = (size(F + h * d) - size(F - h * d)) / (2 * h)
    assert float((grad * d).sum()) == pytest.approx(float(slope), rel=1e-6)
