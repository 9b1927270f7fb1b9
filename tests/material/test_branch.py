"""The viscous branch: relaxation in closed form, its adjoint, and what it adds to the waves."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.material import linalg, make_mixture, wave_speed
from diffuphy.material.moduli import lame
from tests.material.evaluate import generic, rotations, special, stretched

RNG = np.random.default_rng(0)
PARAMS = {"E": 2e5, "nu": 0.3, "E_N": 1e5, "relaxation_time": 0.02, "bulk_relaxation": 0.4}
MU, LAM = (float(x) for x in lame({"E": PARAMS["E_N"], "nu": PARAMS["nu"]}))
DT = 1e-3


@cache
def beside_neo_hookean() -> tuple[Any, Any]:
    """The mixture and a kernel of all that its branch does."""
    m = make_mixture(("neo_hookean",), (), wp.float64, ("maxwell",))
    mat33, theta_t, w_t, real = m.mat33, m.theta_t, m.w_e_t, m.real
    eye = linalg.build(real).eye

    @wp.kernel(module="unique", enable_backward=False)
    def run(
        F: wp.array(dtype=mat33), theta: wp.array(dtype=theta_t), tau_bar: wp.array(dtype=mat33),
        Fe_bar: wp.array(dtype=mat33), dt: real,
        tau: wp.array(dtype=mat33), Fe: wp.array(dtype=mat33), psi: wp.array(dtype=real),
        F_bar: wp.array(dtype=mat33), theta_bar: wp.array(dtype=theta_t), wave: wp.array(dtype=real),
    ):  # fmt: skip
        p = wp.tid()
        H = F[p] - eye()
        tau_p, flow_p = m.branch_stress(F[p], H, theta[p], dt)
        tau[p] = tau_p
        Fe[p] = F[p] + flow_p
        psi[p] = m.branch_energy(F[p] + flow_p, H + flow_p, theta[p])
        a, b = m.branch_stress_adjoint(F[p], H, theta[p], dt, tau_bar[p], Fe_bar[p])
        F_bar[p] = a
        theta_bar[p] = b
        wave[p] = m.wave(F[p], H, w_t(), theta[p])

    return m, run


def branch(
    F: np.ndarray,
    theta: np.ndarray | None = None,
    tau_bar: Any = None,
    Fe_bar: Any = None,
    dt: float = DT,
    **params: float,
) -> dict[str, np.ndarray]:
    """Stress, relaxed deformation, energy and gradients of the branch beside a neo-Hookean solid, in float64."""
    m, run = beside_neo_hookean()
    if theta is None:
        theta = np.tile([(PARAMS | params)[p] for p in m.params], (len(F), 1))

    def array(x: Any, kind: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(np.zeros_like(F) if x is None else x), dtype=kind, device="cpu")

    inputs = [array(F, m.mat33), array(theta, m.theta_t), array(tau_bar, m.mat33), array(Fe_bar, m.mat33), dt]
    out = [wp.zeros(len(F), dtype=t, device="cpu") for t in (m.mat33, m.mat33, m.real, m.mat33, m.theta_t, m.real)]
    wp.launch(run, dim=len(F), inputs=inputs, outputs=out, device="cpu")
    return dict(zip(("tau", "Fe", "psi", "F_bar", "theta_bar", "wave"), (o.numpy() for o in out), strict=True))


def test_strain_relaxes_with_its_time_constants():
    """dev e' = dev e/(1 + Δt/t_N), tr e' = tr e/(1 + β Δt/t_N), τ_N = 2μ_N e' + λ_N tr e' in the frame of F_N."""
    e = RNG.uniform(-0.3, 0.3, (50, 3))
    U, V = rotations(50, RNG), rotations(50, RNG)
    out = branch((U * np.exp(e)[:, None]) @ V)
    tr = e.sum(1, keepdims=True)
    after = (e - tr / 3) / (1 + DT / 0.02) + tr / 3 / (1 + 0.4 * DT / 0.02)
    T = 2 * MU * after + LAM * after.sum(1, keepdims=True)
    # tens of rounded operations
    assert np.abs(out["Fe"] - (U * np.exp(after)[:, None]) @ V).max() < 1e-13
    assert np.abs(out["tau"] - (U * T[:, None]) @ U.swapaxes(1, 2)).max() < 1e-12 * PARAMS["E_N"]
    assert np.abs(out["psi"] - (MU * (after**2).sum(1) + LAM / 2 * after.sum(1) ** 2)).max() < 1e-12 * PARAMS["E_N"]


def test_held_strain_decays_to_the_exponential_as_the_step_shrinks():
    """dev e(t) = dev e_0 e^(−t/t_N) for a branch that is held: implicit Euler, error t Δt/(2 t_N²) to first order."""
    for n in (100, 200):
        F = stretched(np.exp([[0.1, -0.1, 0.0]]), RNG)
        for _ in range(n):
            F = branch(F, dt=0.02 / n)["Fe"]
        left = np.log(np.linalg.svd(F[0], compute_uv=False)[0]) / 0.1
        assert abs(left / math.exp(-1) - 1 - 1 / (2 * n)) < 1 / n**2


def test_a_bar_that_relaxes_alike_keeps_its_shape():
    """β = 1: all of the strain fades alike, so uniaxial stress stays uniaxial, σ = E_N ε/(1 + Δt/t_N)."""
    e = np.array([[0.1, -0.03, -0.03]])
    tau = branch(np.diag(np.exp(e[0]))[None], bulk_relaxation=1.0)["tau"][0]
    expected = np.zeros((3, 3))
    expected[0, 0] = PARAMS["E_N"] * 0.1 / (1 + DT / 0.02)
    assert np.abs(tau - expected).max() < 1e-11 * PARAMS["E_N"]


@pytest.mark.parametrize("state", ["generic", *special(RNG)])
def test_adjoint_of_the_branch_is_its_derivative(state: str):
    """⟨F̄, dF⟩ + ⟨θ̄, dθ⟩ against fourth-order differences: step 2e-5 leaves rounding 5e-12 of values of order 1."""
    F = generic(16, RNG) if state == "generic" else special(RNG)[state]
    n, h = len(F), 2e-5
    theta = np.tile([PARAMS[p] for p in make_mixture(("neo_hookean",), (), wp.float64, ("maxwell",)).params], (n, 1))
    dF, dtheta = RNG.normal(size=F.shape), 0.1 * RNG.normal(size=theta.shape) * theta
    bars = RNG.normal(size=F.shape) / PARAMS["E_N"], RNG.normal(size=F.shape)

    def value(t: float) -> np.ndarray:
        out = branch(F + t * h * dF, theta + t * h * dtheta)
        return (out["tau"] * bars[0] + out["Fe"] * bars[1]).sum((1, 2))

    numeric = (8 * (value(1) - value(-1)) - (value(2) - value(-2))) / (12 * h)
    out = branch(F, theta, *bars)
    closed = (out["F_bar"] * dF).sum((1, 2)) + (out["theta_bar"] * dtheta).sum(1)
    assert np.abs(numeric - closed).max() < 2e-9 * max(1.0, np.abs(closed).max())


def test_waves_see_the_branch_before_it_relaxes():
    """ρ c² = (λ + 2μ) + (λ_N + 2μ_N) at rest, in Warp and in torch."""
    M = [mu * 2 + lam for mu, lam in (lame({"E": PARAMS[e], "nu": 0.3}) for e in ("E", "E_N"))]
    assert abs(branch(np.eye(3)[None])["wave"][0] / sum(M) - 1) < 1e-14
    theta = {k: torch.tensor([v], dtype=torch.float64) for k, v in PARAMS.items()}
    rho = torch.tensor([800.0], dtype=torch.float64)
    c = wave_speed(("neo_hookean",), torch.ones(1, 1, dtype=torch.float64), theta, rho, ("maxwell",))
    assert abs(float(c[0]) ** 2 * 800.0 / sum(M) - 1) < 1e-14


def test_a_mixture_without_branches_has_none():
    assert make_mixture(("neo_hookean",), (), wp.float64).branch_stress is None
    with pytest.raises(ValueError, match="unknown branch law 'kelvin'; known: maxwell"):
        make_mixture(("neo_hookean",), (), wp.float64, ("kelvin",))


def test_branches_of_a_field_are_stored_and_kept(tmp_path):
    """Saved and loaded, taken, hardened and pruned: a field keeps its branches; a field written before has none."""
    import json

    from diffuphy.material.field import harden, prune, take
    from diffuphy.types import MaterialField

    weights, theta = torch.tensor([[1.0, 0.0]] * 3), {k: torch.full((3,), v) for k, v in PARAMS.items()}
    names = ("hencky", "neo_hookean"), ("identity", "fluid")
    field = MaterialField(*names, weights, weights.clone(), theta, torch.ones(3), ("maxwell",))
    field.save(tmp_path)
    assert MaterialField.load(tmp_path).branches == ("maxwell",)
    for other in (take(field, torch.tensor([0])), harden(field), prune(field).field):
        assert other.branches == ("maxwell",)
    file = tmp_path / "result.json"
    old = json.loads(file.read_text())
    del old["branches"]
    file.write_text(json.dumps(old))
    assert MaterialField.load(tmp_path).branches == ()


def test_the_network_keeps_the_branches_of_its_start():
    from diffuphy.material.decoder import Decoder
    from diffuphy.material.moduli import E
    from diffuphy.types import MaterialField

    one = torch.ones(3, 1)
    field = MaterialField(
        ("hencky",), ("identity",), one, one, {"E": torch.full((3,), 1e5)}, torch.ones(3), ("maxwell",)
    )
    out = Decoder(2, 4, field.elastic, field.plastic, (E,))(torch.zeros(3, 2), field)
    assert out.branches == ("maxwell",) and out.elastic == ("hencky",)
