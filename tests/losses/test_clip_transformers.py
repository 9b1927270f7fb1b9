"""Wan and CogVideoX on tiny checkpoints of the very classes they load, against the pipelines of diffusers."""

import dataclasses
import gc
import sys
import weakref
from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[1]))
import tiny_models

from diffuphy.losses import sds
from diffuphy.losses.guidance.cogvideox import CogVideoX
from diffuphy.losses.guidance.wan import Wan
from diffuphy.losses.schedules import rectified_flow
from diffuphy.render import orbit
from diffuphy.types import Motion

FALL = Motion("falling", "a burger falls", negative="blurry")
CAMERA = orbit([0.0], [0.0], 3.0, width=32, height=32)
WHITE = torch.ones(3)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("clips")
    tiny_models.wan(root / "wan")
    tiny_models.cogvideox(root / "cogvideox")
    tiny_models.cogvideox(root / "cogvideox-rotary", rotary=True)
    return root


def prior(folders, name, **settings):
    kind = Wan if name == "wan" else CogVideoX
    settings = {"size": 32, "dtype": "float32", "cfg": 6.0} | settings
    return kind(model=str(folders / name), local_files_only=True, **settings)


def pipeline(folders, name):
    """The checkpoint as diffusers assembles it."""
    from diffusers import CogVideoXPipeline, WanPipeline

    model, parts = str(folders / name), {}
    import diffusers
    import transformers

    wan = name == "wan"
    for part, kind in {
        "vae": "AutoencoderKLWan" if wan else "AutoencoderKLCogVideoX",
        "transformer": "WanTransformer3DModel" if wan else "CogVideoXTransformer3DModel",
        "scheduler": "UniPCMultistepScheduler" if wan else "CogVideoXDDIMScheduler",
    }.items():
        parts[part] = getattr(diffusers, kind).from_pretrained(model, subfolder=part)
    text = transformers.UMT5EncoderModel if wan else transformers.T5EncoderModel
    parts["text_encoder"] = text.from_pretrained(model, subfolder="text_encoder")
    parts["tokenizer"] = transformers.AutoTokenizer.from_pretrained(model, subfolder="tokenizer")
    pipe = (WanPipeline if wan else CogVideoXPipeline)(**parts)
    for module in (pipe.vae, pipe.transformer, pipe.text_encoder):
        module.eval().requires_grad_(False)
    return pipe


@pytest.mark.parametrize("name", ["wan", "cogvideox", "cogvideox-rotary"])
def test_words_are_embedded_as_the_pipeline_embeds_them(folders, name):
    pipe = pipeline(folders, name)
    positive, negative = pipe.encode_prompt(FALL.text, FALL.negative, device="cpu", dtype=torch.float32)
    cond = prior(folders, name).condition(FALL, CAMERA, WHITE)
    # the same calls in another batch: float32 rounding of two layers
    torch.testing.assert_close(cond.positive, positive, rtol=0, atol=1e-5)
    torch.testing.assert_close(cond.negative, negative, rtol=0, atol=1e-5)


@pytest.mark.parametrize("t", [0.05, 0.62, 0.97])
def test_sds_gradient_of_wan_is_that_of_the_flow_written_out(folders, t):
    """z_σ = (1 − σ) z + σ ε; v̂ = v̂₋ + s (v̂₊ − v̂₋); ∂L/∂z = σ² (z_σ + (1 − σ) v̂ − ε), by the pipeline's networks."""
    pipe, g = pipeline(folders, "wan"), torch.Generator().manual_seed(0)
    clip, noise = torch.rand(1, 5, 32, 32, 3, generator=g), torch.randn(1, 16, 2, 4, 4, generator=g)
    ours = clip.clone().requires_grad_()
    guidance = prior(folders, "wan")
    cond = guidance.condition(FALL, CAMERA, WHITE)
    sds(guidance, ours, cond, t=torch.tensor([t]), noise=noise).backward()

    theirs = clip.clone().requires_grad_()
    z = pipe.vae.encode(2 * theirs.permute(0, 4, 1, 2, 3) - 1).latent_dist.mean
    mean, std = (torch.tensor(pipe.vae.config[k]).view(1, -1, 1, 1, 1) for k in ("latents_mean", "latents_std"))
    z = (z - mean) / std
    sigma = 3.0 * t / (1 + 2.0 * t)
    with torch.no_grad():
        z_t = (1 - sigma) * z + sigma * noise
        clock = torch.tensor([1000 * sigma])
        texts = pipe.encode_prompt(FALL.text, FALL.negative, device="cpu", dtype=torch.float32)
        positive, negative = (pipe.transformer(z_t, clock, e, return_dict=False)[0] for e in texts)
        v = negative + 6.0 * (positive - negative)
        grad = sigma**2 * (z_t + (1 - sigma) * v - noise)
    z.backward(grad)
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=0, atol=1e-5 * theirs.grad.abs().max().item())


