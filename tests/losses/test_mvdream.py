"""Four views at once: the published model in the stock class, its cameras, its samples, and the fit that asks it."""

import json
import math
import shutil
import sys
from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[1]))
import mvdream_reference

from diffuphy.losses import sds
from diffuphy.losses.guidance import MissingWeights, mvdream_unet
from diffuphy.losses.guidance.mvdream import MVDream, camera_numbers
from diffuphy.render import orbit
from diffuphy.types import Look

LOOK = Look("burger", "a burger", negative="ugly")
WHITE = torch.ones(3)


@pytest.fixture
def folder(checkpoints):
    return checkpoints / "mvdream"


def prior(folder, **settings):
    return MVDream(model=str(folder), dtype="float32", local_files_only=True, **{"size": 64} | settings)


def ring(first=0.0, elevation=15.0, size=48):
    return orbit([first + 90.0 * k for k in range(4)], elevation, 3.0, width=size, height=size)


def inputs(batch=8, side=8):
    g = torch.Generator().manual_seed(0)
    z, text = torch.randn(batch, 4, side, side, generator=g), torch.randn(batch, 77, 32, generator=g)
    return z, torch.tensor([17.0] * (batch // 2) + [803.0] * (batch // 2)), text, torch.randn(batch, 16, generator=g)


# ---------------------------------------------------------------------- the network
def test_stock_class_with_mapped_names_is_the_published_network(folder):
    """ε̂ of two objects of four views equals the network written out, to float32 rounding through 20 layers."""
    z, t, text, camera = inputs()
    reference = mvdream_reference.Denoiser(mvdream_reference.TINY)
    from safetensors.torch import load_file

    reference.load_state_dict(load_file(folder / "unet/diffusion_pytorch_model.safetensors"))
    unet = mvdream_unet.from_pretrained(str(folder), subfolder="unet", views=4, dtype=torch.float32)
    with torch.no_grad():
        expected = reference(z, t, text, camera, 4)
        found = unet(z, t, encoder_hidden_states=text, class_labels=camera).sample
    torch.testing.assert_close(found, expected, rtol=0, atol=20 * 2**-23 * expected.abs().max().item() * 8)


def test_views_of_one_object_see_each_other_and_no_other_object(folder):
    """Another picture in view 0 changes views 1 to 3 of its object, and not a bit of the next object."""
    unet = mvdream_unet.from_pretrained(str(folder), subfolder="unet", views=4, dtype=torch.float32).eval()
    z, t, text, camera = inputs()
    other = z.clone()
    other[0] += 1
    with torch.no_grad():
        a, b = (unet(x, t, encoder_hidden_states=text, class_labels=camera).sample for x in (z, other))
    changed = (a != b).flatten(1).any(1)
    assert changed[:4].all() and not changed[4:].any()


def test_full_size_has_the_published_names_shapes_and_size():
    """867.6 M parameters; every published name once, of the published shape. Nothing is allocated."""
    with torch.device("meta"):
        unet = mvdream_unet.build(mvdream_reference.FULL, 4)
        published = {k: v.shape for k, v in mvdream_reference.Denoiser(mvdream_reference.FULL).state_dict().items()}
    names = mvdream_unet.published_names(unet)
    assert len(set(names.values())) == len(names)
    assert {names[k]: v.shape for k, v in unet.state_dict().items()} == published
    assert round(sum(p.numel() for p in unet.parameters()) / 1e6, 1) == 867.6


def test_names_are_those_that_diffusers_converts():
    """The library's own converter of original checkpoints, with the camera under the name it knows, agrees name for
    name."""
    from diffusers.loaders.single_file_utils import convert_ldm_unet_checkpoint

    with torch.device("meta"):
        unet = mvdream_unet.build(mvdream_reference.FULL, 4)
    names = mvdream_unet.published_names(unet)
    original = {
        "model.diffusion_model." + p.replace("camera_embed.", "label_emb.0."): torch.full((), float(i))
        for i, p in enumerate(names.values())
    }
    converted = convert_ldm_unet_checkpoint(original, dict(unet.config))
    assert {k: int(v) for k, v in converted.items()} == {k: i for i, k in enumerate(names)}


@pytest.mark.parametrize(
    ("change", "message"), [({"ip_dim": 16}, "ip_dim .* must be 0"), ({"context_dim": None}, "lacks context_dim")]
)
def test_another_model_is_refused(change, message):
    config = {k: v for k, v in (mvdream_reference.TINY | change).items() if v is not None}
    with pytest.raises(ValueError, match=message):
        mvdream_unet.stock_config(config)


def test_weights_that_are_not_exactly_these_are_refused(folder, tmp_path):
    """A missing name, and a strange one."""
    from safetensors.torch import load_file, save_file

    weights = load_file(folder / "unet/diffusion_pytorch_model.safetensors")
    weights["strange"] = weights.pop("out.2.bias")
    (tmp_path / "unet").mkdir()
    (tmp_path / "unet/config.json").write_text(json.dumps(mvdream_reference.TINY))
    save_file(weights, tmp_path / "unet/diffusion_pytorch_model.safetensors")
    with pytest.raises(ValueError, match=r"2 names differ, such as \['out.2.bias', 'strange'\]"):
        mvdream_unet.from_pretrained(str(tmp_path), subfolder="unet", views=4, dtype=torch.float32)


def test_a_repository_of_the_hub_is_read_from_its_cache(folder, tmp_path):
    """The layout that ``hf download`` leaves, found by its name without a network."""
    commit = "0" * 40
    repository = tmp_path / "models--somebody--mvdream"
    (repository / "refs").mkdir(parents=True)
    (repository / "refs/main").write_text(commit)
    shutil.copytree(folder, repository / "snapshots" / commit)
    unet = mvdream_unet.from_pretrained(
        "somebody/mvdream", subfolder="unet", views=4, dtype=torch.float16, local_files_only=True, cache_dir=tmp_path
    )
    assert unet.dtype == torch.float16
    with pytest.raises(OSError, match="somebody/other"):
        mvdream_unet.from_pretrained(
            "somebody/other", subfolder="unet", views=4, dtype=torch.float16, local_files_only=True, cache_dir=tmp_path
        )


# ---------------------------------------------------------------------- cameras
def test_camera_numbers_are_those_of_the_models_own_example():
    """get_camera(4, elevation=15, azimuth_start=90) of the model: looks from +x first, then +y, −x, −y.

    A pose in Blender's axes: columns right, up and back of the camera, and its place on the unit sphere.
    """
    e = math.radians(15)
    rows = []
    for k in range(4):
        a = math.pi / 2 * k
        centre = torch.tensor([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        right = torch.tensor([-math.sin(a), math.cos(a), 0.0])
        up = torch.linalg.cross(centre, right)
        pose = torch.eye(4)
        pose[:3] = torch.stack([right, up, centre, centre], 1)
        rows.append(pose.flatten())
    torch.testing.assert_close(camera_numbers(ring()), torch.stack(rows), atol=1e-6, rtol=0)


def test_camera_numbers_do_not_know_distance_and_lens():
    near, far = (orbit([10.0], 5.0, d, fov=f, width=w, height=w) for d, f, w in ((2.0, 60.0, 32), (7.0, 20.0, 64)))
    torch.testing.assert_close(camera_numbers(near), camera_numbers(far), atol=1e-6, rtol=0)


def test_condition_tells_each_view_its_camera_and_wants_rings(folder):
    cond = prior(folder).condition(LOOK, ring(), WHITE)
    assert torch.equal(cond.labels, camera_numbers(ring())) and cond.positive.shape == (4, 77, 32)
    assert torch.equal(cond.positive[0], cond.positive[3]), "the side is told by the camera, not by words"
    with pytest.raises(ValueError, match=r"4 views together, got 2; set fit.views=4"):
        prior(folder).condition(LOOK, ring()[:2], WHITE)


# ---------------------------------------------------------------------- gradient and samples
@pytest.mark.parametrize("phi", [0.0, 0.5])
def test_sds_gradient_is_that_of_the_network_written_out(folder, phi):
    """∂L/∂z = σ² (ε̂ − ε) with ε̂ from the published network by hand: guidance, and contrast over all four views."""
    from safetensors.torch import load_file

    ours = prior(folder, cfg=20.0, rescale=phi, negative="blurry")
    g = torch.Generator().manual_seed(1)
    z, noise, t = torch.randn(4, 4, 8, 8, generator=g), torch.randn(4, 4, 8, 8, generator=g), torch.full((4,), 0.6005)
    cond = ours.condition(LOOK, ring(30.0), WHITE)
    x = z.clone().requires_grad_()

    class Latent(MVDream):
        def encode(self, sample):
            return sample

    latent = Latent(model=str(folder), dtype="float32", cfg=20.0, rescale=phi)
    sds(latent, x, cond, t=t, noise=noise).backward()

    network = mvdream_reference.Denoiser(mvdream_reference.TINY)
    network.load_state_dict(load_file(folder / "unet/diffusion_pytorch_model.safetensors"))
    betas = torch.linspace(0.00085**0.5, 0.012**0.5, 1000, dtype=torch.float64) ** 2
    alpha_bar = torch.cumprod(1 - betas, 0)[600].float()
    a, s = alpha_bar.sqrt(), (1 - alpha_bar).sqrt()
    with torch.no_grad():
        z_t = a * z + s * noise
        k = torch.full((4,), 600.0)
        positive, negative = (network(z_t, k, text, cond.labels, 4) for text in (cond.positive, cond.negative))
        guided = negative + 20.0 * (positive - negative)
        x0, plain = ((z_t - s * e) / a for e in (guided, positive))
        x0 = phi * x0 * plain.std() / x0.std() + (1 - phi) * x0
        expected = s**2 * ((z_t - a * x0) / s - noise)
    # guidance of 20 adds two answers of float32 rounding 1e-6 twenty times over
    torch.testing.assert_close(x.grad, expected, rtol=0, atol=1e-5 * expected.abs().max().item())


def test_pictures_are_the_ddim_samples_of_diffusers(folder):
    """z_0 of the library's scheduler, stepped by hand with the same answers from the same noise, and decoded."""
    from diffusers import AutoencoderKL, DDIMScheduler

    ours, camera = prior(folder), ring()
    found = ours.pictures(LOOK, camera, torch.Generator().manual_seed(3), steps=5, cfg=2.0)
    scheduler = DDIMScheduler.from_pretrained(folder, subfolder="scheduler", timestep_spacing="trailing",
                                              set_alpha_to_one=True)  # fmt: skip
    scheduler.set_timesteps(5)
    vae = AutoencoderKL.from_pretrained(folder, subfolder="vae")
    cond = ours.condition(LOOK, camera, WHITE)
    z = torch.randn(4, 4, 8, 8, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        for k in scheduler.timesteps:
            t = torch.full((4,), (float(k) + 0.5) / 1000)
            z = scheduler.step(ours.guided(z, t, cond, 2.0), k, z).prev_sample
        expected = (vae.decode(z / vae.config.scaling_factor).sample / 2 + 0.5).clamp(0, 1).permute(0, 2, 3, 1)
    assert found.shape == (4, 64, 64, 3)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-4)  # 5 steps; α of float32 in the scheduler


def test_missing_weights_are_one_line(tmp_path):
    with pytest.raises(MissingWeights, match="guidance=mvdream"):
        MVDream(model=str(tmp_path / "nowhere"), local_files_only=True).networks(torch.device("cpu"))
