"""Point-E as a guidance and as a sampler, on tiny checkpoints in the layout of the published ones."""

import itertools
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch

pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[2]))
import tiny_models

from diffuphy.losses import sds
from diffuphy.losses.guidance.memory import PointFootprint
from diffuphy.losses.guidance.point_e import Features, PointE
from diffuphy.losses.schedules import cosine, linear_betas
from diffuphy.models import MissingWeights
from diffuphy.render import orbit
from diffuphy.types import Look, Motion

LOOK = Look("corgi", "a corgi")
WHITE = torch.ones(3)
PAINTED: list[int] = []


@dataclass(frozen=True)
class Painter:
    """Four random pictures; counts how often it was asked."""

    side: int = 40

    def pictures(self, words, camera, generator):
        PAINTED.append(len(camera))
        return torch.rand(len(camera), self.side, self.side, 3, generator=generator)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("points")
    tiny_models.clip(root / "clip")
    tiny_models.point_e(root / "none.pt", kind="none")
    tiny_models.point_e(root / "vector.pt")
    tiny_models.point_e(root / "grid.pt", kind="grid", features=32)
    tiny_models.point_e(root / "upsample.pt", kind="grid", features=32, upsampler=True)
    return root


def prior(folder, kind="vector", **settings):
    defaults = {"clip": str(folder / "clip"), "local_files_only": True, "points": 12, "added": 20, "steps": 4}
    return PointE(**{"checkpoint": str(folder / f"{kind}.pt"), **defaults, **settings})


def cameras():
    return orbit([0.0, 90.0, 180.0, 270.0], 15.0, 3.4, width=40, height=40)


def clouds(batch=2, n=12, seed=0):
    g = torch.Generator().manual_seed(seed)
    return torch.cat([torch.randn(batch, n, 3, generator=g), torch.rand(batch, n, 3, generator=g)], -1)


# ---------------------------------------------------------------------- conditions
def test_a_vector_network_reads_the_text(folder):
    """The unit embedding of CLIP's text tower, by hand."""
    from transformers import CLIPModel, CLIPTokenizer

    cond = prior(folder).condition(LOOK, cameras(), WHITE)
    clip, words = (c.from_pretrained(folder / "clip") for c in (CLIPModel, CLIPTokenizer))
    ids = words([LOOK.text], padding="max_length", max_length=77, return_tensors="pt").input_ids
    vector = clip.get_text_features(input_ids=ids).pooler_output
    # the same layers in float32: rounding
    torch.testing.assert_close(cond.views, vector / vector.norm(dim=1, keepdim=True), rtol=0, atol=1e-6)


def test_a_grid_network_sees_the_patches_of_the_painted_views(folder):
    """Hidden states after the last block, before the last layer norm and without the class token; pictures of the
    network's own size are only normalised."""
    from transformers import CLIPModel

    p = prior(folder, "grid", painter=Painter(32))
    cond = p.condition(LOOK, cameras(), WHITE, generator=torch.Generator().manual_seed(0))
    rgb = torch.rand(4, 32, 32, 3, generator=torch.Generator().manual_seed(p.seed)).permute(0, 3, 1, 2)
    mean = torch.tensor([0.48145466, 0.4578275, 0.40821073]).view(3, 1, 1)
    std = torch.tensor([0.26862954, 0.26130258, 0.27577711]).view(3, 1, 1)
    clip = CLIPModel.from_pretrained(folder / "clip").vision_model
    states = clip((rgb - mean) / std, output_hidden_states=True).hidden_states[-1]
    assert cond.views.shape == (4, 16, 32) and sorted(cond.order) == [0, 1, 2, 3]
    # the same layers in float32: rounding
    torch.testing.assert_close(cond.views, states[:, 1:], rtol=0, atol=1e-5)


def test_views_are_painted_once_and_the_same_for_the_same_seed(folder):
    PAINTED.clear()
    p = prior(folder, "grid", painter=Painter())
    g = torch.Generator().manual_seed(0)
    first, *rest = (p.condition(LOOK, cameras(), WHITE, generator=g) for _ in range(8))
    assert PAINTED == [4] and all(torch.equal(first.views, c.views) for c in rest)
    assert len({c.order for c in (first, *rest)}) > 1  # another view first
    again = prior(folder, "grid", painter=Painter()).condition(LOOK, cameras(), WHITE, generator=g)
    other = prior(folder, "grid", painter=Painter(), seed=1).condition(LOOK, cameras(), WHITE, generator=g)
    assert torch.equal(first.views, again.views) and not torch.equal(first.views, other.views)
    p.condition(replace(LOOK, text="a cat"), cameras(), WHITE, generator=g)
    p.condition(LOOK, cameras()[[0, 1]], WHITE, generator=g)
    assert PAINTED[-2:] == [4, 2]  # other words or cameras: other pictures


