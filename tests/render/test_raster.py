"""The Warp rasteriser against the dense reference, against differences, and at its edges."""

import itertools
import math

import pytest
import torch
from torch import Tensor

from diffuphy.geometry import covariances
from diffuphy.render import Dense, Image, Rasteriser, Warp, orbit, rasterize
from diffuphy.render.project import composite, project
from diffuphy.types import Camera

try:
    from .ball import ball
except ImportError:
    from ball import ball

DRIVERS = [Warp(driver=d, tile=t) for d, t in itertools.product(("tile", "pixel"), (8, 32))]


def two_views(dtype: torch.dtype = torch.float64) -> Camera:
    camera = orbit([30.0, 200.0], [20.0, -10.0], 3.0, fov=40, width=48, height=40)
    return Camera(camera.viewmats.to(dtype), camera.Ks.to(dtype), 48, 40)


def draw(operands: dict[str, Tensor], camera: Camera, backend: Rasteriser) -> Image:
    return rasterize(
        **{k: v for k, v in operands.items() if k != "F"}, F=operands.get("F"), camera=camera, backend=backend
    )


def weighted_sum(image: Image) -> Tensor:
    """A loss that looks at colour, coverage and depth with fixed random weights."""
    g = torch.Generator().manual_seed(1)
    channels = torch.cat([image.rgb, image.alpha[..., None], image.depth[..., None]], dim=-1)
    return (channels * torch.randn(channels.shape, generator=g, dtype=torch.float64).to(channels)).sum()


def gradients(operands: dict[str, Tensor], camera: Camera, backend: Rasteriser) -> dict[str, Tensor]:
    leaves = {name: x.clone().requires_grad_() for name, x in operands.items()}
    grads = torch.autograd.grad(weighted_sum(draw(leaves, camera, backend)), list(leaves.values()))
    return dict(zip(leaves, grads, strict=True))


def scene(dtype: torch.dtype) -> dict[str, Tensor]:
    """300 Gaussians: most in view, some beside it, behind the camera, or so large that the image lies inside them."""
    operands = ball(300, dtype, size=2.5)
    operands["means"][:20] *= 6
    operands["scales"][20:23] *= 10
    return operands


@pytest.mark.parametrize("backend", DRIVERS, ids=lambda b: f"{b.driver}{b.tile}")
@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("per_view", [False, True])
def test_gradients_equal_the_reference(backend: Warp, deformed: bool, per_view: bool) -> None:
    """∂L/∂(means, quats, scales, F, opacities, colors) of kernels and autograd agree; L sees rgb, alpha and depth."""
    operands = scene(torch.float64)
    if not deformed:
        del operands["F"]
    if per_view:
        operands["colors"] = torch.stack([operands["colors"], operands["colors"].flip(0)])
    ours, theirs = (gradients(operands, two_views(), b) for b in (backend, Dense()))
    for name, expected in theirs.items():
        # rounding 1e-16, times 300 terms a pixel, times 1 / (1 - α_max) = 100: 1e-11
        assert (ours[name] - expected).norm() <= 1e-10 * expected.norm(), name


