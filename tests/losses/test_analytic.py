"""The analytic prior answers the exact score of the distribution it states."""

import math

import pytest
import torch

from diffuphy.losses.guidance.analytic import Analytic, Variants


def problem(mode, shape=(3, 8, 8, 3), K=4, s=0.3, seed=0, patch=4):
    """Views whose posterior is undecided: references differ by little, so that every γ_k counts."""
    g = torch.Generator().manual_seed(seed)
    B = shape[0]
    r = 0.5 + 0.03 * torch.randn(B, K, *shape[1:], generator=g, dtype=torch.float64)
    logits = torch.randn(K, generator=g, dtype=torch.float64)
    z_t = 0.5 * torch.randn(shape, generator=g, dtype=torch.float64)
    t = torch.linspace(0.15, 0.9, B, dtype=torch.float64)
    return Analytic(mode=mode, s=s, patch=patch), Variants(r, logits, (1, 3)), z_t, t


def log_density(guidance, z_t, t, cond):
    """log p_t(z_t) written out: the log of the mixture of Gaussians that z_t = α z + σ ε follows."""
    alpha, sigma = guidance.schedule(t)
    r, logits, (oy, ox) = 2 * cond.images - 1, torch.log_softmax(cond.logits, 0), cond.offset
    total = []
    for b in range(len(z_t)):
        var = alpha[b] ** 2 * guidance.s**2 + sigma[b] ** 2
        square = (z_t[b][None] - alpha[b] * r[b]) ** 2 / (2 * var) + 0.5 * torch.log(
            2 * math.pi * var
        )  # (K, ..., H, W, 3)
        total.append(-square)
    total = torch.stack(total)  # (B, K, ...)
    if guidance.mode == "independent":
        return torch.logsumexp(logits + total.flatten(2).sum(-1), 1).sum()
    if guidance.mode == "joint":
        return torch.logsumexp(logits + total.flatten(2).sum((0, -1)), 0)
    p, (h, w) = guidance.patch, total.shape[-3:-1]
    total = torch.roll(total.sum(-1), (oy, ox), (-2, -1))
    value = 0.0
    for i in range(0, h, p):
        for j in range(0, w, p):
            value = value + torch.logsumexp(logits + total[..., i : i + p, j : j + p].flatten(2).sum(-1), 1).sum()
    return value


@pytest.mark.parametrize("mode", ["joint", "independent", "patch"])
@pytest.mark.parametrize("shape", [(3, 8, 8, 3), (1, 5, 8, 4, 3)], ids=["views", "clip"])
def test_noise_is_minus_sigma_times_the_score(mode, shape):
    """ε̂ = −σ ∇ log p_t(z_t), the gradient by autograd of the written-out log-density."""
    guidance, cond, z_t, t = problem(mode, shape)
    z = z_t.clone().requires_grad_()
    (score,) = torch.autograd.grad(log_density(guidance, z, t, cond), z)
    _, sigma = guidance.schedule(t)
    expected = -sigma.view(-1, *[1] * (z_t.ndim - 1)) * score
    # float64 rounding times the condition 1/σ² < 100 of the posterior's exponents
    torch.testing.assert_close(guidance.predict_noise(z_t, t, cond), expected, rtol=1e-10, atol=1e-11)


def test_modes_differ_when_views_disagree():
    """The three modes are three distributions: on views that prefer different variants their scores differ."""
    answers = []
    for mode in ("joint", "independent", "patch"):
        guidance, cond, z_t, t = problem(mode)
        answers.append(guidance.predict_noise(z_t, t, cond))
    assert min((a - b).abs().max().item() for a, b in zip(answers, answers[1:] + answers[:1], strict=True)) > 1e-3


def test_log_prior_chooses_among_equal_references():
    """With references equally far away, γ = π: the answer is that of the π-weighted mean."""
    real = {"dtype": torch.float64}
    r = torch.stack([torch.full((4, 4, 3), 0.4, **real), torch.full((4, 4, 3), 0.6, **real)])[None]
    z_t, t, pi = torch.zeros(1, 4, 4, 3, **real), torch.tensor([0.5], **real), torch.tensor([0.9, 0.1], **real)
    guidance = Analytic(mode="independent", s=0.1)
    alpha, sigma = guidance.schedule(t)
    m = 0.9 * -0.2 + 0.1 * 0.2  # references in z: −0.2 and +0.2
    expected = sigma * (0 - alpha * m) / (alpha**2 * 0.01 + sigma**2)
    got = guidance.predict_noise(z_t, t, Variants(r, pi.log()))
    torch.testing.assert_close(got, expected.expand_as(got.flatten()).view_as(got), rtol=1e-12, atol=0)


def test_posterior_survives_large_pictures_at_small_noise():
    """‖z − r‖²/2σ² ~ 10⁶ overflows exp(); the softmax must still pick the nearest reference, in float32."""
    g = torch.Generator().manual_seed(1)
    r = torch.rand(1, 3, 256, 256, 3, generator=g)
    guidance, t = Analytic(mode="joint", s=0.0), torch.tensor([0.001])
    alpha, sigma = guidance.schedule(t)
    z = 2 * r[:, 1] - 1
    noise = torch.randn(z.shape, generator=g)
    got = guidance.predict_noise(alpha * z + sigma * noise, t, Variants(r))
    # the noise is recovered up to the rounding of z_t, 6e-8 · |z_t| / σ with σ = 0.03
    torch.testing.assert_close(got, noise, rtol=0, atol=4 * 6e-8 * 1.2 / sigma.item() * 2)


def test_patch_grid_needs_and_follows_the_generator():
    """The offset comes from the given generator alone: same seed, same grid; no generator, an error."""

    def references(words, camera, background):
        return torch.rand(1, 2, 16, 16, 3, generator=torch.Generator().manual_seed(0)), None

    guidance = Analytic(references, mode="patch", patch=8)

    def draw(seed):
        g = torch.Generator().manual_seed(seed)
        return [guidance.condition(None, None, None, generator=g).offset for _ in range(8)]

    assert draw(3) == draw(3) and len(set(draw(3))) > 1
    with pytest.raises(ValueError, match="generator"):
        guidance.condition(None, None, None)


def test_patch_must_divide_the_picture():
    guidance, cond, z_t, t = problem("patch", patch=3)
    with pytest.raises(ValueError, match="3 px must divide"):
        guidance.predict_noise(z_t, t, cond)
