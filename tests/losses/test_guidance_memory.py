"""What a diffusion model takes: told before it is loaded, kept small by chunks and offloading, lost in no format."""

import dataclasses
import json
import sys
from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[1]))
import mvdream_reference

from diffuphy.losses import sds
from diffuphy.losses.guidance import memory
from diffuphy.losses.guidance.latent import Texts
from diffuphy.losses.guidance.modelscope import ModelScope
from diffuphy.losses.guidance.mvdream import MVDream
from diffuphy.losses.guidance.stable_diffusion import StableDiffusion
from diffuphy.render import orbit
from diffuphy.types import Look

LOOK, WHITE, CPU = Look("burger", "a burger", negative="ugly"), torch.ones(3), torch.device("cpu")
BACKENDS = {"sd-epsilon": StableDiffusion, "mvdream": MVDream, "modelscope": ModelScope}


def prior(root, name="sd-epsilon", **settings):
    return BACKENDS[name](model=str(root / name), local_files_only=True, **{"size": 64, "dtype": "float32"} | settings)


def ring():
    return orbit([0.0, 90.0, 180.0, 270.0], 10.0, 3.0, width=64, height=64)


def latents(n=4, seed=0):
    g = torch.Generator().manual_seed(seed)
    return torch.randn(n, 4, 8, 8, generator=g), torch.randn(n, 4, 8, 8, generator=g)


# ---------------------------------------------------------------------- before loading
@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_predicted_weights_are_the_bytes_that_are_loaded(checkpoints, name, dtype):
    """Exactly; and predicting opens nothing but config.json."""
    guidance = prior(checkpoints, name, dtype=dtype)
    predicted = guidance.footprint(4)
    assert "networks" not in guidance._memory
    for network, size in zip(guidance.networks(CPU), (predicted.unet, predicted.vae), strict=True):
        assert sum(p.numel() * p.element_size() for p in network.parameters()) == size


def test_predicting_needs_no_weights(checkpoints, tmp_path):
    for config in checkpoints.glob("sd-epsilon/*/config.json"):
        (tmp_path / config.parent.name).mkdir()
        (tmp_path / config.parent.name / "config.json").write_text(config.read_text())
    assert prior(checkpoints).footprint(2) == StableDiffusion(model=str(tmp_path), size=64, dtype="float32").footprint(
        2
    )


def allocated(run):
    """Most bytes that torch's allocator holds of what ``run`` asks for, by its own record."""
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as recorded:
        run()
    events = [e for e in recorded.profiler.kineto_results.events() if e.name() == "[memory]"]
    now = top = 0
    for event in sorted(events, key=lambda e: e.start_ns()):
        now += event.nbytes()
        top = max(top, now)
    return top


@pytest.mark.parametrize("name", ["sd-epsilon", "mvdream"])
def test_predicted_activations_are_what_the_allocator_gives(checkpoints, name):
    """Within a quarter: a CPU rounds sizes up and takes workspaces, of which small networks have relatively much."""
    guidance = prior(checkpoints, name, size=128)
    predicted = guidance.footprint(4)
    cond = guidance.condition(LOOK, ring(), WHITE)
    unet, vae = guidance.networks(CPU)
    z, text = torch.randn(8, 4, 16, 16), torch.cat([cond.negative, cond.positive])
    labels = None if cond.labels is None else torch.cat([cond.labels] * 2)
    x = torch.rand(1, 3, 128, 128, requires_grad=True)

    def denoise():
        with torch.no_grad():
            unet(z, torch.full((8,), 500), encoder_hidden_states=text, class_labels=labels)

    def encode():
        mean = vae.encode(x).latent_dist.mode()
        torch.autograd.grad(mean, x, torch.ones_like(mean))

    for run, bytes_ in ((denoise, predicted.denoising), (encode, predicted.encoding)):
        run()  # what is made once does not count
        assert bytes_ == pytest.approx(allocated(run), rel=0.25)