@pytest.mark.parametrize("backend", DRIVERS, ids=lambda b: f"{b.driver}{b.tile}")
def test_image_equals_the_reference(backend: Warp) -> None:
    """rgb, alpha, depth and means2d of kernels and reference agree."""
    operands = scene(torch.float64)
    ours, theirs = (draw(operands, two_views(), b) for b in (backend, Dense()))
    for name in ("rgb", "alpha", "depth", "means2d"):
        torch.testing.assert_close(getattr(ours, name), getattr(theirs, name), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("backend", DRIVERS, ids=lambda b: f"{b.driver}{b.tile}")
def test_float32_is_as_exact_as_its_rounding(backend: Warp) -> None:
    """Kernels in float32 against the reference in float64."""
    operands = scene(torch.float32)
    wide = {name: x.double() for name, x in operands.items()}
    image, expected = draw(operands, two_views(torch.float32), backend), draw(wide, two_views(), Dense())
    # 2 ulp on each of ≲ 100 terms of a pixel, plus 32²/2 ulp from the forward differences along a row of a tile: 6e-5.
    # A term at α = α_min may fall on either side of the cut: 1 / 255 at single pixels, of which there are at most a
    # few.
    off = (image.rgb - expected.rgb).abs()
    assert off.median() < 1e-6
    assert (off > 6e-5).float().mean() < 1e-3
    assert off.max() < 2 / 255
    ours, theirs = gradients(operands, two_views(torch.float32), backend), gradients(wide, two_views(), Dense())
    for name, exact in theirs.items():
        # the remaining colour loses 1e-7 of the whole, divided by 1 - α ≥ 0.01: 1e-5 a term
        assert (ours[name] - exact).norm() <= 2e-4 * exact.norm(), name


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors", "F"])
@pytest.mark.parametrize("driver", ["tile", "pixel"])
def test_gradients_equal_central_differences(name: str, driver: str) -> None:
    """∂L/∂x = (L(x + h) - L(x - h)) / 2h + O(h²), with the cuts so low that L is smooth."""
    backend = Warp(driver=driver, alpha_min=1e-14, T_min=0.0, alpha_max=1 - 1e-9)
    operands = ball(40)
    camera = two_views()
    gradient = gradients(operands, camera, backend)[name].flatten()
    h = 1e-6
    g = torch.Generator().manual_seed(2)
    for k in torch.randperm(gradient.numel(), generator=g)[:12].tolist():
        values = []
        for step in (h, -h):
            moved = operands | {name: operands[name].clone()}
            moved[name].view(-1)[k] += step
            values.append(weighted_sum(draw(moved, camera, backend)).item())
        # h² times a third derivative of the size of the gradient, and 1e-16 |L| / h with |L| ≲ 1e2
        assert abs((values[0] - values[1]) / (2 * h) - gradient[k].item()) <= 1e-6 * gradient.abs().max().item()


def test_threads_and_runs_do_not_change_a_bit() -> None:
    """Image and gradients are bit-identical for one thread, two threads, and a second run."""
    operands = scene(torch.float32)
    camera = two_views(torch.float32)
    results = []
    for threads in (1, 2, 2):
        backend = Warp(threads=threads)
        results.append([draw(operands, camera, backend).rgb, *gradients(operands, camera, backend).values()])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_views_are_independent() -> None:
    """Drawing two cameras at once is drawing each alone."""
    operands, camera = scene(torch.float64), two_views()
    both = draw(operands, camera, Warp())
    for c in range(2):
        assert torch.equal(both.rgb[c], draw(operands, camera[c : c + 1], Warp()).rgb[0])


def test_order_of_the_gaussians_does_not_matter() -> None:
    """The image is that of any permutation of the Gaussians, as all depths differ."""
    operands, camera = scene(torch.float64), two_views()
    shuffle = torch.randperm(300, generator=torch.Generator().manual_seed(3))
    shuffled = {name: x[shuffle] for name, x in operands.items()}
    assert torch.equal(draw(operands, camera, Warp()).rgb, draw(shuffled, camera, Warp()).rgb)


@pytest.mark.parametrize("driver", ["tile", "pixel"])
def test_bounds_cut_exactly_at_alpha_min(driver: str) -> None:
    """A pixel is touched if and only if o exp(-½ dᵀ Q d) ≥ α_min, for needles and discs, bright and faint."""
    g = torch.Generator().manual_seed(4)
    camera = two_views()[:1]
    drawn = 0
    for k in range(20):
        scales = torch.exp(torch.empty(1, 3, dtype=torch.float64).uniform_(-7, 0, generator=g))
        operands = {
            "means": torch.empty(1, 3, dtype=torch.float64).uniform_(-0.7, 0.7, generator=g),
            "quats": torch.randn(1, 4, generator=g, dtype=torch.float64),
            "scales": scales,
            "opacities": torch.tensor([(0.005, 0.05, 0.5, 1.0)[k % 4]], dtype=torch.float64),
            "colors": torch.ones(1, 3, dtype=torch.float64),
        }
        touched = draw(operands, camera, Warp(driver=driver)).alpha > 0
        # the reference cuts at each pixel, not at a box
        expected = draw(operands, camera, Dense()).alpha > 0
        assert torch.equal(touched, expected)
        drawn += int(expected.any())
    assert drawn >= 10  # a faint speck between four pixel centres touches none


def test_coverage_of_one_gaussian_is_its_integral() -> None:
    """Σ_pixels α = 2π √det Σ₂ (o - α_min): the integral above the cut, by the midpoint rule."""
    one = torch.float64
    camera = two_views()[:1]
    operands = {
        "means": torch.zeros(1, 3, dtype=one),
        "quats": torch.tensor([[1.0, 0, 0, 0]], dtype=one),
        "scales": torch.full((1, 3), 0.1, dtype=one),
        "opacities": torch.tensor([0.8], dtype=one),
        "colors": torch.ones(1, 3, dtype=one),
    }
    f, distance = camera.Ks[0, 0, 0].item(), 3.0
    variance = (f * 0.1 / distance) ** 2 + 0.3
    expected = 2 * math.pi * variance * (0.8 - 1 / 255)
    # The rim where α jumps from α_min to 0 has about 2π · 6 px · 3 crossings; each errs by less than α_min / 2, at
    # random
    total = draw(operands, camera, Warp()).alpha.sum().item()
    assert total == pytest.approx(expected, abs=math.sqrt(2 * math.pi * 18) / 255)


def test_means2d_gradient_is_kept_for_densification() -> None:
    """After a backward pass image.means2d.grad is ∂L/∂(projected centre) at fixed Σ₂ and depth."""
    operands, camera = scene(torch.float64), two_views()[:1]
    leaves = operands | {"means": operands["means"].clone().requires_grad_()}
    image = draw(leaves, camera, Warp())
    weighted_sum(image).backward()

    Sigma = covariances(operands["quats"], operands["scales"], operands["F"])
    means2d, covariances2d, z = project(operands["means"], Sigma, camera.viewmats[0], camera.Ks[0], (48, 40), 0.3)
    order = torch.argsort(z)
    order = order[z[order] > 0.01]
    means2d.requires_grad_()
    features, alpha = composite(
        means2d[order],
        covariances2d[order],
        torch.cat([operands["colors"], z[:, None]], dim=1)[order],
        operands["opacities"][order],
        (48, 40),
        (1 / 255, 0.99, 1e-4),
    )
    weighted_sum(Image(features[None, ..., :3], alpha[None], features[None, ..., 3], means2d)).backward()
    assert image.means2d.grad.shape == (1, 300, 2)
    assert (image.means2d.grad[0] - means2d.grad).norm() <= 1e-10 * means2d.grad.norm()


@pytest.mark.parametrize("driver", ["tile", "pixel"])
def test_an_empty_scene_is_transparent(driver: str) -> None:
    """G = 0: black, no coverage, and an empty gradient."""
    operands = {name: x[:0].requires_grad_() for name, x in ball(1).items()}
    image = draw(operands, two_views(), Warp(driver=driver))
    assert image.rgb.shape == (2, 40, 48, 3) and image.means2d.shape == (2, 0, 2)
    assert not image.rgb.any() and not image.alpha.any() and not image.depth.any()
    weighted_sum(image).backward()
    assert operands["means"].grad.shape == (0, 3)


@pytest.mark.parametrize("driver", ["tile", "pixel"])
def test_what_is_behind_the_camera_is_not_drawn(driver: str) -> None:
    """Gaussians with depth ≤ near leave image and gradient exactly zero."""
    operands = ball(50)
    camera = two_views()[:1]
    eye = -camera.viewmats[0, :3, :3].T @ camera.viewmats[0, :3, 3]
    operands["means"] = operands["means"] + 3 * eye
    leaves = {name: x.requires_grad_() for name, x in operands.items()}
    image = draw(leaves, camera, Warp(driver=driver))
    weighted_sum(image).backward()
    assert not image.rgb.any() and not image.alpha.any()
    assert all(not x.grad.any() for x in leaves.values())


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors", "F"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_named(name: str, value: float) -> None:
    operands = ball(10, torch.float32)
    operands[name].view(10, -1)[7, 0] = value
    with pytest.raises(ValueError, match=rf"{name}\[7.*{value}"):
        draw(operands, two_views(torch.float32), Warp())


def test_errors_say_what_to_change() -> None:
    operands, camera = ball(10), two_views()

    def with_(**changed: Tensor) -> None:
        draw(operands | changed, camera, Warp())

    with pytest.raises(ValueError, match=r"scales must have shape \(10, 3\), got \(9, 3\)"):
        with_(scales=operands["scales"][:9])
    with pytest.raises(ValueError, match=r"colors must have shape \(10, 3\) or \(2, 10, 3\), got \(3, 10, 3\)"):
        with_(colors=operands["colors"].expand(3, 10, 3))
    with pytest.raises(ValueError, match=r"F must be torch\.float64"):
        with_(F=operands["F"].float())
    with pytest.raises(ValueError, match=r"opacities\[3\] must be in \[0, 1\], got 1.5"):
        with_(opacities=operands["opacities"].index_fill(0, torch.tensor(3), 1.5))
    with pytest.raises(ValueError, match=r"quats\[4\] has length zero"):
        with_(quats=operands["quats"].index_fill(0, torch.tensor(4), 0.0))
    with pytest.raises(ValueError, match="driver must be"):
        Warp(driver="fast")
    with pytest.raises(ValueError, match="alpha_min"):
        Warp(alpha_min=0.0)


def test_background_shows_where_nothing_covers_it() -> None:
    """over(b) = rgb + (1 - alpha) b."""
    image = draw(scene(torch.float64), two_views(), Warp())
    background = torch.tensor([0.2, 0.4, 0.6], dtype=torch.float64)
    torch.testing.assert_close(image.over(background), image.rgb + (1 - image.alpha)[..., None] * background)


def test_needles_do_not_lose_their_width_in_float32() -> None:
    """det Σ₂ as a sum of positive terms: a needle 10⁴ px long and √0.3 px wide keeps α ≤ o along its axis and
    vanishes beside it."""
    camera = two_views(torch.float32)[:1]
    for angle in (0.3, 0.8, 1.3):
        narrow = {
            "means": torch.zeros(1, 3),
            "quats": torch.tensor([[math.cos(angle), 0.0, math.sin(angle), 0.0]]),
            "scales": torch.tensor([[300.0, 1e-4, 1e-4]]),
            "opacities": torch.tensor([0.9]),
            "colors": torch.ones(1, 3),
        }
        wide = {name: x.double() for name, x in narrow.items()}
        image, exact = draw(narrow, camera, Warp()), draw(wide, two_views()[:1], Dense())
        covered = exact.alpha > 0.05
        # the exponent is a difference of terms up to (24 px)² / 0.3 px² ~ 2e3: 2e3 · 1e-7 of rounding
        torch.testing.assert_close(image.alpha[covered], exact.alpha[covered].float(), rtol=2e-3, atol=2e-3)
