"""Gates and bounded parameters."""

from dataclasses import replace

import pytest
import torch

from diffuphy.material.decoder import Decoder, bounded, gate, inside, sparsemax
from diffuphy.material.expert import Param
from diffuphy.types import MaterialField

E = Param("E", "Pa", 1e3, 1e7, True, 1e5)
NU = Param("nu", "-", 0.0, 0.49, False, 0.3)


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def field(n=6, dtype=torch.float64):
    w_e = torch.eye(2, dtype=dtype)[torch.arange(n) % 2]
    w_p = torch.full((n, 3), 1 / 3, dtype=dtype)
    theta = {"E": torch.logspace(3.5, 6.5, n, dtype=dtype), "nu": torch.linspace(0.1, 0.4, n, dtype=dtype)}
    return MaterialField(("a", "b"), ("i", "v", "f"), w_e, w_p, theta, torch.linspace(500, 2000, n, dtype=dtype))


@pytest.mark.parametrize("kind", ["softmax", "sparsemax"])
def test_gate_is_on_the_simplex_and_shift_invariant(kind):
    """Σ w = 1, w ≥ 0, gate(z + c) = gate(z)."""
    z = 3 * normal(50, 4)
    w = gate(z, kind)
    assert (w >= 0).all()
    torch.testing.assert_close(w.sum(1), torch.ones(50, dtype=z.dtype), rtol=0, atol=1e-14)
    torch.testing.assert_close(gate(z + 7.0, kind), w, rtol=0, atol=1e-13)


def test_sparsemax_is_the_projection_on_the_simplex():
    """Variational inequality of the projection: (z − w)·(e_k − w) ≤ 0 for every corner e_k."""
    z = normal(200, 5)
    w = sparsemax(z)
    slack = ((z - w)[:, None] * (torch.eye(5, dtype=z.dtype) - w[:, None])).sum(-1)
    assert slack.max() < 1e-13
    assert (w == 0).any() and (w == 0).sum() > 100  # exact zeros are what it is for


def test_sparsemax_in_two_dimensions_is_a_clipped_ramp():
    """w_1 = clip((z_1 − z_2 + 1)/2, 0, 1)."""
    t = torch.linspace(-3, 3, 61, dtype=torch.float64)
    w = sparsemax(torch.stack([t, torch.zeros_like(t)], 1))[:, 0]
    torch.testing.assert_close(w, ((t + 1) / 2).clamp(0, 1), rtol=0, atol=1e-15)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_sparsemax_in_half_precision_is_that_of_the_same_logits(dtype):
    """w and J of the rounded logits, rounded once: ½ ulp of 1; also where the sums of half precision lose the support,
    as of equal and of large logits."""
    ulp = torch.finfo(dtype).eps
    z = torch.cat([3 * normal(50, 7), torch.zeros(1, 7), 500 + normal(20, 7)]).to(dtype).requires_grad_()
    exact = z.detach().double().requires_grad_()
    w, w_exact = sparsemax(z), sparsemax(exact)
    assert w.dtype == dtype
    assert float((w.double() - w_exact).detach().abs().max()) <= ulp / 2
    bar = normal(*z.shape, seed=4).to(dtype)
    (z_bar,), (z_exact,) = torch.autograd.grad(w, z, bar), torch.autograd.grad(w_exact, exact, bar.double())
    assert z_bar.dtype == dtype
    assert float((z_bar.double() - z_exact).abs().max()) <= ulp * float(z_exact.abs().max())


def test_sparsemax_has_its_exact_gradient():
    """J = diag(s) − s sᵀ/|s| against central differences, away from the kinks."""
    z = normal(20, 4, seed=3).requires_grad_()
    w = sparsemax(z)
    assert 0 < (w == 0).sum() < w.numel() - 20
    assert torch.autograd.gradcheck(sparsemax, (z,), eps=1e-6, atol=1e-9)
    s = (w > 0).double()
    jacobian = torch.autograd.functional.jacobian(sparsemax, z.detach()[0])
    torch.testing.assert_close(jacobian, torch.diag(s[0]) - s[0][:, None] * s[0] / s[0].sum(), rtol=0, atol=1e-15)


def test_sparsemax_of_a_lead_of_one_is_one_hot_without_gradient():
    z = torch.tensor([[1.0, 0.0, 0.0]], requires_grad=True)
    w = sparsemax(z)
    assert torch.equal(w, torch.tensor([[1.0, 0.0, 0.0]]))
    w[0, 0].backward()
    assert not z.grad.any()


@pytest.mark.parametrize("param", [E, NU])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_bounded_starts_at_its_start_bit_by_bit(param, dtype):
    start = field(dtype=dtype).theta[param.name]
    assert torch.equal(bounded(param, start, torch.zeros_like(start), 2.0), start)