def test_one_view_a_step_is_unbiased_for_the_mean_over_views(folder):
    """Σ over first views of ε̂/V = ε̂_∅ + s (mean_v ε̂_v − ε̂_∅)."""
    p = prior(folder, "grid", painter=Painter(), cfg=3.0)
    views = p.condition(LOOK, cameras(), WHITE, generator=torch.Generator().manual_seed(0)).views
    z, t = torch.randn(1, 12, 6, generator=torch.Generator().manual_seed(1)), torch.tensor([0.5])
    seen = torch.stack([p.predict_noise(z, t, Features(views, (v,))) for v in range(4)]).mean(0)
    network, k = p.network(z.device), torch.tensor([512])
    without = network(z, k, torch.zeros(1, 16, 32))[..., :6]
    given = torch.stack([network(z, k, views[v : v + 1])[..., :6] for v in range(4)]).mean(0)
    # float32 rounding of a sum of four, three times as large
    torch.testing.assert_close(seen, without + 3 * (given - without), rtol=0, atol=1e-5)


def test_what_a_checkpoint_cannot_use_is_refused(folder):
    with pytest.raises(ValueError, match=r"painter.*base_40m_textvec"):
        prior(folder, "grid").condition(LOOK, cameras(), WHITE)
    with pytest.raises(ValueError, match="a painter paints a Look"):
        prior(folder, "grid", painter=Painter()).condition(Motion("falling", "x"), cameras(), WHITE)
    with pytest.raises(ValueError, match=r"torch\.Generator"):
        prior(folder, "grid", painter=Painter()).condition(LOOK, cameras(), WHITE)
    with pytest.raises(ValueError, match="is the upsampler"):
        prior(folder, "upsample", painter=Painter()).condition(LOOK, cameras(), WHITE)
    with pytest.raises(ValueError, match=r"clouds \(B, N, 6\)"):
        prior(folder).encode(torch.zeros(1, 4, 3))
    with pytest.raises(ValueError, match="at one place"):
        prior(folder).encode(torch.zeros(1, 4, 6))


def test_missing_weights_say_in_one_line_what_to_do(folder, tmp_path):
    for name, there in (
        ("checkpoint", str(tmp_path / "no.pt")), ("checkpoint", ""), ("checkpoint", "base_300m.pt"),
        ("clip", str(tmp_path / "no")), ("clip", "nobody/no-such-model"),
    ):  # fmt: skip
        with pytest.raises(MissingWeights) as error:
            replace(prior(folder), **{name: there}).condition(LOOK, cameras(), WHITE)
        message = str(error.value)
        assert "\n" not in message and f"fit.shape.guidance.{name}=" in message and there in message


