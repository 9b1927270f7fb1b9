"""Densification by adaptive splitting: the algebra of the rule, its caps, and what happens to the optimiser."""

import math
import warnings

import pytest
import torch

from diffuphy.text2gs.densify import AdaptiveSplitting, beta, das_literal, das_prose, das_threshold, rotate
from diffuphy.text2gs.params import LearningRates, Parameters, clean
from diffuphy.types import Gaussians


def gradients(n=500, seed=0):
    """Lognormal norms, as measured in training: standard deviation about as large as the mean."""
    return torch.exp(0.8 * torch.randn(n, generator=torch.Generator().manual_seed(seed), dtype=torch.float64))


def gaussians(n=100, seed=0, scale=0.05, opacity=0.5, dtype=torch.float32):
    g = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=torch.randn(n, 3, generator=g, dtype=dtype) * 0.5,
        quats=torch.randn(n, 4, generator=g, dtype=dtype),
        log_scales=math.log(scale) + 0.2 * torch.randn(n, 3, generator=g, dtype=dtype),
        logit_opacities=torch.full((n,), math.log(opacity / (1 - opacity)), dtype=dtype),
        sh=torch.randn(n, 1, 3, generator=g, dtype=dtype),
    )


# ---------------------------------------------------------------------- the rule
@pytest.mark.parametrize("wanted", [0.1, 0.3, 0.45])
def test_literal_rule_below_one_is_vanilla_pushed_away_from_the_mean(wanted):
    """β < 1: g_i ≥ τ_i ⇔ g_i ≥ ḡ + (τ_base − ḡ)/(1 − β), which is further from ḡ than τ_base is."""
    g = gradients()
    for tau in (0.7 * g.mean().item(), 1.6 * g.mean().item()):
        alpha = wanted * g.std(correction=0).item() / tau
        assert beta(g, tau, alpha) == pytest.approx(wanted)
        threshold = das_threshold(g, tau, alpha)
        assert abs(threshold - g.mean()) > abs(tau - g.mean())
        assert torch.equal(das_literal(g, tau, alpha), g >= threshold)


def test_literal_rule_above_one_is_reversed():
    """β > 1: g_i ≥ τ_i ⇔ g_i ≤ ḡ − (τ_base − ḡ)/(β − 1): the small gradients are split, the largest never."""
    g = gradients()
    tau = 1.2 * g.mean().item()
    alpha = 2.0 * g.std(correction=0).item() / tau
    mask = das_literal(g, tau, alpha)
    limit = g.mean() - (tau - g.mean()) / (2.0 - 1)
    assert torch.equal(mask, g <= limit)
    assert mask.any() and g[mask].max() < g[~mask].min()


@pytest.mark.parametrize(("ratio", "all_or_none"), [(0.9, True), (1.1, False)])
def test_literal_rule_at_one_splits_all_or_none(ratio, all_or_none):
    """β = 1: g_i − τ_i = ḡ − τ_base for every i."""
    g = gradients()
    tau = ratio * g.mean().item()
    mask = das_literal(g, tau, g.std(correction=0).item() / tau)
    assert bool(mask.all()) == all_or_none and bool(mask.any()) == all_or_none


def test_literal_rule_without_sensitivity_is_vanilla():
    g = gradients()
    assert torch.equal(das_literal(g, 1.3, 0.0), g >= 1.3)


def test_reversal_warns_and_the_default_cannot_reverse():
    """β ≥ 1 warns for the literal rule; the clamped one still splits the largest gradients."""
    g = gradients()
    literal = AdaptiveSplitting(rule="das_literal", alpha=3.0, growth=1.0, max_count=10**6)
    with pytest.warns(RuntimeWarning, match="reversed"):
        literal.chosen(g)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mask, slope = AdaptiveSplitting(alpha=3.0, growth=1.0, max_count=10**6).chosen(g)
    assert slope > 1 and mask.any() and g[mask].min() > g[~mask].max()