@pytest.mark.parametrize("param", [E, NU])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_bounded_never_leaves_its_bounds_and_can_reach_them(param, dtype):
    """Outputs of ±1e4 saturate the sigmoid: the bound itself, to rounding of the (log-)range of 9.2."""
    start = field(dtype=dtype).theta[param.name]
    for o, end in ((-1e4, param.lo), (1e4, param.hi)):
        value = bounded(param, start, torch.full_like(start, o), 2.0)
        lo, hi = torch.tensor([param.lo, param.hi], dtype=dtype)
        assert (value >= lo).all() and (value <= hi).all()
        tolerance = 20 * torch.finfo(dtype).eps
        torch.testing.assert_close(value, torch.full_like(value, end), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("param", [E, NU])
def test_bounded_survives_a_start_at_its_bounds(param):
    """A saturated value may be moved again: finite, still exact at o = 0, with a gradient that leads inwards."""
    start = torch.tensor([param.lo, param.hi], requires_grad=True)
    o = torch.zeros(2, requires_grad=True)
    value = bounded(param, start, o, 2.0)
    assert torch.equal(value, start)
    value.sum().backward()
    assert o.grad.isfinite().all() and (o.grad > 0).all() and start.grad.isfinite().all()
    assert (
        bounded(param, start, torch.tensor([20.0, -20.0]), 2.0).log10().diff().abs() > 0
    )  # and far outputs do move it


@pytest.mark.parametrize("param", [E, NU])
def test_bounded_is_a_sigmoid_in_its_range(param):
    """logit u(o) = logit u_0 + g o."""
    start, o = field().theta[param.name], normal(6)
    c = torch.log if param.log else torch.Tensor.clone
    lo, hi = c(torch.tensor(param.lo, dtype=o.dtype)), c(torch.tensor(param.hi, dtype=o.dtype))
    u = (c(bounded(param, start, o, 2.0)) - lo) / (hi - lo)
    # rounding 1e-16 × range 9.2 / slope u(1−u) ≥ 1e-3
    torch.testing.assert_close(torch.logit(u) - torch.logit((c(start) - lo) / (hi - lo)), 2.0 * o, rtol=0, atol=1e-11)


def test_inside_moves_only_what_is_at_an_end():
    theta = {"E": torch.tensor([1e3, 1e5, 1e7]), "nu": torch.tensor([0.0, 0.3, 0.49]), "yield_stress": torch.zeros(3)}
    moved = inside((E, NU), theta)
    # 1 % of 4 decades and of 0.49
    torch.testing.assert_close(moved["E"], torch.tensor([10**3.04, 1e5, 10**6.96]), rtol=1e-6, atol=0)
    torch.testing.assert_close(moved["nu"], torch.tensor([0.0049, 0.3, 0.4851]))
    assert moved["yield_stress"] is theta["yield_stress"]
    start = field(3)
    Decoder(2, 4, start.elastic, start.plastic, (E, NU)).check(
        MaterialField(start.elastic, start.plastic, start.w_e, start.w_p, moved, start.rho)
    )


def test_decoder_has_no_output_for_what_is_not_learnt():
    """One elastic expert has no gate; nu is not learnt: both pass through, as rho does."""
    start = field()
    start = replace(start, elastic=("a",), w_e=torch.ones(6, 1, dtype=torch.float64))
    decoder = Decoder(4, 8, start.elastic, start.plastic, (E,)).double()
    assert decoder.head[-1].out_features == 3 + 1
    out = decoder(normal(6, 4), start)
    assert out.w_e is start.w_e and out.theta["nu"] is start.theta["nu"] and out.rho is start.rho
    assert not torch.equal(out.theta["E"], start.theta["E"])


def test_decoder_bias_is_a_head_start_of_e_to_the_b():
    """softmax(b e_k): w_k = e^b / (e^b + K − 1); a uniform start stays uniform."""
    start = field()
    decoder = Decoder(4, 8, start.elastic, start.plastic, (), bias=4.0).double()
    with torch.no_grad():
        decoder.head[-1].weight.zero_()
        decoder.head[-1].bias.zero_()
    out = decoder(normal(6, 4), start)
    want = torch.tensor(4.0, dtype=torch.float64).exp() / (torch.tensor(4.0, dtype=torch.float64).exp() + 1)
    torch.testing.assert_close(out.w_e.max(1).values, want.expand(6), rtol=1e-14, atol=0)
    torch.testing.assert_close(out.w_p, start.w_p, rtol=1e-14, atol=0)


def test_decoder_refuses_what_it_cannot_start_from():
    start = field()
    with pytest.raises(ValueError, match="nothing to learn"):
        Decoder(4, 8, ("a",), ("i",), ())
    with pytest.raises(ValueError, match="same candidates"):
        Decoder(4, 8, ("b", "a"), start.plastic, (E,)).check(start)
    with pytest.raises(ValueError, match="'viscosity' is to be learnt"):
        Decoder(4, 8, start.elastic, start.plastic, (Param("viscosity", "Pa s", 1e-3, 1e3, True, 1.0),)).check(start)
    start.theta["E"][2] = 1e7
    with pytest.raises(ValueError, match=r"E starts at .* to 1e\+07"):
        Decoder(4, 8, start.elastic, start.plastic, (E,)).check(start)
