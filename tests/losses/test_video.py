"""Score distillation of a clip frame by frame: the gradient of the whole graph, and one frame's graph at a time."""

import copy
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch

from benchmarks.video_memory import saved_activations
from diffuphy.losses import sds
from diffuphy.losses.guidance.analytic import Analytic, Variants
from diffuphy.losses.guidance.latent import Networks
from diffuphy.losses.video import clip_latents, video_sds
from diffuphy.types import Motion

SIDE, ROWS = 8, 6


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def operands(frames, *, dtype=torch.float64, side=SIDE):
    """Two rows a frame, of unlike shape, as positions and deformations are."""
    g = generator()
    return (
        torch.randn(frames, ROWS, generator=g, dtype=dtype).requires_grad_(),
        torch.randn(frames, side, ROWS, generator=g, dtype=dtype).requires_grad_(),
    )


def draw(u, F):
    """A picture (S, S, 3) of a row each, neither linear nor separable."""
    colours = torch.tensor([0.5, 1.0, 2.0], dtype=u.dtype)
    return torch.sigmoid((F @ F.mT + F.sin() @ u)[..., None] * colours)


def pixels(frames, variants=1):
    """References of a clip."""
    return torch.rand(1, variants, frames, SIDE, SIDE, 3, generator=generator(1), dtype=torch.float64)


NOISE = torch.randn(1, 3, 3, SIDE, SIDE, generator=generator(5), dtype=torch.float64)
"""Of the latents of nine frames of ``Causal``."""


def whole(guidance, u, F, cond, **settings):
    """The same clip as one graph."""
    return sds(guidance, torch.stack([draw(a, b) for a, b in zip(u, F, strict=True)])[None], cond, **settings)


def gradients(scalar, rows):
    return torch.autograd.grad(1.7 * scalar, rows)  # a loss has a weight


@dataclass
class Causal:
    """A prior whose autoencoder mixes the frames of a clip, as those of Wan and CogVideoX do."""

    layout = "clip"
    encoded: list = field(default_factory=list)
    """Frames in each clip that was encoded, and whether for a gradient."""

    def encode(self, sample):
        self.encoded.append((sample.shape[1], torch.is_grad_enabled() and sample.requires_grad))
        past = torch.cumsum(torch.tanh(sample), 1)
        return (past * sample.roll(1, 1)).movedim(-1, 1)[:, :, ::4]

    def schedule(self, t):
        return torch.cos(t), torch.sin(t)

    def predict_noise(self, z_t, t, cond):
        return torch.sin(3 * z_t) + z_t.mean()


def test_gradient_is_that_of_the_whole_graph_to_the_bit():
    """Σ_f (∂z_f/∂u_f)ᵀ ∂L/∂z_f, whether one graph says it or T graphs: the same operations on the same numbers."""
    rows, t = operands(5), torch.tensor([0.6], dtype=torch.float64)
    references = pixels(5, variants=3)
    prior, cond = Analytic(layout="clip", s=0.4), Variants(references)
    ours = video_sds(prior, draw, rows, cond, t=t, generator=generator(2), weight="x0")
    theirs = whole(prior, *rows, cond, t=t, generator=generator(2), weight="x0")
    assert torch.equal(ours, theirs)
    for a, b in zip(gradients(ours, rows), gradients(theirs, rows), strict=True):
        assert torch.equal(a, b) and (a.flatten(1).norm(dim=1) > 0).all()


