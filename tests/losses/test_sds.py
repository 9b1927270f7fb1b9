"""The score-distillation estimator against what is known exactly about it."""

import math

import pytest
import torch

from diffuphy.losses import Constant, Exponential, Linear, sds
from diffuphy.losses.guidance.analytic import Analytic, Variants
from diffuphy.losses.schedules import scaled_linear
from diffuphy.losses.sds import WEIGHTS


def gradient(guidance, x, cond, t, **kwargs):
    x = x.detach().requires_grad_()
    sds(guidance, x, cond, t=t, **kwargs).backward()
    return x.grad


@pytest.mark.parametrize("weight", list(WEIGHTS))
def test_noise_cancels_for_one_reference(weight):
    """K = 1, s = 0: w (ε̂ − ε) = w (α/σ)(z − r) whatever the noise; with z = 2x − 1 the gradient in x is twice that."""
    g = torch.Generator().manual_seed(0)
    x, r = (torch.rand(2, 6, 6, 3, generator=g, dtype=torch.float64) for _ in range(2))
    guidance, t = Analytic(s=0.0), torch.tensor([0.1, 0.8], dtype=torch.float64)
    got = [
        gradient(guidance, x, Variants(r[:, None]), t, generator=torch.Generator().manual_seed(i), weight=weight)
        for i in (1, 2)
    ]
    alpha, sigma = (a.view(-1, 1, 1, 1) for a in guidance.schedule(t))
    expected = 2 * WEIGHTS[weight](alpha, sigma) * alpha / sigma * 2 * (x - r)
    for grad in got:
        torch.testing.assert_close(grad, expected, rtol=1e-10, atol=1e-12)  # rounding of z_t divided by σ > 0.1


@pytest.mark.parametrize("weight", list(WEIGHTS))
def test_expected_gradient_is_the_closed_form(weight):
    """E_ε[w(ε̂ − ε)] = w σ α (z − r) / v for one Gaussian, v = α² s² + σ²; per draw the rest is w (σ²/v − 1) ε.

    The mean of n draws is therefore normal about the closed form with standard error w |σ²/v − 1| / √n. The largest of
    D such errors exceeds 5.5 of them with chance D · 4e-8 < 1e-5, and their rms must be the standard error within
    4/√(2D).
    """
    g = torch.Generator().manual_seed(0)
    x, r = (torch.rand(1, 6, 6, 3, generator=g, dtype=torch.float64) for _ in range(2))
    guidance, t, n = Analytic(s=0.4, mode="independent"), torch.tensor([0.4], dtype=torch.float64), 2000
    total = torch.zeros_like(x)
    for _ in range(n):
        total += gradient(guidance, x, Variants(r[:, None]), t, generator=g, weight=weight)
    alpha, sigma = guidance.schedule(t)
    v, w = alpha**2 * guidance.s**2 + sigma**2, WEIGHTS[weight](alpha, sigma)
    expected = 2 * w * sigma * alpha * 2 * (x - r) / v  # first 2: dz/dx
    error = (total / n - expected) / (2 * w * (sigma**2 / v - 1).abs() / math.sqrt(n))
    assert error.abs().max() < 5.5
    assert abs(error.square().mean().sqrt() - 1) < 4 / math.sqrt(2 * x.numel())


def test_gradient_is_injected_at_the_latent_and_flows_through_the_encoder():
    """∂L/∂x = Jᵀ w(ε̂ − ε) with J of any encoder; the loss is scaled like any other."""
    g = torch.Generator().manual_seed(0)
    M = torch.randn(5, 5, generator=g, dtype=torch.float64)

    class Mixed(Analytic):
        def encode(self, sample):
            return sample @ M

    x, r, noise = (torch.randn(1, 4, 4, 5, generator=g, dtype=torch.float64) for _ in range(3))
    t = torch.tensor([0.5], dtype=torch.float64)
    plain = gradient(Analytic(), (x @ M + 1) / 2, Variants(r[:, None]), t, noise=noise) / 2  # dL/dz
    x.requires_grad_()
    (3 * sds(Mixed(), x, Variants(r[:, None]), t=t, noise=noise)).backward()
    torch.testing.assert_close(x.grad, 3 * plain @ M.T, rtol=1e-10, atol=1e-12)


