"""The real backends, end to end, on tiny checkpoints of the very classes they load."""

import gc
import subprocess
import sys
import weakref
from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[1]))

from diffuphy.losses import sds
from diffuphy.losses.guidance import MissingWeights
from diffuphy.losses.guidance.modelscope import ModelScope
from diffuphy.losses.guidance.prediction import to_epsilon
from diffuphy.losses.guidance.stable_diffusion import StableDiffusion
from diffuphy.render import orbit
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.init import SurfaceCloud
from diffuphy.types import Look, Motion

LOOK = Look("burger", "a photo of a burger", negative="ugly")
WHITE = torch.ones(3)


def image_prior(root, prediction="epsilon", **settings):
    return StableDiffusion(
        model=str(root / f"sd-{prediction}"), size=64, dtype="float32", local_files_only=True, **settings
    )


def camera(n=2):
    return orbit([0.0, 180.0][:n], [0.0, 0.0][:n], 3.0, width=48, height=48)


@pytest.mark.parametrize("prediction", ["epsilon", "v_prediction"])
@pytest.mark.parametrize("cfg", [1.0, 7.5])
def test_sds_gradient_is_that_of_the_pipeline_written_out(checkpoints, prediction, cfg):
    """∂L/∂image = Jᵀ_VAE σ² (ε̂ − ε), with ε̂ from the checkpoint's networks and diffusers' own scheduler called by
    hand."""
    from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
    from transformers import CLIPTextModel, CLIPTokenizer

    prior = image_prior(checkpoints, prediction, cfg=cfg)
    g = torch.Generator().manual_seed(0)
    image = torch.rand(2, 64, 64, 3, generator=g)
    t, noise = torch.tensor([0.3005, 0.7005]), torch.randn(2, 4, 8, 8, generator=g)
    ours = image.clone().requires_grad_()
    sds(prior, ours, prior.condition(LOOK, camera(), WHITE), t=t, noise=noise).backward()

    model = str(checkpoints / f"sd-{prediction}")
    unet, vae = (
        UNet2DConditionModel.from_pretrained(model, subfolder="unet"),
        AutoencoderKL.from_pretrained(model, subfolder="vae"),
    )
    words, text = (
        CLIPTokenizer.from_pretrained(model, subfolder="tokenizer"),
        CLIPTextModel.from_pretrained(model, subfolder="text_encoder"),
    )
    scheduler = DDIMScheduler.from_pretrained(model, subfolder="scheduler")
    theirs = image.clone().requires_grad_()
    z = vae.encode(2 * theirs.permute(0, 3, 1, 2) - 1).latent_dist.mean * vae.config.scaling_factor
    k = torch.tensor([300, 700])
    with torch.no_grad():
        z_t = scheduler.add_noise(z, noise, k)
        prompts = ["a photo of a burger, front view", "a photo of a burger, back view", "ugly", "ugly"]
        ids = words(prompts, padding="max_length", max_length=77, return_tensors="pt").input_ids
        states = text(ids).last_hidden_state
        output = unet(z_t, k, states[:2]).sample, unet(z_t, k, states[2:]).sample
        a, s = (
            x[k].view(-1, 1, 1, 1) for x in (scheduler.alphas_cumprod.sqrt(), (1 - scheduler.alphas_cumprod).sqrt())
        )
        positive, negative = output if prediction == "epsilon" else (a * o + s * z_t for o in output)
        grad = s**2 * (negative + cfg * (positive - negative) - noise)
    z.backward(grad)
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=0, atol=1e-5 * theirs.grad.abs().max().item())


def test_clip_gradient_reaches_every_frame_and_equals_the_whole_clip_graph(checkpoints):
    """Frame by frame recomputation changes memory, not the gradient: Σ_f J_fᵀ g_f against one graph over all frames."""
    prior = ModelScope(model=str(checkpoints / "modelscope"), size=32, dtype="float32", local_files_only=True)
    g = torch.Generator().manual_seed(0)
    clip = torch.rand(1, 5, 32, 32, 3, generator=g)
    noise, t = torch.randn(1, 4, 5, 4, 4, generator=g), torch.tensor([0.5])
    x = clip.clone().requires_grad_()
    cond = prior.condition(Motion("falling", "a burger falls"), camera(1), WHITE)
    sds(prior, x, cond, t=t, noise=noise).backward()
    assert (x.grad.flatten(2).norm(dim=2) > 0).all()

    with torch.no_grad():
        z = prior.encode(clip)
        alpha, sigma = prior.schedule(t)
        grad = sigma**2 * (prior.predict_noise(alpha * z + sigma * noise, t, cond) - noise)
    y = clip.clone().requires_grad_()
    vae = prior.networks(clip.device).vae
    whole = vae.encode(2 * y[0].permute(0, 3, 1, 2) - 1).latent_dist.mean * vae.config.scaling_factor  # (T, 4, 4, 4)
    whole.backward(grad[0].movedim(1, 0))
    torch.testing.assert_close(
        x.grad, y.grad, rtol=0, atol=1e-4 * y.grad.abs().max().item()
    )  # float32, another batch size


