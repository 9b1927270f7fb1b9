"""Strains far below the rounding of F, in float32: every law to the digits of H = F − I, against linear elasticity.

Of strains of 1e-7 F = I + H keeps one bit, of 1e-9 none. A law is linear there up to its second order, a few times the
strain itself (a trace of three strains, squared, by a stiffness in volume of 1.5 that in shear), and rounding adds some
tens of ulp of H: TOLERANCE.
"""

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.material import ELASTIC, PLASTIC, energy, kirchhoff, reference, remember, return_map
from diffuphy.material.moduli import lame
from tests.material.evaluate import DEFAULTS, evaluate
from tests.material.test_mixture import MIXTURES

STRAIN = 1e-7
TOLERANCE = 40 * 2.0**-23 + 20 * STRAIN
MU, LAM = (float(x) for x in lame(DEFAULTS))
EYE = np.eye(3)
N = 200
WEAK = {"yield_stress": 1e-2, "preconsolidation": 5e-3, "consistency": 1e-3, "cohesion": 1e-8, "viscosity": 1.0}
"""Strengths at which matter flows at these strains."""


def states() -> np.ndarray:
    """H (N, 3, 3) in float32: any, volumetric and nearly so, with two equal stretches, mere shear, and any of 1e-9."""
    rng = np.random.default_rng(0)
    H = rng.normal(size=(N, 3, 3))
    H[50:80] = rng.normal(size=(30, 1, 1)) * EYE
    H[80:110] = EYE + 1e-2 * H[80:110]
    H[110:140] = np.diag([1.0, 1.0, -0.5]) * rng.normal(size=(30, 1, 1))
    H[140:170] *= 1 - EYE
    H[170:] *= 1e-2
    return (STRAIN * H).astype(np.float32).astype(np.float64)


H = states()
EPS = (H + H.swapaxes(1, 2)) / 2
TRACE = np.trace(EPS, axis1=1, axis2=2)[:, None, None]
TAU_BAR = np.random.default_rng(1).normal(size=H.shape)


def hooke(name: str, trace: np.ndarray = TRACE, eps: np.ndarray = EPS) -> np.ndarray:
    """τ = 2μ ε + λ tr ε I, of a liquid K tr ε I."""
    return DEFAULTS["bulk_modulus"] * trace * EYE if name == "fluid_eos" else 2 * MU * eps + LAM * trace * EYE


def stored(name: str) -> np.ndarray:
    """ψ = ½ τ : ε."""
    return 0.5 * (hooke(name) * EPS).sum((1, 2))


def one_hot(names: tuple[str, ...], name: str) -> np.ndarray:
    return np.tile([float(n == name) for n in names], (N, 1))


def near(got: np.ndarray, exact: np.ndarray, scale: np.ndarray) -> bool:
    """Whether rows agree to TOLERANCE of a scale of their own."""
    error = np.abs(got - exact).reshape(N, -1).max(1)
    return bool((error <= TOLERANCE * np.abs(scale).reshape(N, -1).max(1)).all())


def at_rest(mixture: str, **kw) -> dict[str, np.ndarray]:
    return evaluate(*MIXTURES[mixture], EYE + H, H=H, real=wp.float32, tau_bar=TAU_BAR, **kw)


@pytest.mark.parametrize(
    ("mixture", "name"), [(m, n) for m in ("direct", "elastic") for n in ELASTIC if n in MIXTURES[m][0]]
)
def test_stress_and_energy_are_those_of_hooke(mixture: str, name: str):
    """τ = 2μ ε + λ tr ε I and ψ = ½ τ : ε; from F alone the stress is 40 % wrong, and the energy all of it."""
    out = at_rest(mixture, w_e=one_hot(MIXTURES[mixture][0], name))
    assert near(out["tau"], hooke(name), DEFAULTS["E"] * EPS)
    assert near(out["psi"], stored(name), DEFAULTS["E"] * (EPS * EPS).sum((1, 2)))


@pytest.mark.parametrize("mixture", ["direct", "elastic"])
def test_stress_of_a_mixture_and_its_gradients_are_those_of_hooke(mixture: str):
    """τ = Σ w τ_c; w̄_c = τ̄ : τ_c, E Ē = Σ w τ̄ : τ_c over the solids, K K̄ likewise; F̄ = ℂ : τ̄."""
    names = MIXTURES[mixture][0]
    w = np.random.default_rng(2).dirichlet(np.ones(len(names)), N)
    out = at_rest(mixture, w_e=w)
    parts = np.stack([hooke(n) for n in names], 1)
    work = (parts * TAU_BAR[:, None]).sum((2, 3))
    assert near(out["tau"], (w[:, :, None, None] * parts).sum(1), DEFAULTS["E"] * EPS)
    scale = DEFAULTS["E"] * np.linalg.norm(EPS, axis=(1, 2))
    assert near(out["w_e_bar"], work, scale)
    solid = np.array([n != "fluid_eos" for n in names])
    theta = {p.name: i for i, p in enumerate({p.name: p for n in names for p in ELASTIC[n].params}.values())}
    E_bar, K_bar = out["theta_bar"][:, theta["E"]], out["theta_bar"][:, theta["bulk_modulus"]]
    assert near(E_bar * DEFAULTS["E"], (w * work)[:, solid].sum(1), scale)
    assert near(K_bar * DEFAULTS["bulk_modulus"], (w * work)[:, ~solid].sum(1), scale)
    sym = (TAU_BAR + TAU_BAR.swapaxes(1, 2)) / 2
    trace = np.trace(sym, axis1=1, axis2=2)[:, None, None]
    F_bar = (w[:, :, None, None] * np.stack([hooke(n, trace, sym) for n in names], 1)).sum(1)
    assert near(out["F_bar"], F_bar, np.full(N, DEFAULTS["E"]))