SD1 = {"cross_attention_dim": 768, "attention_head_dim": 8}
SD2 = {"cross_attention_dim": 1024, "attention_head_dim": [5, 10, 20, 20], "use_linear_projection": True}
VIDEO = {"cross_attention_dim": 1024, "attention_head_dim": 64}
VAE = {
    "block_out_channels": [128, 256, 512, 512],
    "down_block_types": ["DownEncoderBlock2D"] * 4,
    "up_block_types": ["UpDecoderBlock2D"] * 4,
    "layers_per_block": 2,
}
TEXT1 = {"hidden_size": 768, "intermediate_size": 3072, "num_hidden_layers": 12, "num_attention_heads": 12}
TEXT2 = {"hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 23, "num_attention_heads": 16}
"""Settings of the published models: Stable Diffusion 1.5 and 2.1, ModelScope, their autoencoder and text encoders."""


def full(folder, unet, text):
    """A folder with the config.json files of a published model, and nothing else."""
    from diffusers import AutoencoderKL, UNet2DConditionModel, UNet3DConditionModel
    from transformers import CLIPTextConfig

    if unet is mvdream_reference.FULL:
        (folder / "unet").mkdir(parents=True)
        (folder / "unet/config.json").write_text(json.dumps(unet))
    with torch.device("meta"):
        if unet is not mvdream_reference.FULL:
            (UNet3DConditionModel if unet is VIDEO else UNet2DConditionModel)(**unet).save_config(folder / "unet")
        AutoencoderKL(**VAE).save_config(folder / "vae")
    CLIPTextConfig(**text).save_pretrained(folder / "text_encoder")
    return str(folder)


def test_full_sizes_are_the_published_ones_and_the_pages(tmp_path):
    """Millions of parameters of the denoiser: 859.5, 865.9, 867.6 and 1411; of the autoencoder 83.7, of the text
    encoders 123 and 340. What they take is the table of docs/guidance.md."""
    page = (Path(__file__).parents[2] / "docs/guidance.md").read_text(encoding="utf-8")
    cases = [
        ("Stable Diffusion 1.5", StableDiffusion, SD1, TEXT1, 512, 1, (859.5, 123.1)),
        ("Stable Diffusion 1.5", StableDiffusion, SD1, TEXT1, 512, 4, (859.5, 123.1)),
        ("Stable Diffusion 2.1", StableDiffusion, SD2, TEXT2, 512, 1, (865.9, 340.4)),
        ("MVDream", MVDream, mvdream_reference.FULL, TEXT2, 256, 4, (867.6, 340.4)),
        ("ModelScope", ModelScope, VIDEO, TEXT2, 256, 16, (1411.2, 340.4)),
    ]
    for k, (name, backend, unet, text, size, count, millions) in enumerate(cases):
        model = full(tmp_path / str(k), unet, text)
        need = backend(model=model, size=size, local_files_only=True).footprint(count)
        assert (round(need.unet / 2e6, 1), round(need.text / 2e6, 1)) == millions, name
        assert round(need.vae / 4e6, 1) == 83.7
        lean = dataclasses.replace(need, offload=True)
        numbers = (need.unet + need.vae, need.denoising, need.encoding, need.peak, lean.peak)
        row = f"| {name} | {size} px | {count} | " + " | ".join(f"{n / 1e9:.2f}" for n in numbers) + " |"
        assert row in page, row


def test_encoder_of_stable_diffusion_keeps_what_was_measured():
    """0.37 GiB of float16 activations for 256 px and 1.47 for 512 px, twice that in float32: four times as much for
    twice the side."""
    from diffusers import AutoencoderKL

    with torch.device("meta"):
        vae = AutoencoderKL(**VAE).requires_grad_(False)
        for side, gibibytes in ((256, 0.37), (512, 1.47)):
            x = torch.empty(1, 3, side, side, requires_grad=True)
            with memory._Lean():
                peak = memory.peak_bytes(lambda x=x: vae.encode(x).latent_dist, vae.parameters())
            assert peak / 2 / 2**30 == pytest.approx(gibibytes, abs=0.01)


def test_peak_is_that_of_the_largest_phase():
    parts = {"unet": 10, "vae": 3, "text": 4, "denoising": 2, "encoding": 8}
    assert memory.Footprint(**parts).peak == 21
    assert memory.Footprint(**parts, offload=True).peak == 12
    assert memory.Footprint(**parts | {"text": 99}).peak == 99


# ---------------------------------------------------------------------- less at a time
@pytest.mark.parametrize(("name", "chunk", "calls"), [("sd-epsilon", 1, 8), ("sd-epsilon", 3, 3), ("mvdream", 4, 2)])
def test_chunks_give_the_same_answer(checkpoints, name, chunk, calls, monkeypatch):
    """To rounding, which may differ with the rows of a call: 1e-5."""
    whole, cut = prior(checkpoints, name), prior(checkpoints, name, chunk=chunk)
    cond = whole.condition(LOOK, ring(), WHITE)
    (z, _), t = latents(), torch.full((4,), 0.5)
    unet, counted = cut.networks(CPU).unet, []
    forward = unet.forward
    monkeypatch.setattr(unet, "forward", lambda *a, **k: counted.append(1) or forward(*a, **k))
    expected = whole.predict_noise(z, t, cond)
    torch.testing.assert_close(cut.predict_noise(z, t, cond), expected, rtol=0, atol=1e-5 * expected.abs().max().item())
    assert len(counted) == calls


def test_views_that_are_judged_together_are_not_cut_apart(checkpoints):
    with pytest.raises(ValueError, match=r"multiple of 4, .* got 6"):
        prior(checkpoints, "mvdream", chunk=6)


def test_an_offloaded_network_computes_only_while_it_is_there(checkpoints, monkeypatch):
    """Between "to the device" and "to the host" lies every forward and every backward pass, and the bits are the
    same."""
    image, (_, noise) = torch.rand(4, 64, 64, 3, generator=torch.Generator().manual_seed(1)), latents()
    gradients, events = [], []
    for offload in (False, True):
        guidance = prior(checkpoints, offload=offload)
        cond = guidance.condition(LOOK, ring(), WHITE)
        if offload:
            for name, module in zip(("unet", "vae"), guidance.networks(CPU), strict=True):
                to = module.to
                monkeypatch.setattr(module, "to", lambda d, n=name, to=to: events.append(f"{n} moves") or to(d))
                part = module if name == "unet" else module.encoder
                part.register_forward_hook(lambda *_, n=name: events.append(f"{n} works"))
                if name == "vae":
                    part.register_full_backward_hook(lambda *_, n=name: events.append(f"{n} works"))
        x = image.clone().requires_grad_()
        sds(guidance, x, cond, t=torch.full((4,), 0.5), noise=noise).backward()
        gradients.append(x.grad)
    assert torch.equal(*gradients)
    assert events == [
        "vae moves", *["vae works"] * 4, "vae moves",
        "unet moves", "unet works", "unet moves",
        "vae moves", *["vae works"] * 8, "vae moves",
    ]  # fmt: skip


def test_frames_are_encoded_one_by_one_with_nothing_kept(checkpoints):
    """What is saved for the backward pass of 8 frames is the 8 frames."""
    guidance, saved = prior(checkpoints, "modelscope", size=32), []
    clip = torch.rand(1, 8, 32, 32, 3, requires_grad=True)
    guidance.networks(CPU)

    def pack(x):
        saved.append(x.untyped_storage().nbytes())
        return x

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda x: x):
        guidance.encode(clip)
    assert sum(saved) == clip.numel() * 4


