"""The change of an affine field that moves with the matter, and that it adds no energy."""

import dataclasses

import pytest
import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import Grid, Scene, Scheme, Solver, Span
from diffuphy.mpm.diagnostics import diagnose
from diffuphy.mpm.state import REAL, initial_state, make_matter, view
from diffuphy.mpm.substep.rows import make_rows
from diffuphy.mpm.substep.variant import Variant
from tests.mpm.bodies import block, field

DX = 0.05


def turned(B: torch.Tensor, L: torch.Tensor, bar: torch.Tensor) -> list[torch.Tensor]:
    """S' of each pair, and the adjoint of ``bar`` in B and in L."""
    mixture = make_mixture(("neo_hookean",), ("identity",), wp.float64)
    rows = make_rows(Variant(mixture, wp.float64, Scheme(), (), False, (), False, False, True))
    forward, backward, mat33 = rows.turned, rows.turned_adjoint, wp.types.matrix((3, 3), wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(
        B: wp.array[mat33], L: wp.array[mat33], bar: wp.array[mat33],
        S: wp.array[mat33], B_bar: wp.array[mat33], L_bar: wp.array[mat33],
    ):  # fmt: skip
        p = wp.tid()
        S[p] = forward(B[p], L[p])
        a, b = backward(B[p], L[p], bar[p])
        B_bar[p] = a
        L_bar[p] = b

    out = [torch.empty_like(B) for _ in range(3)]
    arrays = [view(t.contiguous(), mat33, "cpu") for t in (B, L, bar, *out)]
    wp.launch(evaluate, dim=len(B), inputs=arrays, device="cpu")
    return out


def some(count: int = 200) -> list[torch.Tensor]:
    g = torch.Generator().manual_seed(4)
    return [torch.randn(count, 3, 3, dtype=torch.float64, generator=g) for _ in range(3)]


def sym(A: torch.Tensor) -> torch.Tensor:
    return 0.5 * (A + A.transpose(1, 2))


def dot(A: torch.Tensor, B: torch.Tensor) -> torch.Tensor:
    return (A * B).sum((1, 2))


def test_turning_is_the_change_of_the_field_less_what_would_add_energy():
    """S' = sym(B L) where E : sym(B L) ≥ 0, else its part across E; symmetric, so that spin stays; B : S' ≥ 0."""
    B, L, bar = some()
    B[:3] = torch.tensor([[[0.0, -1, 2], [1, 0, -3], [-2, 3, 0]], [[1.0, 0, 0], [0, 2, 0], [0, 0, 3]],
                          [[-1.0, 0, 0], [0, -1, 0], [0, 0, -1]]], dtype=torch.float64)  # fmt: skip
    L[:3] = B[:3]  # rotation, expansion, contraction
    S, E = turned(B, L, bar)[0], sym(B)
    plain = sym(B @ L)
    adds = dot(E, plain) < 0
    assert 50 < int(adds.sum()) < 150
    torch.testing.assert_close(S[~adds], plain[~adds], rtol=0, atol=1e-14)
    across = plain - (dot(E, plain) / dot(E, E))[:, None, None] * E
    torch.testing.assert_close(S[adds], across[adds], rtol=1e-12, atol=1e-13)
    assert torch.equal(S, S.transpose(1, 2)) and float(dot(B, S).min()) > -1e-13
    torch.testing.assert_close(S[0], B[0] @ B[0], rtol=0, atol=1e-15)  # a rotation goes on turning
    assert not bool(S[2].abs().max() > 1e-15)  # a contraction alone goes on as it is


def test_adjoint_of_turning_is_exact():
    """Against autograd of the formula, on both sides of the kink."""
    B, L, bar = some()
    leaves = [t.clone().requires_grad_() for t in (B, L)]
    E, plain = sym(leaves[0]), sym(leaves[0] @ leaves[1])
    S = plain - (dot(E, plain).clamp_max(0) / dot(E, E))[:, None, None] * E
    expected = torch.autograd.grad((S * bar).sum(), leaves)
    for found, exact in zip(turned(B, L, bar)[1:], expected, strict=True):
        torch.testing.assert_close(found, exact, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("law", [("hencky", "fluid"), ("neo_hookean", "identity")])
def test_a_drop_that_contracts_alone_gains_no_energy(law):
    """m D |C|²/2 + V ψ of one particle that is thrown into itself and rebounds at CFL 0.1: never more than at first,
    but for the swing (ωΔt)²/4 = (0.1/0.58)²/4 < 1 % of the leapfrog."""
    x, vol = block((1, 1, 1), DX, (0.013, 0.021, 0.337))
    x, vol = x[:1], vol[:1]
    f = field(1, (law[0],), (law[1],))
    mixture = make_mixture((law[0],), (law[1],), REAL[torch.float64])
    matter = make_matter(f, vol, mixture.params, torch.float64, False)
    scene = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, boundaries=(), lift=None)
    c = (1e5 * 0.7 / (1.3 * 0.4) / 1000.0) ** 0.5
    state = initial_state(scene, x, matter, mixture)
    state = dataclasses.replace(state, C=state.C - 1.5 * c / DX * torch.eye(3, dtype=x.dtype))
    solver = Solver(
        mixture, (), scene.gravity, torch.float64, "cpu", particles=1, dx=DX, scheme=scene.scheme, grad=False
    )
    low, high = ((x.amin(0) - 4 * DX).tolist(), (x.amax(0) + 4 * DX).tolist())
    first = diagnose(mixture, state, matter, DX, scene.scheme)
    energies, smallest = [], 1.0
    for k in range(40):
        span = Span(Grid.around(low, high, DX), k * 0.5 * DX / c, 0.1 * DX / c, 5, c, 1.0, True)
        state, status, _ = solver.advance(state, matter, span)
        assert not any(status)
        d = diagnose(mixture, state, matter, DX, scene.scheme)
        energies.append((d.kinetic + d.elastic) / (first.kinetic + first.elastic))
        smallest = min(smallest, d.J[0])
    assert smallest < 0.5  # it was squeezed
    assert max(energies) < 1.01