@pytest.mark.parametrize("name", ["cogvideox", "cogvideox-rotary"])
def test_sds_gradient_of_cogvideox_is_that_of_its_pipeline_written_out(folders, name):
    """v = α ε − σ z ⇒ ε̂ = α v̂ + σ z_t, with the scheduler's own ᾱ and the pipeline's own rotary angles."""
    pipe, g = pipeline(folders, name), torch.Generator().manual_seed(0)
    clip, noise = torch.rand(1, 5, 32, 32, 3, generator=g), torch.randn(1, 2, 4, 4, 4, generator=g)
    ours = clip.clone().requires_grad_()
    guidance = prior(folders, name)
    sds(guidance, ours, guidance.condition(FALL, CAMERA, WHITE), t=torch.tensor([0.4005]), noise=noise).backward()

    theirs = clip.clone().requires_grad_()
    z = pipe.vae.encode(2 * theirs.permute(0, 4, 1, 2, 3) - 1).latent_dist.mean.transpose(1, 2)
    z = z * pipe.vae.config.scaling_factor
    k = torch.tensor([400])
    alpha_bar = pipe.scheduler.alphas_cumprod[k].view(-1, 1, 1, 1, 1).float()
    a, s = alpha_bar.sqrt(), (1 - alpha_bar).sqrt()
    with torch.no_grad():
        z_t = a * z + s * noise
        texts = pipe.encode_prompt(FALL.text, FALL.negative, device="cpu", dtype=torch.float32)
        rotary = (
            pipe._prepare_rotary_positional_embeddings(32, 32, 2, torch.device("cpu")) if "rotary" in name else None
        )
        positive, negative = (pipe.transformer(z_t, e, k, image_rotary_emb=rotary, return_dict=False)[0] for e in texts)
        v = negative + 6.0 * (positive - negative)
        grad = s**2 * (a * v + s * z_t - noise)
    z.backward(grad)
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=0, atol=1e-5 * theirs.grad.abs().max().item())


@pytest.mark.parametrize("name", ["wan", "cogvideox"])
def test_the_gradient_reaches_every_frame(folders, name):
    clip = torch.rand(1, 9, 40, 48, 3, requires_grad=True)
    guidance = prior(folders, name)
    cond = guidance.condition(FALL, CAMERA, WHITE)
    sds(guidance, clip, cond, t=torch.tensor([0.5]), generator=torch.Generator().manual_seed(0)).backward()
    assert (clip.grad.flatten(2).norm(dim=2) > 0).all() and clip.grad.isfinite().all()


@pytest.mark.parametrize("name", ["wan", "cogvideox"])
def test_bfloat16_networks_keep_the_gradient(folders, name):
    """Latents and injection stay in float32: only ε̂ carries the format's 2⁻⁸, times cfg in the difference of two."""
    clip, grads = torch.rand(1, 5, 32, 32, 3), []
    for dtype in ("float32", "bfloat16"):
        guidance, x = prior(folders, name, dtype=dtype, cfg=1.0), clip.clone().requires_grad_()
        cond = guidance.condition(FALL, CAMERA, WHITE)
        sds(guidance, x, cond, t=torch.tensor([0.5]), generator=torch.Generator().manual_seed(0)).backward()
        grads.append(x.grad)
    assert (grads[1] - grads[0]).norm() < 8 * 2**-8 * grads[0].norm()  # a few roundings in two layers


@pytest.mark.parametrize(("frames", "fits"), [(4, "1 or 5"), (16, "13 or 17")])
def test_a_clip_that_the_autoencoder_cannot_take_is_refused_with_one_it_can(folders, frames, fits):
    with pytest.raises(ValueError, match=f"got {frames}; show it {fits}"):
        prior(folders, "wan").encode(torch.rand(1, frames, 32, 32, 3))