@pytest.mark.parametrize("wanted", [0.1, 0.9, 5.0])
def test_the_rule_of_the_prose_splits_more_where_gradients_are_large(wanted):
    """g_i ≥ τ_base (1 − α z_i) ⇔ g_i ≥ ḡ + (τ_base − ḡ)/(1 + β): nearer to ḡ than τ_base for any β, hence more splits
    than the vanilla rule when τ_base > ḡ, and never the smallest gradients."""
    g = gradients()
    for tau in (0.7 * g.mean().item(), 1.6 * g.mean().item()):
        alpha = wanted * g.std(correction=0).item() / tau
        threshold = das_prose(g, tau, alpha)
        z = (g - g.mean()) / g.std(correction=0)
        assert torch.equal(g >= tau * (1 - alpha * z), g >= threshold)
        assert abs(threshold - g.mean()) < abs(tau - g.mean())
    rule = AdaptiveSplitting(rule="das_prose", alpha=3.0, growth=1.0, max_count=10**6)
    mask, _ = rule.chosen(g)
    assert mask.sum() > (g >= 1.5 * g.mean()).sum() and g[mask].min() > g[~mask].max()
    assert torch.equal(mask, g >= rule.threshold(g))


@pytest.mark.parametrize("rule", ["das", "das_literal", "das_prose"])
def test_an_event_logs_its_threshold(rule):
    """g*, so that a run can be judged afterwards; at β = 1 eq. 3 has none, and no number is divided by zero."""
    params, g = Parameters(gaussians(500)), gradients().float()
    splitting = AdaptiveSplitting(rule=rule, max_count=10**6)
    counts = splitting(params, g, torch.Generator().manual_seed(0))
    assert counts["threshold"] == splitting.threshold(g)
    assert das_threshold(g, 1.5 * g.mean().item(), 100.0, beta_max=1.0) == math.inf
    assert das_threshold(g, 0.5 * g.mean().item(), 100.0, beta_max=1.0) == -math.inf


def test_default_rule_does_not_depend_on_the_scale_of_the_loss():
    """τ_base = κ ḡ: choosing is invariant under g → c g."""
    g, rule = gradients(), AdaptiveSplitting(growth=1.0, max_count=10**6)
    assert torch.equal(rule.chosen(g)[0], rule.chosen(1e-6 * g)[0])


def test_caps_keep_the_largest_gradients():
    g = gradients()
    mask, _ = AdaptiveSplitting(kappa=0.1, growth=0.2, max_count=10**6).chosen(g)
    assert mask.sum() == 100 and g[mask].min() > g[~mask].max()
    mask, _ = AdaptiveSplitting(kappa=0.1, growth=0.2, max_count=530).chosen(g)
    assert mask.sum() == 30


def test_events_follow_their_schedule():
    rule = AdaptiveSplitting(start=100, stop=0.5, every=100)
    assert [s for s in range(1, 1001) if rule.due(s, 1000)] == [100, 200, 300, 400, 500]


# ---------------------------------------------------------------------- the surgery
def trained(g, steps=3):
    params = Parameters(g)
    for k in range(steps):
        for name, x in params.values.items():
            x.grad = torch.randn(x.shape, generator=torch.Generator().manual_seed(17 * k + len(name)), dtype=x.dtype)
        params.step(LearningRates())
    return params


def test_survivors_keep_their_moments_and_newcomers_have_none():
    params = trained(gaussians(200))
    before = {n: (params.values[n].detach().clone(), params.m[n].clone(), params.v[n].clone()) for n in params.values}
    g = torch.linspace(0, 1, 200) ** 4
    rule = AdaptiveSplitting(growth=0.1, min_opacity=1e-6)
    chosen, _ = rule.chosen(g)
    counts = rule(params, g, torch.Generator().manual_seed(0))
    kept = int((~chosen).sum())
    assert counts["split"] + counts["cloned"] == 20 and len(params) == 200 + 20
    for n, (x, m, v) in before.items():
        assert torch.equal(params.values[n][:kept], x[~chosen])
        assert torch.equal(params.m[n][:kept], m[~chosen]) and torch.equal(params.v[n][:kept], v[~chosen])
        assert not params.m[n][kept:].any() and not params.v[n][kept:].any()
        assert params.values[n].requires_grad and params.values[n].is_leaf
    assert params.age[:kept].unique().tolist() == [3] and params.age[kept:].unique().tolist() == [0]