# ---------------------------------------------------------------------- formats
HALF = {"float16": 2.0**-11, "bfloat16": 2.0**-8}
"""Unit roundoff u: the relative error of storing one number."""


class Latent(StableDiffusion):
    """Its samples are latents."""

    def encode(self, sample):
        return sample


@pytest.mark.parametrize("dtype", HALF)
def test_a_half_precision_denoiser_errs_by_its_own_rounding(checkpoints, dtype):
    """‖g_half − g‖ ≤ n u w ‖ε̂‖ with n roundings on the way through the network; cfg = 1 adds none."""
    z, noise = latents()
    t = torch.full((4,), 0.3)
    gradients = []
    for kind in ("float32", dtype):
        guidance = Latent(model=str(checkpoints / "sd-epsilon"), dtype=kind, cfg=1.0, local_files_only=True)
        cond = guidance.condition(LOOK, ring(), WHITE)
        x = z.clone().requires_grad_()
        sds(guidance, x, cond, t=t, noise=noise, weight="unit").backward()
        assert x.grad.dtype == torch.float32
        gradients.append(x.grad)
    layers = sum(1 for m in guidance.networks(CPU).unet.modules() if not list(m.children()))
    error = (gradients[1] - gradients[0]).norm()
    assert 0 < error < layers * HALF[dtype] * (gradients[0] + noise).norm()


@pytest.mark.parametrize("dtype", HALF)
def test_the_gradient_of_a_half_precision_denoiser_arrives_whole(checkpoints, dtype):
    """At t = 0.02, where w = σ² is 0.02 and |g| far below |z|, g = w (ε̂ − ε) to float32 rounding, for ε̂ as the network
    gave it. The target (z − g).detach() in the network's own format would lose most of it, which this would notice."""
    guidance = Latent(model=str(checkpoints / "sd-epsilon"), dtype=dtype, cfg=1.0, local_files_only=True)
    z, noise = latents()
    noise = 1e-2 * noise
    t, cond = torch.full((4,), 0.02), guidance.condition(LOOK, ring(), WHITE)
    a, s = (v.view(-1, 1, 1, 1) for v in guidance.schedule(t))
    given = guidance.predict_noise(a * z + s * noise, t, cond)
    expected = 1e-3 * s.double() ** 2 * (given.double() - noise.double())
    x = z.clone().requires_grad_()
    (1e-3 * sds(guidance, x, cond, t=t, noise=noise)).backward()
    assert (x.grad - expected).norm() < 4 * 2**-24 * (expected.norm() + (1e-3 * s**2 * noise).norm())
    half = getattr(torch, dtype)
    popular = z.to(half) - (z.to(half) - expected.to(half))
    assert (popular.double() - expected).norm() > 0.1 * expected.norm()


def test_every_text_is_in_one_call_and_in_its_place(checkpoints):
    """predict_parts answers each of the texts as if it were asked alone."""
    guidance = prior(checkpoints)
    cond = guidance.condition(LOOK, ring(), WHITE)
    (z, _), t = latents(), torch.full((4,), 0.5)
    together = guidance.predict_parts(z, t, cond, ("empty", "positive", "negative"))
    for part, found in zip(("empty", "positive", "negative"), together, strict=True):
        (alone,) = guidance.predict_parts(z, t, cond, (part,))
        torch.testing.assert_close(found, alone, rtol=0, atol=1e-5)
    assert not torch.equal(together[0], together[2]) and isinstance(cond, Texts)