def test_gradient_in_the_exponent_of_a_liquid_is_of_second_order():
    """∂τ/∂γ = −½ K (tr ε)²: what remains when the first order cancels."""
    names = MIXTURES["elastic"][0]
    theta = list({p.name: p for n in names for p in ELASTIC[n].params})
    out = at_rest("elastic", w_e=one_hot(names, "fluid_eos"))
    second = -0.5 * DEFAULTS["bulk_modulus"] * TRACE[:, 0, 0] ** 2 * np.trace(TAU_BAR, axis1=1, axis2=2)
    assert near(out["theta_bar"][:, theta.index("gamma")], second, DEFAULTS["E"] * (EPS * EPS).sum((1, 2)))


@pytest.mark.parametrize("name", PLASTIC)
def test_what_flows_is_right_to_the_digits_of_the_strain(name: str):
    """Fe − F, stress and slip in float32 are those in float64, of a state that flows in most places."""
    kw = {
        "w_e": one_hot(MIXTURES["all"][0], "hencky"),
        "w_p": one_hot(MIXTURES["all"][1], name),
        "memory": {"log_J": 2 * TRACE[:, 0, 0], "slip": np.full(N, 1e-7)},
        "params": WEAK,
    }
    half = at_rest("all", **kw)
    full = evaluate(*MIXTURES["all"], EYE + H, H=H, tau_bar=TAU_BAR, **kw)
    assert near(half["flow"], full["flow"], EPS)
    assert near(half["tau"], full["tau"], DEFAULTS["E"] * EPS)
    if name == "von_mises_hardening":
        assert near(half["slip"], full["slip"], full["slip"])
    if name != "identity":
        assert (np.abs(full["flow"]).max((1, 2)) > 1e-2 * STRAIN).mean() > 0.3


def test_a_liquid_keeps_its_volume_and_its_spin():
    """Fe − F = −dev ε."""
    out = at_rest("all", w_e=one_hot(MIXTURES["all"][0], "hencky"), w_p=one_hot(MIXTURES["all"][1], "fluid"))
    assert near(out["flow"], -(EPS - TRACE / 3 * EYE), EPS)


def exact_in_float32() -> torch.Tensor:
    """F = I + H with H of a few units of 2⁻²², so that F is what it is."""
    steps = np.random.default_rng(3).integers(-4, 5, (N, 3, 3)) * 2.0**-22
    return torch.from_numpy(EYE + steps).float()


@pytest.mark.parametrize("name", ELASTIC)
def test_functions_on_tensors_keep_the_digits_of_a_small_strain(name: str):
    """kirchhoff, energy and their gradient in float32 agree with float64, and the reference in torch with Hooke."""
    F = exact_in_float32().requires_grad_()
    D = F.detach().double().requires_grad_()
    single, double = ((kirchhoff(A, name, DEFAULTS), energy(A, name, DEFAULTS)) for A in (F, D))
    grads = [torch.autograd.grad(psi.sum(), A)[0].double() for (_, psi), A in ((single, F), (double, D))]
    with torch.no_grad():
        plain = reference.kirchhoff(F, name, DEFAULTS), reference.energy(F, name, DEFAULTS)
        e = (D - torch.eye(3)).numpy()
    eps = (e + e.swapaxes(1, 2)) / 2
    tau = hooke(name, np.trace(eps, axis1=1, axis2=2)[:, None, None], eps)
    for got in (single, double, plain):
        stress, psi = (t.detach().double().numpy() for t in got)
        # strains of 1e-6: second order 5e-6 of the first
        assert np.abs(stress - tau).max() < 4 * TOLERANCE * np.abs(tau).max()
        half = 0.5 * (tau * eps).sum((1, 2))
        assert np.abs(psi - half).max() < 4 * TOLERANCE * np.abs(half).max()
    assert float((grads[0] - grads[1]).abs().max()) < TOLERANCE * float(grads[1].abs().max())


@pytest.mark.parametrize("name", ["von_mises_hardening", "drucker_prager"])
def test_return_maps_on_tensors_keep_the_digits_of_a_small_strain(name: str):
    """Off the diagonal, where float32 holds them, the entries of Fe are right to forty ulp of the strain; slip too."""
    F, weak = exact_in_float32(), DEFAULTS | WEAK
    single, double, plain = (
        f(A, name, weak).double() for f, A in ((return_map, F), (return_map, F.double()), (reference.return_map, F))
    )
    off = ~torch.eye(3, dtype=torch.bool)
    strain = float((F - torch.eye(3)).abs().max())
    assert float((single - double).abs()[:, off].max()) < TOLERANCE * strain
    assert float((plain - double).abs()[:, off].max()) < TOLERANCE * strain
    for key, value in remember(F, name, weak).items():
        exact = remember(F.double(), name, weak)[key]
        assert float((value.double() - exact).abs().max()) < TOLERANCE * float(exact.abs().max())