def test_pictures_of_any_size_are_resized(checkpoints):
    prior = image_prior(checkpoints)
    picture = torch.rand(1, 48, 40, 3, requires_grad=True)
    z = prior.encode(picture)
    z.sum().backward()
    assert z.shape == (1, 4, 8, 8) and z.dtype == torch.float32 and picture.grad.abs().min() >= 0 and picture.grad.any()


def test_view_words_and_negative_reach_the_condition(checkpoints):
    """Opposite sides have different texts, the same side the same; settings' negative words join the prompt's."""
    prior = image_prior(checkpoints)
    cond = prior.condition(LOOK, camera(), WHITE)
    assert not torch.equal(cond.positive[0], cond.positive[1])
    plain = image_prior(checkpoints, view_words=False).condition(LOOK, camera(), WHITE)
    assert torch.equal(plain.positive[0], plain.positive[1])
    more = image_prior(checkpoints, negative="blurry").condition(LOOK, camera(), WHITE)
    assert torch.equal(cond.positive, more.positive) and not torch.equal(cond.negative, more.negative)


def test_text_encoder_is_freed_and_embeddings_are_remembered(checkpoints, monkeypatch):
    """After the words are embedded no CLIPTextModel is alive, and asking again loads none."""
    from transformers import CLIPTextModel

    alive = []
    load = CLIPTextModel.from_pretrained

    def watched(*args, **kwargs):
        model = load(*args, **kwargs)
        alive.append(weakref.ref(model))
        return model

    monkeypatch.setattr(CLIPTextModel, "from_pretrained", watched)
    prior = image_prior(checkpoints)
    first = prior.condition(LOOK, camera(), WHITE)
    gc.collect()
    assert len(alive) == 1 and alive[0]() is None
    assert torch.equal(first.positive, prior.condition(LOOK, camera(), WHITE).positive) and len(alive) == 1


def test_nothing_is_loaded_before_it_is_needed(checkpoints):
    """A guidance is settings until a sample comes: a fresh interpreter that builds both has neither library loaded."""
    code = (
        "import sys; from diffuphy.losses.guidance.stable_diffusion import StableDiffusion; "
        "from diffuphy.losses.guidance.modelscope import ModelScope; StableDiffusion(); ModelScope(); "
        "sys.exit(any(m in sys.modules for m in ('diffusers', 'transformers')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("backend", [StableDiffusion, ModelScope])
def test_missing_weights_say_in_one_line_what_to_do(backend, tmp_path):
    for model in ("nobody/no-such-model", str(tmp_path / "nowhere")):
        with pytest.raises(MissingWeights) as error:
            backend(model=model, local_files_only=True).encode(
                torch.rand(1, 8, 8, 3) if backend is StableDiffusion else torch.rand(1, 1, 8, 8, 3)
            )
        message = str(error.value)
        assert model in message and "\n" not in message
        assert "guidance.model=" in message and "guidance=analytic" in message
        assert (f"hf download {model}" in message) == (model == "nobody/no-such-model")


def test_gaussians_are_fitted_to_a_real_backend(checkpoints):
    """The fit needs nothing from a guidance but the protocol: three steps move every kind of parameter, and repeat bit
    for bit."""
    component = FitGaussians(
        image_prior(checkpoints), cameras=Orbits(bank=4, size=32), init=SurfaceCloud(count=50), densify=None, steps=3
    )
    start = component.init(LOOK, component.guidance, torch.Generator().manual_seed(0))
    first, second = component(LOOK), component(LOOK)
    assert len(first) == len(start)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        a, b = getattr(first, name), getattr(second, name)
        assert torch.equal(a, b) and a.isfinite().all() and not torch.equal(a, getattr(start, name))


def test_prediction_kinds_agree_on_the_truth():
    """With z_t = α x₀ + σ ε, the true ε, v = α ε − σ x₀ and x₀ all convert to ε, exactly but for rounding."""
    g = torch.Generator().manual_seed(0)
    x0, eps = (torch.randn(3, 4, generator=g, dtype=torch.float64) for _ in range(2))
    alpha = torch.tensor(0.6, dtype=torch.float64)
    sigma = (1 - alpha**2).sqrt()
    z_t = alpha * x0 + sigma * eps
    for output, kind in ((eps, "epsilon"), (alpha * eps - sigma * x0, "v_prediction"), (x0, "sample")):
        torch.testing.assert_close(to_epsilon(output, z_t, alpha, sigma, kind), eps, rtol=1e-12, atol=1e-14)
    with pytest.raises(ValueError, match="flow"):
        to_epsilon(eps, z_t, alpha, sigma, "flow")


@pytest.mark.parametrize("wrong", [{"size": 60}, {"cfg": -1.0}, {"dtype": "float64"}, {"model": ""}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError):
        StableDiffusion(**wrong)
