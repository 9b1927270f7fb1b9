"""The mixture and its adjoint: against differences, single laws and the other precision; and what its kernel holds."""

from pathlib import Path

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.material import ELASTIC, PLASTIC, make_mixture, rate_gate, wave_speed
from diffuphy.material.expert import MEMORY
from diffuphy.material.moduli import lame
from diffuphy.material.plastic.drucker_prager import LATCH
from tests.material.evaluate import DEFAULTS, evaluate, generic, rotations, special, stretched

RNG = np.random.default_rng(0)
MU, LAM = (float(x) for x in lame(DEFAULTS))
ALL = (tuple(ELASTIC), tuple(PLASTIC))
MIXTURES = {
    "direct": (tuple(n for n, law in ELASTIC.items() if law.is_direct), ()),
    "elastic": (tuple(ELASTIC), ()),
    "all": ALL,
    **{f"hencky+{name}": (("hencky",), (name,)) for name in PLASTIC if name != "identity"},
}


def on_the_edges() -> dict[str, np.ndarray]:
    """States a hair on either side of every kink of the return maps of ``DEFAULTS``."""
    r = np.sqrt(2 / 3) * DEFAULTS["yield_stress"] / (2 * MU)
    direction = np.array([2.0, -1.0, -1.0]) / np.sqrt(6)
    shear = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    c = DEFAULTS["cohesion"]
    out = {}
    for side in (-1e-2, 1e-2):
        dirs = np.stack([direction, shear] * 4)
        out[f"yield {side:+.0e}"] = stretched(np.exp(0.01 + (1 + side) * r * dirs), RNG)
        out[f"cone tip {side:+.0e}"] = stretched(np.exp(c + side * c + 0.02 * dirs), RNG)
        phi = np.radians(DEFAULTS["friction_angle"])
        alpha = np.sqrt(2 / 3) * 2 * np.sin(phi) / (3 - np.sin(phi))
        n = (1 + side) * alpha * (1 + DEFAULTS["nu"]) / (1 - 2 * DEFAULTS["nu"]) * 3 * 0.05
        out[f"cone {side:+.0e}"] = stretched(np.exp(c - 0.05 + n * dirs), RNG)
    return out


def total(F: np.ndarray, history: str) -> np.ndarray:
    """Total ln J that brings elastic deformations F into one regime of the cone with memory, off its kinks."""
    tr = np.log(np.linalg.det(F))
    far = 2 * np.minimum(tr, -0.05) / LATCH  # pressed together so far before that tr is what it is
    at = {
        "unloading": far,
        "loading": tr / (2 * LATCH),
        "just closed": np.full_like(tr, -1e-3),
        "just open": np.full_like(tr, 1e-3),
        "open": np.full_like(tr, 0.2),
    }[history]
    return np.where(tr < -0.02, at, far)


STATES = {"generic": generic(64, RNG)} | special(RNG) | on_the_edges()