def test_half_precision_sample_gets_the_full_gradient():
    """A bfloat16 render loses only its own rounding (2⁻⁸), not the 78 % that the (z − g).detach() target loses."""
    g = torch.Generator().manual_seed(0)
    x, r = torch.rand(1, 8, 8, 3, generator=g), torch.rand(1, 1, 8, 8, 3, generator=g)
    x = x.bfloat16()
    noise, t = torch.randn(1, 8, 8, 3, generator=g), torch.tensor([0.05])
    exact = gradient(Analytic(), x.double(), Variants(r.double()), t.double(), noise=noise.double())
    half = gradient(Analytic(), x, Variants(r), t, noise=noise)
    assert (half.double() - exact).norm() < 2**-8 * exact.norm()


def test_noise_comes_from_the_generator_alone():
    g = torch.Generator().manual_seed(0)
    x, r, t = torch.rand(1, 4, 4, 3, generator=g), torch.rand(1, 2, 4, 4, 3, generator=g), torch.tensor([0.7])

    def draw(seed):
        return gradient(Analytic(s=0.3), x, Variants(r), t, generator=torch.Generator().manual_seed(seed))

    state = torch.random.get_rng_state()
    assert torch.equal(draw(1), draw(1)) and not torch.equal(draw(1), draw(2))
    assert torch.equal(state, torch.random.get_rng_state())


def test_non_finite_prediction_names_guidance_and_time():
    class Broken(Analytic):
        def predict_noise(self, z_t, t, cond):
            return z_t * float("nan")

    with pytest.raises(FloatingPointError, match=r"Broken.*t = \[0\.25\]"):
        sds(Broken(), torch.rand(1, 2, 2, 3), None, t=torch.tensor([0.25]), generator=torch.Generator())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": torch.tensor([1.0])}, r"in \(0, 1\)"),
        ({"t": torch.tensor([0.5, 0.5])}, "one per sample"),
        ({"weight": "sigma"}, "sigma2, x0, unit"),
        ({"generator": None}, "global state"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    arguments = {"t": torch.tensor([0.5]), "generator": torch.Generator()} | change
    with pytest.raises(ValueError, match=message):
        sds(Analytic(), torch.rand(1, 2, 2, 3), Variants(torch.rand(1, 1, 2, 2, 3)), **arguments)


def test_noise_schedule_is_that_of_stable_diffusion():
    """ᾱ of diffusers' DDIMScheduler with the numbers of SD 1.5; it works in float32, so 1000 factors agree to 1e-4
    relative."""
    diffusers = pytest.importorskip("diffusers")
    scheduler = diffusers.DDIMScheduler(beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear")
    torch.testing.assert_close(scaled_linear().float(), scheduler.alphas_cumprod, rtol=1e-4, atol=0)


def test_annealing_ramps_end_where_they_say():
    """Values at 0, half-way, the end of the ramp and after it; a share of the run scales with the run."""
    assert Constant(0.3)(7, 10) == 0.3
    ramp = Linear(0.98, 0.25, steps=0.5)
    assert [ramp(k, 1000) for k in (0, 250, 500, 900)] == pytest.approx([0.98, 0.615, 0.25, 0.25])
    assert Linear(1.0, 0.0, steps=10)(5, 1000) == pytest.approx(0.5)
    assert Exponential(1.0, 0.01)(5, 10) == pytest.approx(0.1)
    for wrong in (0, -3, 1.5):
        with pytest.raises(ValueError, match="share of the run"):
            Linear(1.0, 0.0, steps=wrong)