@pytest.mark.parametrize(
    "wrong", [{"cfg": -1.0}, {"steps": 1}, {"points": 0}, {"dtype": "float64"}, {"churn": -1.0}, {"added": 0}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError):
        PointE(**wrong)


def test_memory_is_told_before_weights_are_read(folder):
    """Weights: the bytes of the file's tensors, halved in half precision. Work: at least the widest layer of the
    perceptron before and after its GELU, 2 · 4 width numbers of every token of both rows, and less than ten times that.
    A painter adds what it takes itself, first."""
    state = torch.load(folder / "grid.pt", weights_only=True)
    size = sum(x.numel() * 4 for x in state.values())
    told = prior(folder, "grid", painter=Painter(), points=100).footprint(1)
    widest = 2 * 4 * 64 * 2 * (1 + 256 + 100) * 4
    assert told.network == size and widest <= told.working < 10 * widest and told.painting == 0
    half = prior(folder, "grid", painter=Painter(), points=100, dtype="float16").footprint(1)
    assert half.network == size // 2 and half.working < told.working

    class Large(Painter):
        def footprint(self, count):
            return PointFootprint(10 * size, 0, 0)

    assert prior(folder, "grid", painter=Large()).footprint(1).peak == 10 * size
    with pytest.raises(MissingWeights):
        prior(folder, checkpoint="base_1b.pt").footprint(1)


# ---------------------------------------------------------------------- latents and gradient
def test_latents_are_the_models_cube_and_frame(folder):
    """Wherever a cloud is and however large: the longest side from −1 to 1, our front (+x) at the model's −y, z up."""
    p = prior(folder)
    sample = clouds()
    moved = torch.cat([7 * sample[..., :3] + torch.tensor([1.0, -2.0, 3.0]), sample[..., 3:]], -1)
    z = p.encode(moved)
    # float32 of coordinates up to 30 over sides of 30: a few eps
    torch.testing.assert_close(z, p.encode(sample), rtol=0, atol=1e-5)
    size = z[..., :3].amax(1) - z[..., :3].amin(1)
    torch.testing.assert_close(size.amax(1), torch.full((2,), 2.0))
    assert z[..., 3:].min() >= -1 and z[..., 3:].max() <= 1

    axes = torch.tensor([[[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0], [0, 0, -1.0]]])
    turned = p.encode(torch.cat([axes, torch.zeros_like(axes)], -1))[0, :, :3]
    expected = torch.tensor([[0, -1.0, 0], [0, 1.0, 0], [1.0, 0, 0], [-1.0, 0, 0], [0, 0, 1.0], [0, 0, -1.0]])
    torch.testing.assert_close(turned, expected, rtol=0, atol=1e-6)  # cos 90° in float64 is 6e-17, in float32 products


@pytest.mark.parametrize("kind", ["none", "vector", "grid"])
def test_sds_gradient_is_that_of_the_formula(folder, kind):
    """∂L/∂x = R w(t) (ε̂ − ε)/r and ∂L/∂rgb = 2 w(t) (ε̂ − ε), by autograd through ½‖z − (z − w (ε̂ − ε))‖² written out,
    with the network called by hand for each cloud and condition."""
    p = prior(folder, kind, painter=Painter() if kind == "grid" else None, cfg=7.5)
    cond = p.condition(LOOK, cameras(), WHITE, generator=torch.Generator().manual_seed(0))
    g = torch.Generator().manual_seed(1)
    t, noise = torch.tensor([0.3001, 0.9001]), torch.randn(2, 12, 6, generator=g)
    ours = clouds().requires_grad_()
    sds(p, ours, cond, t=t, noise=noise).backward()

    theirs, network = clouds().double().requires_grad_(), p.network(WHITE.device)
    total = 0.0
    for b, k in enumerate((307, 921)):
        x, rgb = theirs[b, :, :3], theirs[b, :, 3:]
        x = torch.stack([x[:, 1], -x[:, 0], x[:, 2]], 1)  # our +x is the model's −y
        low, high = x.detach().amin(0), x.detach().amax(0)
        z = torch.cat([(x - (low + high) / 2) / ((high - low).max() / 2), 2 * rgb - 1], 1)
        a = cosine()[k]
        with torch.no_grad():
            z_t = (a.sqrt() * z + (1 - a).sqrt() * noise[b]).float()[None]
            step = torch.tensor([k])
            if kind == "none":
                prediction = network(z_t, step)
            else:
                given = cond.views[cond.order[b % len(cond.order)]][None]
                without = network(z_t, step, torch.zeros_like(given))
                prediction = without + 7.5 * (network(z_t, step, given) - without)
            residual = (1 - a) * (prediction[0, :, :6].double() - noise[b])
        total = total + 0.5 * (z - (z - residual).detach()).square().sum()
    total.backward()
    # one float32 network on another batch, a guidance scale of 7.5: 1e-5 of the largest
    torch.testing.assert_close(ours.grad.double(), theirs.grad, rtol=0, atol=1e-5 * theirs.grad.abs().max().item())


@pytest.mark.parametrize(("dtype", "eps"), [("bfloat16", 2**-8), ("float16", 2**-11)])
def test_half_precision_keeps_the_gradient(folder, dtype, eps):
    """Latents and injection stay float32: what is lost is the network's rounding, a few eps times its depth, not the
    small difference ε̂ − ε."""
    grads = []
    for d in ("float32", dtype):
        p, x = prior(folder, dtype=d, cfg=1.0), clouds().requires_grad_()
        noise = torch.randn(2, 12, 6, generator=torch.Generator().manual_seed(1))
        sds(p, x, p.condition(LOOK, cameras(), WHITE), t=torch.tensor([0.4, 0.6]), noise=noise).backward()
        grads.append(x.grad)
    # two blocks of four roundings each
    assert (grads[1] - grads[0]).norm() < 8 * eps * grads[0].norm()


# ---------------------------------------------------------------------- sampling
class Known(torch.nn.Module):
    """Answers with the noise of one cloud: z = √ᾱ x₀ + √(1 − ᾱ) ε."""

    def __init__(self, clean, alpha_bar, kind, upsampler=False):
        super().__init__()
        self.clean, self.alpha_bar, self.kind, self.upsampler = clean, alpha_bar, kind, upsampler
        self.input_proj, self.features, self.coarse, self.rows = torch.nn.Linear(6, 64), 24, None, []

    def forward(self, x, t, condition=None, coarse=None):
        a = self.alpha_bar[t].to(x).view(-1, 1, 1)
        self.coarse = coarse
        self.rows.append(condition)
        noise = (x - a.sqrt() * self.clean) / (1 - a).sqrt()
        return torch.cat([noise, torch.zeros_like(noise)], -1)


def test_the_sampler_finds_the_cloud_that_the_networks_know(folder):
    """Both stages, each with its own schedule: the cloud comes back turned to our frame, colours in [0, 1]; the
    upsampler sees the coarse cloud in positions of ±½ and colours of 0 to 255."""
    g = torch.Generator().manual_seed(0)
    coarse, fine = (2 * torch.rand(n, 6, generator=g) - 1 for n in (12, 20))
    p = prior(folder, upsampler="u.pt", steps=16)
    p._memory["checkpoint"] = Known(coarse, cosine(), "none")
    upsampler = Known(fine, linear_betas(), "grid", upsampler=True)
    p._memory["upsampler"] = upsampler
    points, colours = p.sample(LOOK, cameras(), torch.Generator().manual_seed(1))
    z = torch.cat([coarse, fine])
    assert len(points) == p.count == 32
    # steps are integers, so x₀ is exact only up to float32 of σ = 160 · eps at the start, forgotten on the way down
    torch.testing.assert_close(points, torch.stack([-z[:, 1], z[:, 0], z[:, 2]], 1), rtol=0, atol=1e-3)
    torch.testing.assert_close(colours, (z[:, 3:] + 1) / 2, rtol=0, atol=1e-3)
    expected = torch.cat([coarse[:, :3] / 2, (coarse[:, 3:] + 1) / 2 * 255], 1)
    torch.testing.assert_close(upsampler.coarse[0], expected, rtol=0, atol=0.2)  # 1e-3 of 255
    assert all(not c.any() and c.shape == (1, 256, 24) for c in upsampler.rows)  # told nothing: zeros, one row


def test_schedules_are_the_published_ones():
    """ᾱ of a cosine: f(k + 1)/f(0) while β < 0.999; linear: log ᾱ = Σ log(1 − β). Both start near 1 and end near 0."""
    s = (torch.arange(1, 1024, dtype=torch.float64) / 1024 + 0.008) / 1.008 * math.pi / 2
    f = torch.cos(s) ** 2 / math.cos(0.008 / 1.008 * math.pi / 2) ** 2
    torch.testing.assert_close(cosine()[:1023], f, rtol=1e-10, atol=0)  # a product of 1023 float64 ratios
    assert cosine()[1023] == pytest.approx(cosine()[1022].item() * 0.001)
    betas = [(1e-4 + k / 1023 * (2e-2 - 1e-4)) * 1000 / 1024 for k in range(1024)]
    assert linear_betas()[-1].log().item() == pytest.approx(sum(math.log(1 - b) for b in betas))


def test_clouds_depend_on_the_seed_and_on_nothing_else(folder):
    state = torch.random.get_rng_state()
    p = prior(folder, upsampler=str(folder / "upsample.pt"))
    first, again, other = (p.sample(LOOK, cameras(), torch.Generator().manual_seed(s)) for s in (0, 0, 1))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True)) and not torch.equal(first[0], other[0])
    assert torch.equal(state, torch.random.get_rng_state())
    assert first[0].shape == (32, 3) and first[1].min() >= 0 and first[1].max() <= 1


def test_several_views_are_looked_at_together(folder):
    """One row without a condition and one a view, the mean of which is guided."""
    known = Known(2 * torch.rand(12, 6, generator=torch.Generator().manual_seed(0)) - 1, cosine(), "grid")
    p = prior(folder, "grid", painter=Painter())
    p._memory["checkpoint"] = known
    p.sample(LOOK, cameras(), torch.Generator().manual_seed(1))
    assert all(len(c) == 5 and not c[0].any() for c in known.rows)
    assert all(not torch.equal(a, b) for a, b in itertools.pairwise(known.rows[0]))