def test_embeddings_on_the_disk_spare_the_text_encoder(folders, tmp_path, monkeypatch):
    """The second run with the same words loads no T5; other words, or another encoder in the folder, do."""
    from transformers import UMT5EncoderModel

    alive, load = [], UMT5EncoderModel.from_pretrained

    def watched(*args, **kwargs):
        model = load(*args, **kwargs)
        alive.append(weakref.ref(model))
        return model

    monkeypatch.setattr(UMT5EncoderModel, "from_pretrained", watched)
    cache = str(tmp_path / "embeddings")
    first = prior(folders, "wan", embeddings=cache).condition(FALL, CAMERA, WHITE)
    gc.collect()
    assert len(alive) == 1 and alive[0]() is None, "the encoder is freed"
    second = prior(folders, "wan", embeddings=cache).condition(FALL, CAMERA, WHITE)
    assert len(alive) == 1 and torch.equal(first.positive, second.positive)
    prior(folders, "wan", embeddings=cache).condition(Motion("x", "another"), CAMERA, WHITE)
    assert len(alive) == 2
    prior(folders, "wan", embeddings=cache, dtype="bfloat16").condition(FALL, CAMERA, WHITE)
    assert len(alive) == 3


def test_rectified_flow_runs_from_sample_to_noise_and_shifts_towards_noise():
    """σ(0) = 0, σ(1) = 1, α + σ = 1; s = 3 at t = ½: 3/4 (Esser et al., eq. 23)."""
    t = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)
    for shift, middle in ((1.0, 0.5), (3.0, 0.75)):
        alpha, sigma = rectified_flow(t, shift)
        torch.testing.assert_close(sigma, torch.tensor([0.0, middle, 1.0], dtype=torch.float64))
        torch.testing.assert_close(alpha + sigma, torch.ones(3, dtype=torch.float64))


FULL = {
    "wan": (
        {"num_attention_heads": 12, "attention_head_dim": 128, "ffn_dim": 8960, "num_layers": 30}, {},
        {"vocab_size": 256384}, 1_418_996_800, 5_680_910_336,
    ),
    "cogvideox": (
        {"num_layers": 30},
        {
            "block_out_channels": (128, 256, 256, 512), "latent_channels": 16, "layers_per_block": 3,
            "down_block_types": ("CogVideoXDownBlock3D",) * 4, "up_block_types": ("CogVideoXUpBlock3D",) * 4,
        },
        {"vocab_size": 32128}, 1_693_783_872, 4_762_310_656,
    ),
}  # fmt: skip
XXL = {"d_model": 4096, "d_kv": 64, "d_ff": 10240, "num_layers": 24, "num_heads": 64, "feed_forward_proj": "gated-gelu"}
"""Transformer, autoencoder and text encoder (an XXL) of the published 1.3B and 2b models; parameters of the first and
the last."""


@pytest.mark.parametrize("name", FULL)
def test_the_published_size_is_counted_and_measured_without_its_weights(name, tmp_path, monkeypatch):
    """The real configurations on the meta device: parameters as published (1.42 and 1.69 billion, text 5.68 and 4.76),
    weights in bfloat16 two bytes each; a clip of 17 frames fits in less memory than one of 33. The page's table."""
    import diffusers
    import transformers

    kind = Wan if name == "wan" else CogVideoX
    network, autoencoder, words, count, text = FULL[name]
    getattr(tiny_models, name)(tmp_path)
    with torch.device("meta"):
        configs = {
            "transformer": getattr(diffusers, kind.unet_class)(**network).config,
            "vae": getattr(diffusers, kind.vae_class)(**autoencoder).config,
            "text_encoder": getattr(transformers, kind.text_class).config_class(**XXL, **words).to_dict(),
        }
    settings = kind.settings
    monkeypatch.setattr(kind, "settings", lambda self, part: dict(configs.get(part) or settings(self, part)))
    page = (Path(__file__).parents[2] / "docs/guidance.md").read_text(encoding="utf-8")
    need = kind(model=str(tmp_path)).footprint(17)
    lean = dataclasses.replace(need, offload=True)
    numbers = (need.unet + need.vae, need.denoising, need.encoding, need.peak, lean.peak)
    assert "256 px | 17 | " + " | ".join(f"{n / 1e9:.2f}" for n in numbers) + " |" in page
    prior = kind(model=str(tmp_path), size=64)
    found, longer = prior.footprint(17), prior.footprint(33)
    assert 2 * count <= found.unet < 2.05 * count  # and buffers: CogVideoX has a table of positions, 2 % of it
    assert found.text == pytest.approx(2 * text, rel=1e-3)
    assert longer.denoising > found.denoising and longer.encoding > found.encoding