def test_clips_that_cannot_be_cut_are_encoded_whole_with_the_same_gradient():
    """One VJP through the autoencoder, after the denoiser; frames still drawn one by one. Float64: 1e-12 of the largest
    is four thousand roundings."""
    rows, prior = operands(9), Causal()
    settings = {"t": torch.tensor([0.6], dtype=torch.float64), "noise": NOISE}
    ours = gradients(video_sds(prior, draw, rows, None, **settings), rows)
    assert prior.encoded == [(9, False), (9, True)]
    for a, b in zip(ours, gradients(whole(Causal(), *rows, None, **settings), rows), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


def test_autoencoder_keeps_nothing_of_a_clip_while_the_denoiser_runs():
    """Kept are the rows and the pixels; one graph keeps tanh of each pixel as well, and what frames are drawn with."""
    rows, kept = operands(9), []
    settings = {"t": torch.tensor([0.6], dtype=torch.float64), "noise": NOISE}

    class Watched(Causal):
        def predict_noise(self, z_t, t, cond):
            kept.append(saved.now)
            return super().predict_noise(z_t, t, cond)

    with saved_activations() as saved:
        video_sds(Watched(), draw, rows, None, **settings)
    with saved_activations() as saved:
        whole(Watched(), *rows, None, **settings)
    ours, one_graph = kept
    assert ours <= 8 * (sum(r.numel() for r in rows) + 9 * SIDE * SIDE * 3)
    assert one_graph > 2 * ours


def test_no_two_frames_have_a_graph_at_the_same_time():
    """Nodes hold more than the tensors they save: counted are the nodes themselves, while they live."""
    alive, most, denoising = set(), [0], []

    class Node(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            class Held:
                def __init__(self):
                    alive.add(id(self))
                    most[0] = max(most[0], len(alive))

                def __del__(self):
                    alive.discard(id(self))

            ctx.held = Held()
            return x.clone()

        @staticmethod
        def backward(ctx, grad):
            return grad

    class Prior(Analytic):
        def predict_noise(self, z_t, t, cond):
            denoising.append(len(alive))
            return super().predict_noise(z_t, t, cond)

    rows, t = operands(7), torch.tensor([0.5])
    cond = Variants(pixels(7))
    loss = video_sds(Prior(layout="clip"), lambda u, F: Node.apply(draw(u, F)), rows, cond, t=t, generator=generator())
    assert denoising == [0]
    gradients(loss, rows)
    assert most == [1] and not alive


def test_rows_that_want_no_gradient_get_none_and_unused_ones_zero():
    u, F = operands(3)
    cond = Variants(pixels(3))
    settings = {"t": torch.tensor([0.5]), "generator": generator()}
    prior = Analytic(layout="clip")
    video_sds(prior, draw, (u, F.detach()), cond, **settings).backward()
    assert u.grad is not None and u.grad.any() and F.grad is None
    video_sds(prior, lambda u, F: draw(u.detach(), F), (u.detach().requires_grad_(), F), cond, **settings).backward()
    assert F.grad is not None and F.grad.any()
    unused = torch.zeros_like(u).requires_grad_()
    video_sds(prior, lambda a, b, c: draw(a, b), (u, F, unused), cond, **settings).backward()
    assert torch.equal(unused.grad, torch.zeros_like(u))


def test_without_gradients_the_value_is_the_same():
    rows, t = operands(4), torch.tensor([0.5])
    cond = Variants(pixels(4))
    with torch.no_grad():
        still = video_sds(Analytic(layout="clip"), draw, rows, cond, t=t, generator=generator())
    moving = video_sds(Analytic(layout="clip"), draw, rows, cond, t=t, generator=generator())
    assert torch.equal(still, moving) and not still.requires_grad and moving.requires_grad


def test_estimators_are_asked_about_the_latents_of_the_clip():
    """∂L/∂u of an estimator r(z) = z with w = 1 is that of ½‖z‖²."""

    def plain(guidance, z, cond, *, t, noise):
        return z

    rows, t = operands(4), torch.tensor([0.5])
    settings = {"weight": "unit", "estimator": plain, "generator": generator()}
    ours = gradients(video_sds(Analytic(layout="clip"), draw, rows, None, t=t, **settings), rows)
    clip = torch.stack([draw(a, b) for a, b in zip(*rows, strict=True)])
    for a, b in zip(ours, gradients(0.5 * (2 * clip - 1).square().sum(), rows), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-12, atol=1e-12)  # sums of float64 in another order


# ---------------------------------------------------------------------- what is refused
def test_a_gradient_that_would_be_lost_is_refused():
    """A frozen network may be forgotten: what a frame depends on beside its row would silently get no gradient."""
    tint = torch.ones(3, dtype=torch.float64, requires_grad=True)
    with pytest.raises(ValueError, match="no operand"):
        clip_latents(Analytic(layout="clip"), lambda u, F: draw(u, F) * tint, operands(2))


@pytest.mark.parametrize("lengths", [(3, 2), (0, 0)])
def test_frames_must_be_as_many_for_every_operand(lengths):
    rows = tuple(o.detach()[:n] for o, n in zip(operands(4), lengths, strict=True))
    with pytest.raises(ValueError, match="one row a frame"):
        clip_latents(Analytic(layout="clip"), draw, rows)


def test_errors_of_the_estimator_name_the_prior():
    class Broken(Analytic):
        def predict_noise(self, z_t, t, cond):
            return z_t * float("nan")

    with pytest.raises(FloatingPointError, match="Broken predicted"):
        video_sds(Broken(layout="clip"), draw, operands(2), None, t=torch.tensor([0.25]), generator=generator())


# ---------------------------------------------------------------------- the real autoencoder
@pytest.fixture(scope="module")
def modelscope(tmp_path_factory):
    pytest.importorskip("diffusers")
    pytest.importorskip("transformers")
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import tiny_models

    from diffuphy.losses.guidance.modelscope import ModelScope

    folder = tiny_models.modelscope(tmp_path_factory.mktemp("models") / "modelscope")
    prior = ModelScope(model=str(folder), size=32, dtype="float32", local_files_only=True)
    return prior, prior.condition(Motion("falling", "a burger falls"), None, torch.ones(3))


class Together:
    """``ModelScope`` with all frames of a clip in one batch of the autoencoder, as one graph, in any precision."""

    layout = "clip"

    def __init__(self, prior, dtype=torch.float32):
        unet, vae = prior.networks(torch.device("cpu"))
        self.unet, self.vae = copy.deepcopy(unet).to(dtype), copy.deepcopy(vae).to(dtype)
        self.prior, self.dtype = prior, dtype

    def encode(self, sample):
        z = (
            self.vae.encode(2 * sample[0].permute(0, 3, 1, 2).contiguous() - 1).latent_dist.mode()
            * self.vae.config.scaling_factor
        )
        return z.movedim(0, 1)[None]

    def networks(self, device):
        return Networks(self.unet, self.vae)

    def schedule(self, t):
        return self.prior.schedule(t)

    def predict_noise(self, z_t, t, cond):
        text = torch.cat([cond.negative, cond.positive]).to(self.dtype)
        k = (1000 * t).long().repeat(2)
        negative, positive = self.unet(torch.cat([z_t, z_t]), k, encoder_hidden_states=text).sample.chunk(2)
        return negative + self.prior.cfg * (positive - negative)


class Apart(Together):
    """The same, frame by frame."""

    frames_alone = True

    def encode(self, sample):
        return torch.cat([super(Apart, self).encode(sample[:, f : f + 1]) for f in range(sample.shape[1])], 2)


def clip_of(frames, dtype=torch.float32):
    noise = torch.randn(1, 4, frames, 4, 4, generator=generator(3), dtype=dtype)
    return operands(frames, dtype=dtype, side=32), {"t": torch.tensor([0.5]), "noise": noise}


def test_gradient_through_modelscope_is_that_of_one_graph(modelscope):
    """16 frames through both networks in float64. 1e-11 of the norm is 1e-13 for each of about ten layers, times the
    guidance scale of 100, which multiplies what rounding does to the latents."""
    prior, cond = modelscope
    rows, settings = clip_of(16, torch.float64)
    ours = gradients(video_sds(Apart(prior, torch.float64), draw, rows, cond, **settings), rows)
    theirs = gradients(whole(Together(prior, torch.float64), *rows, cond, **settings), rows)
    for a, b in zip(ours, theirs, strict=True):
        assert (a - b).norm() <= 1e-11 * b.norm()


def test_gradient_of_single_precision_is_that_of_frames_encoded_alone_to_the_bit(modelscope):
    """The very class a user loads: latents of a frame do not depend on when they are made."""
    prior, cond = modelscope
    rows, settings = clip_of(16)
    ours = gradients(video_sds(prior, draw, rows, cond, **settings), rows)
    for a, b in zip(ours, gradients(whole(prior, *rows, cond, **settings), rows), strict=True):
        assert torch.equal(a, b)


def test_single_precision_is_as_near_to_double_as_one_batch_is(modelscope):
    """A convolution over one frame sums in another order than over sixteen, and guidance multiplies the difference of
    the latents by its scale: two gradients of single precision agree to the error that each has. That of ours is no
    larger: the norm over 6000 numbers of as many roundings, so within a half of the other's."""
    prior, cond = modelscope
    rows, settings = clip_of(16)
    exact_rows = [r.detach().double().requires_grad_() for r in rows]
    exact_settings = settings | {"noise": settings["noise"].double()}
    ours = gradients(video_sds(prior, draw, rows, cond, **settings), rows)
    batch = gradients(whole(Together(prior), *rows, cond, **settings), rows)
    exact = gradients(whole(Together(prior, torch.float64), *exact_rows, cond, **exact_settings), exact_rows)
    for a, b, e in zip(ours, batch, exact, strict=True):
        assert 0 < (a - e).norm() < 1.5 * (b - e).norm() < 1e-4 * e.norm()


def test_saved_activations_do_not_grow_with_the_clip(modelscope):
    """Per frame more: its row, its pixels and a dozen latents at most, no activation; of 16 frames a tenth of one graph
    or less."""
    prior, cond = modelscope

    def peak(step, guidance, frames):
        rows, settings = clip_of(frames)
        with saved_activations(guidance.networks(rows[0].device).vae.parameters()) as saved:
            step(guidance, rows, settings).backward()
        return saved.peak

    def ours(guidance, rows, settings):
        return video_sds(guidance, draw, rows, cond, **settings)

    def one_graph(guidance, rows, settings):
        return whole(guidance, *rows, cond, **settings)

    row, picture, latent = sum(r[0].numel() for r in operands(1, side=32)), 32 * 32 * 3, 4 * 4 * 4
    assert peak(ours, prior, 16) - peak(ours, prior, 4) <= 12 * 4 * (row + picture + 12 * latent)
    assert peak(one_graph, Together(prior), 16) >= 10 * peak(ours, prior, 16)
