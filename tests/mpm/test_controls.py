"""Gradients in the numbers of a scene."""

import torch

from diffuphy.mpm import Controls, HalfSpace, Scene, rollout
from tests.mpm.bodies import block, field

DX = 0.05


def test_a_wall_that_has_stopped_gives_no_gradient_in_its_velocity():
    """A floor that moves in the first round only and stands from then on, still acting: ∂L/∂V by central differences.
    In its 1e-9 s it gets nowhere, so that the nodes it governs are the same."""
    x, vol = block((2, 2, 2), DX)
    wall = HalfSpace(friction=0.3, velocity=(0.2, 0.1, 0.3), end=1e-9, reset=1.0)
    scene = Scene(dx=DX, fps=100.0, frames=2, lift=None, velocity=(1.0, 0.0, -1.0), boundaries=(wall,))
    weight = torch.randn(len(x), 3, generator=torch.Generator().manual_seed(0), dtype=x.dtype)

    def loss(V: torch.Tensor, grad: bool = False) -> torch.Tensor:
        controls = Controls(velocity=V)
        return (rollout(scene, x, vol, field(len(x)), grad=grad, controls=controls, dt=1e-3).v[-1] * weight).sum()

    V = torch.tensor([wall.velocity], dtype=x.dtype, requires_grad=True)
    (exact,) = torch.autograd.grad(loss(V, True), V)
    h = 1e-4
    with torch.no_grad():
        for k, d in enumerate(h * torch.eye(3, dtype=x.dtype)):
            numeric = float(loss(V + d) - loss(V - d)) / (2 * h)
            # truncation h² of a loss of order 1, rounding 1e-15/h
            assert abs(numeric - float(exact[0, k])) < 1e-7 * max(1.0, float(exact.abs().max()))
    assert float(exact.abs().max()) > 1e-3