def test_small_are_cloned_and_large_are_split():
    """Clones keep their size and share the opacity, 1 − (1 − o′)² = o; split children are 1.6 times smaller and as
    opaque."""
    for scale, kind, shrink, opacity in ((0.005, "cloned", 1.0, 1 - math.sqrt(0.5)), (0.05, "split", 1.6, 0.5)):
        source = gaussians(50, scale=scale)
        params = Parameters(source)
        counts = AdaptiveSplitting(kappa=1e-3, growth=1.0)(params, torch.ones(50), torch.Generator().manual_seed(0))
        assert counts[kind] == 50 and len(params) == 100
        torch.testing.assert_close(params.values["log_scales"], source.log_scales.repeat(2, 1) - math.log(shrink))
        torch.testing.assert_close(torch.sigmoid(params.values["logit_opacities"]), torch.full((100,), opacity))


def test_children_are_drawn_from_their_parent():
    """Children of N(μ, R S² Rᵀ) have that covariance: n draws estimate it within 5 √(2/n) of its size."""
    n = 20000
    one = gaussians(1, seed=3, dtype=torch.float64)
    params = Parameters(Gaussians(**{k: v.repeat(n, *[1] * (v.ndim - 1)) for k, v in vars(one).items()}))
    AdaptiveSplitting(kappa=1e-3, growth=1.0, max_count=10**6)(params, torch.ones(n), torch.Generator().manual_seed(0))
    x = params.values["means"].detach() - one.means
    R = rotate(one.quats.expand(3, 4), torch.eye(3, dtype=torch.float64)).T
    expected = R @ torch.diag((2 * one.log_scales[0]).exp()) @ R.T
    assert (x.T @ x / len(x) - expected).abs().max() < 5 * math.sqrt(2 / (2 * n)) * expected.diagonal().max()


def test_transparent_gaussians_are_pruned():
    params = Parameters(gaussians(60))
    with torch.no_grad():
        params.values["logit_opacities"][:10] = -6.0
    counts = AdaptiveSplitting(kappa=1e9)(params, torch.ones(60), torch.Generator())
    assert counts["pruned"] == 10 and len(params) == 50


def test_adam_is_that_of_torch():
    """Without surgery the optimiser is torch.optim.Adam, to rounding (same operations in another order)."""
    source = gaussians(40, dtype=torch.float64)
    params, rates = Parameters(source), LearningRates()
    reference = {n: x.detach().clone().requires_grad_() for n, x in params.values.items()}
    adam = torch.optim.Adam(
        [{"params": [x], "lr": getattr(rates, n)} for n, x in reference.items()], betas=(0.9, 0.99), eps=1e-15
    )
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        for n, x in reference.items():
            x.grad = torch.randn(x.shape, generator=generator, dtype=torch.float64)
            params.values[n].grad = x.grad.clone()
        params.step(rates)
        adam.step()
    for n, x in reference.items():
        # a few roundings a step: 20 steps · 10 roundings · 2⁻⁵³ of a value or a step of order one
        torch.testing.assert_close(params.values[n], x, rtol=0, atol=200 * 2**-53 * 5)


def test_project_bounds_size_and_anisotropy():
    params = Parameters(gaussians(100, scale=0.3))
    with torch.no_grad():
        params.values["log_scales"][:, 0] -= 5
    params.project(max_scale=0.2, max_ratio=8.0)
    s = params.values["log_scales"].exp()
    assert s.max() <= 0.2 * (1 + 1e-6) and (s.amax(1) / s.amin(1)).max() <= 8 * (1 + 1e-6)
    once = params.values["log_scales"].clone()
    params.project(max_scale=0.2, max_ratio=8.0)
    torch.testing.assert_close(params.values["log_scales"], once)


def test_clean_removes_haze_outsiders_and_loners():
    source = gaussians(300, scale=0.02, opacity=0.9)
    means, logits = 0.3 * source.means, source.logit_opacities.clone()
    logits[:5] = -4.0
    means[5:9] = torch.tensor([0.0, 0.0, 3.0])
    means[9] = torch.tensor([0.0, 0.0, 1.5])
    kept, removed = clean(
        Gaussians(means, source.quats, source.log_scales, logits, source.sh), min_opacity=0.1, radius=1.7, isolation=4.0
    )
    assert removed == {"transparent": 5, "outside": 4, "isolated": 1} and len(kept) == 290