def gradient_error(
    names: tuple, F: np.ndarray, *, relative_step: np.ndarray | float = 1.0, history: str = "unloading"
) -> float:
    """Largest error of ⟨F̄, dF⟩, ⟨w̄, dw⟩, ⟨θ̄, dθ⟩, ⟨h̄, dh⟩ against fourth-order differences, relative to the largest of
    each."""
    m = make_mixture(*names, wp.float64)
    n, rng = len(F), np.random.default_rng(7)
    x = {
        "F": F,
        "w_e": rng.dirichlet(np.ones(max(1, m.Ke)), n),
        "w_p": rng.dirichlet(np.ones(max(1, m.Kp)), n),
        "theta": np.tile([DEFAULTS[p] for p in m.params], (n, 1)),
        "log_J": total(F, history),
        "slip": rng.uniform(0, 0.2, n),
        "heat": rng.uniform(0, 0.5, n),
    }
    d = {
        "F": rng.normal(size=F.shape) * np.reshape(relative_step, (-1, 1, 1)),
        "w_e": rng.normal(size=x["w_e"].shape) * (m.Ke > 1),
        "w_p": rng.normal(size=x["w_p"].shape) * (m.Kp > 1),
        "theta": rng.normal(size=x["theta"].shape) * x["theta"] * 0.1,
        **{k: rng.normal(size=n) for k in MEMORY},
    }
    tau_bar, Fe_bar = rng.normal(size=F.shape) / DEFAULTS["E"], rng.normal(size=F.shape)
    bars = {k: rng.normal(size=n) for k in MEMORY}
    spread = np.ptp(np.linalg.svd(F, compute_uv=False), axis=1)
    bars["slip"] *= spread > 1e-3  # √(2/3) a |ê| has a kink at ê = 0 beside a law that flows at no stress

    def value(**changed: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        at = x | changed
        past = {k: at.pop(k) for k in MEMORY}
        out = evaluate(*names, **at, memory=past, tau_bar=tau_bar, Fe_bar=Fe_bar, memory_bar=bars)
        remembered = sum(out[k] * bars[k] for k in MEMORY)
        return out, (out["tau"] * tau_bar + out["Fe"] * Fe_bar).sum((1, 2)) + remembered

    exact, _ = value()
    worst, h = 0.0, 2e-5
    for key, at in x.items():
        step = h * d[key]
        near = value(**{key: at + step})[1] - value(**{key: at - step})[1]
        far = value(**{key: at + 2 * step})[1] - value(**{key: at - 2 * step})[1]
        numeric = (8 * near - far) / (12 * h)
        closed = (exact[f"{key}_bar"] * d[key]).reshape(n, -1).sum(1)
        worst = max(worst, float(np.abs(numeric - closed).max() / max(1.0, np.abs(closed).max())))
    return worst


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("mixture", MIXTURES)
def test_adjoint_is_the_derivative(mixture: str, state: str):
    """Every gradient against differences in float64, also where a singular value decomposition has no derivative.

    The step 2e-5 leaves rounding 1e-16/2e-5 = 5e-12 of values of order 1, and truncation h⁴ = 1e-19.
    """
    assert gradient_error(MIXTURES[mixture], STATES[state]) < 2e-9


@pytest.mark.parametrize("history", ["loading", "just closed", "just open", "open"])
@pytest.mark.parametrize("mixture", ["all", "hencky+drucker_prager", "hencky+drucker_prager_plane_strain"])
def test_adjoint_is_the_derivative_whatever_the_grains_went_through(mixture: str, history: str):
    """The same for matter that is pressed for the first time, and on either side of the volume at which it closes."""
    assert max(gradient_error(MIXTURES[mixture], F, history=history) for F in STATES.values()) < 2e-9


def test_adjoint_is_the_derivative_at_condition_1e4():
    """Stretches from 0.01 to 100, step relative to the smallest; values up to 1e8, so relative to the largest."""
    s = np.stack([RNG.permutation([0.01, 1.0, 100.0]) for _ in range(16)])
    assert gradient_error(ALL, stretched(s, RNG), relative_step=np.full(16, 1e-2)) < 1e-8


@pytest.mark.parametrize("name", ["drucker_prager", "drucker_prager_plane_strain"])
def test_the_tip_of_a_cone_has_the_gradient_of_the_projection(name: str):
    """R(R(F)) = R(F) for every cohesion, so both have one gradient, wherever on the tip rounding puts R(F); the last
    half step of a frame maps a second time. Here ê is mere rounding, and 1e-10 is a million times that of one map."""
    F = stretched(np.exp(0.05 + RNG.uniform(-0.1, 0.1, (500, 3))), RNG)
    F = F[np.log(np.linalg.det(F)) > 3 * DEFAULTS["cohesion"] + 1e-3]
    kw = {"memory": {"log_J": np.full(len(F), 0.2)}}
    Fe_bar = RNG.normal(size=F.shape)
    once = evaluate(("hencky",), (name,), F, Fe_bar=Fe_bar, **kw)
    second = evaluate(("hencky",), (name,), once["Fe"], Fe_bar=Fe_bar, **kw)
    first = evaluate(("hencky",), (name,), F, Fe_bar=second["F_bar"], **kw)
    assert len(F) > 100
    assert np.abs(first["theta_bar"] + second["theta_bar"] - once["theta_bar"]).max() < 1e-10
    assert np.abs(first["F_bar"] - once["F_bar"]).max() < 1e-10


def test_rest_of_sand_has_one_sided_derivative():
    """At F = I without cohesion sand sits on the tip of its cone: the adjoint is finite and that of the tip."""
    rest, no_cohesion, Fe_bar = np.eye(3)[None], {"cohesion": 0.0}, RNG.normal(size=(1, 3, 3))
    out = evaluate(("hencky",), ("drucker_prager",), rest, params=no_cohesion, Fe_bar=Fe_bar)
    # beyond the tip Fe is the rotation of F: only the antisymmetric part of F̄e passes
    assert np.abs(out["F_bar"] - (Fe_bar - Fe_bar.swapaxes(1, 2)) / 2).max() < 1e-14


@pytest.mark.parametrize(
    ("elastic", "plastic"), [*((e, "identity") for e in ELASTIC), *(("hencky", p) for p in PLASTIC if p != "identity")]
)
def test_one_hot_weights_are_the_single_law(elastic: str, plastic: str):
    """Σ w_c x_c = x_1 for one-hot w, in value and in gradient, to a few ulp (the compiler may contract products)."""
    F = generic(200, RNG)
    bars = {"tau_bar": RNG.normal(size=F.shape) / DEFAULTS["E"], "Fe_bar": RNG.normal(size=F.shape)}
    w_e = np.tile([float(n == elastic) for n in ELASTIC], (200, 1))
    w_p = np.tile([float(n == plastic) for n in PLASTIC], (200, 1))
    mixed = evaluate(*ALL, F, w_e=w_e, w_p=w_p, **bars)
    single = evaluate((elastic,), (plastic,) if plastic != "identity" else (), F, **bars)
    gradient = max(1.0, np.abs(single["F_bar"]).max())
    for key, scale in (("tau", DEFAULTS["E"]), ("Fe", 1.0), ("F_bar", gradient)):
        assert np.abs(mixed[key] - single[key]).max() < 100 * np.finfo(np.float64).eps * scale


@pytest.mark.parametrize("state", ["generic", "identity", "rotation", "two equal stretches", "nearly identity"])
@pytest.mark.parametrize("mixture", ["direct", "elastic", "all"])
def test_float32_agrees_with_float64(mixture: str, state: str):
    """Value and gradient to 1e-5: 100 roundings of 6e-8. F is rounded first, so that both see the same state."""
    F = STATES[state].astype(np.float32).astype(np.float64)
    bars = {"tau_bar": RNG.normal(size=F.shape) / DEFAULTS["E"], "Fe_bar": RNG.normal(size=F.shape)}
    bars["memory"] = {"log_J": total(F, "unloading").astype(np.float32)}
    half, full = (evaluate(*MIXTURES[mixture], F, real=r, **bars) for r in (wp.float32, wp.float64))
    assert np.abs(half["tau"] - full["tau"]).max() < 1e-5 * (LAM + 2 * MU)
    assert np.abs(half["Fe"] - full["Fe"]).max() < 1e-5
    assert np.abs(half["F_bar"] - full["F_bar"]).max() < 1e-5 * max(1.0, np.abs(full["F_bar"]).max())


def test_stress_of_a_mixture_is_linear_in_its_weights():
    """τ(w) = Σ_c w_c τ_c without plasticity."""
    F = generic(100, RNG)
    w = RNG.dirichlet(np.ones(len(ELASTIC)), 100)
    parts = np.stack([evaluate((name,), (), F)["tau"] for name in ELASTIC], 1)
    tau = evaluate(tuple(ELASTIC), (), F, w_e=w)["tau"]
    assert np.abs(tau - (w[:, :, None, None] * parts).sum(1)).max() < 1e-11 * DEFAULTS["E"]


def test_volume_stays_positive_under_any_gates():
    """det Fe = exp(3 m) > 0 for weights anywhere on the simplex: the mixture is in log space."""
    F = generic(500, RNG, spread=1.5)
    out = evaluate(*ALL, F, w_p=RNG.dirichlet(np.ones(len(PLASTIC)), 500))
    assert (np.linalg.det(out["Fe"]) > 0).all()


@pytest.mark.parametrize("mixture", ["direct", "elastic", "all"])
def test_inverted_states_are_flagged_and_not_a_number(mixture: str):
    """det F ≤ 0 or NaN: valid is false and the stress is NaN; a healthy neighbour is untouched."""
    F = rotations(6, RNG) @ np.diag([1.1, 1.0, 0.9])
    F[1] *= -1
    F[2] = np.nan
    F[3] = F[3] @ np.diag([1.0, 1.0, -1.0])
    out = evaluate(*MIXTURES[mixture], F)
    assert out["valid"].tolist() == [1, 0, 0, 0, 1, 1]
    assert np.isnan(out["tau"][1:4]).any((1, 2)).all()
    assert np.isfinite(out["tau"][[0, 4, 5]]).all()


def source(elastic: tuple[str, ...], plastic: tuple[str, ...]) -> str:
    """Generated C++ source of a kernel that uses stress and adjoint of a mixture."""
    m = make_mixture(elastic, plastic, wp.float64)
    memory = len(m.memory) > 0
    memory_t = m.memory_t
    mat33, w_e_t, w_p_t, theta_t, real = m.mat33, m.w_e_t, m.w_p_t, m.theta_t, m.real

    @wp.kernel(module="unique", enable_backward=False)
    def both(F: wp.array(dtype=mat33), w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real, F_bar: wp.array(dtype=mat33)):
        p = wp.tid()
        if wp.static(memory):
            tau, D, h = m.stress(F[p], F[p], w_e, w_p, theta, dt, memory_t())
            a, _b, _c, _d, _e = m.stress_adjoint(F[p], F[p], w_e, w_p, theta, dt, tau, D, h, h)
            F_bar[p] = a
        else:
            tau, D = m.stress(F[p], F[p], w_e, w_p, theta, dt)
            a, _b, _c, _d = m.stress_adjoint(F[p], F[p], w_e, w_p, theta, dt, tau, D)
            F_bar[p] = a

    both.module.load("cpu")
    folder = Path(wp.config.kernel_cache_dir)
    return next(folder.glob(f"*{both.module.get_module_identifier()}*/*.cpp")).read_text()


def test_kernels_hold_only_what_was_asked_for():
    """Neo-Hookean alone: no decomposition, no return map, no weight is read; each comes when asked for."""
    alone = source(("neo_hookean",), ("identity",))
    for absent in ("decompose", "flow", "sum_elastic", "sum_plastic", "wp::extract(var_w", "wp::exp", "svd"):
        assert absent not in alone
    elastic = source(("hencky",), ())
    assert "decompose" in elastic and "flow" not in elastic and "wp::extract(var_w" not in elastic
    flowing = source(("neo_hookean",), ("identity", "von_mises"))
    assert "decompose" in flowing and "flow" in flowing and "wp::extract(var_w" in flowing
    assert "wp::sin(" not in flowing  # the friction angle of a cone that is not there
    assert "log_J" not in flowing and "_nothing" not in flowing.split("both", 1)[1]
    assert "wp::sin(" in source(("neo_hookean",), ("drucker_prager",))


def test_mixture_knows_what_it_leaves_out():
    assert not make_mixture(("neo_hookean",), ("identity",)).decomposes
    assert not make_mixture(("neo_hookean",), ("identity",)).plastic
    assert make_mixture(("hencky",), ()).decomposes
    assert make_mixture(("neo_hookean",), ("fluid", "identity")).plastic
    assert make_mixture(("hencky",), ("von_mises", "fluid")).memory == ()
    assert make_mixture(("hencky",), ("von_mises", "drucker_prager")).memory == ("log_J",)
    assert make_mixture(("hencky",), ("von_mises",)).params == ("E", "nu", "yield_stress")
    assert make_mixture(("hencky",), ()) is make_mixture(("hencky",), ())


def test_unknown_and_repeated_laws_are_refused():
    with pytest.raises(ValueError, match="unknown elastic law 'rubber'; known: fixed_corotated"):
        make_mixture(("rubber",))
    with pytest.raises(ValueError, match="plastic laws must differ"):
        make_mixture(("hencky",), ("fluid", "fluid"))
    with pytest.raises(ValueError, match="at least one elastic law"):
        make_mixture(())


def test_wave_speed_of_a_mixture_is_its_stiffness():
    """ρ c² = ∂τ_xx/∂F_xx at rest; fourth-order differences."""
    w, rho, h = RNG.dirichlet(np.ones(len(ELASTIC)), 1), 800.0, 1e-3
    F = np.tile(np.eye(3), (4, 1, 1))
    F[:, 0, 0] += h * np.array([1.0, -1.0, 2.0, -2.0])
    t = evaluate(tuple(ELASTIC), (), F, w_e=np.tile(w, (4, 1)))["tau"][:, 0, 0]
    stiffness = (8 * (t[0] - t[1]) - (t[2] - t[3])) / (12 * h)
    theta = {k: torch.tensor([v], dtype=torch.float64) for k, v in DEFAULTS.items()}
    c = wave_speed(tuple(ELASTIC), torch.from_numpy(w), theta, torch.tensor([rho], dtype=torch.float64))
    assert abs(rho * float(c[0]) ** 2 / stiffness - 1) < 1e-9


def test_rate_gate_sheds_the_same_in_the_same_time():
    """(1 − g(dt))^(dt_ref/dt) = 1 − w for any dt; rows stay on the simplex; one-hot rows stay as they are."""
    names = ("identity", "von_mises", "fluid")
    w = torch.from_numpy(RNG.dirichlet(np.ones(3), 50))
    for dt in (1e-3, 2.5e-4, 1e-5):
        g = rate_gate(w, names, dt, 1e-3)
        torch.testing.assert_close((1 - g[:, 1:]) ** (1e-3 / dt), 1 - w[:, 1:], rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(g.sum(1), torch.ones(50, dtype=w.dtype))
        assert (g >= 0).all()
    one = torch.eye(3, dtype=torch.float64, requires_grad=True)
    gate = rate_gate(one, names, 1e-4, 1e-3)
    assert torch.equal(gate, one)
    (grad,) = torch.autograd.grad(gate.square().sum(), one)
    assert torch.isfinite(grad).all()


def test_rate_gate_refuses_what_it_cannot_do():
    w = torch.full((1, 2), 0.5)
    with pytest.raises(ValueError, match="0 < dt <= dt_ref"):
        rate_gate(w, ("identity", "fluid"), 2e-3, 1e-3)
    with pytest.raises(ValueError, match="'identity' column"):
        rate_gate(w, ("von_mises", "fluid"), 1e-4, 1e-3)
