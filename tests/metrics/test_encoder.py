"""Metrics with networks: tiny random-weight models of the real classes, loaded as a user loads the real ones."""

import pytest
import torch

from diffuphy.metrics.aesthetic import Aesthetic
from diffuphy.metrics.encoder import OpenClip
from diffuphy.metrics.i3d import I3D, InceptionI3d, same
from diffuphy.metrics.language import clipsim, front_everywhere, janus
from diffuphy.metrics.videomae import VideoMAE
from tests import tiny_models as tiny
from tests.models import hub


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    return OpenClip(str(tiny.open_clip(tmp_path_factory.mktemp("clip"))))


def film(n=3, side=48, seed=0):
    return torch.rand(n, side, side, 3, generator=torch.Generator().manual_seed(seed))


# ---------------------------------------------------------------------- CLIP
def test_clipsim_is_the_cosine_of_open_clips_own_embeddings(encoder):
    """At the network's own size nothing is resized: the cosine of what open_clip's public calls give, to rounding."""
    import open_clip

    name = f"local-dir:{encoder.model}"
    model, tokenizer = open_clip.create_model(name).eval(), open_clip.get_tokenizer(name)
    rgb = film(side=32)
    mean, std = (torch.tensor(c).view(3, 1, 1) for c in (open_clip.OPENAI_DATASET_MEAN, open_clip.OPENAI_DATASET_STD))
    with torch.no_grad():
        a = model.encode_image((rgb.permute(0, 3, 1, 2) - mean) / std)
        b = model.encode_text(tokenizer(["a burger"]))
    found = clipsim(encoder, rgb, "a burger")
    assert torch.allclose(found, torch.cosine_similarity(a, b), rtol=0, atol=1e-6)


def test_pictures_go_in_as_open_clip_prepares_them(encoder):
    """Its own way goes through 8 bits: half a level of 1/255 over σ = 0.27, and as much again from the rounding of the
    resize; cropping the wrong side would be off by the whole contrast."""
    import open_clip
    from PIL import Image

    prepare = open_clip.create_model_and_transforms(f"local-dir:{encoder.model}")[2]
    smooth = torch.nn.functional.interpolate(torch.rand(1, 3, 5, 7, generator=torch.Generator().manual_seed(0)),
                                             (60, 90), mode="bicubic").clamp(0, 1)[0].permute(1, 2, 0)  # fmt: skip
    picture = Image.fromarray((smooth * 255).round().to(torch.uint8).numpy())
    assert torch.allclose(encoder.prepared(smooth[None])[0], prepare(picture), rtol=0, atol=2 * 1.5 / 255 / 0.26)


def test_batches_do_not_matter(encoder):
    whole, parts = (OpenClip(encoder.model, batch=b).pictures(film(5)) for b in (5, 2))
    assert torch.allclose(whole, parts, atol=1e-6)
    assert torch.allclose(whole.norm(dim=1), torch.ones(5))


def test_openais_weights_with_the_wrong_activation_are_refused():
    with pytest.raises(ValueError, match="ViT-B-32-quickgelu"):
        OpenClip("ViT-B-32", "openai")


@pytest.mark.parametrize(
    ("model", "tag", "right"),
    [("ViT-B-32-quickgelu", "laion2b_s34b_b79k", "no weights"), ("ViT-B-32", "metaclip_400m", "ViT-B-32-quickgelu"),
     ("ViT-B-32", "nobody", "no weights")],
)  # fmt: skip
def test_every_tag_is_checked_against_open_clips_own_table(model, tag, right):
    """Before anything is fetched."""
    with pytest.raises(ValueError, match=right):
        OpenClip(model, tag, "x/y").texts(["a burger"], torch.device("cpu"))


def test_default_agrees_with_open_clips_own_table():
    """Tag, activation and repository, so that the plan looks where open_clip will."""
    import open_clip

    for clip in (OpenClip(), Aesthetic().encoder):
        clip._check_activation(open_clip)
        assert open_clip.pretrained.get_pretrained_cfg(clip.model, clip.pretrained)["hf_hub"].strip("/") == clip.repo


def test_absent_weights_have_a_reason_and_a_remedy(encoder, monkeypatch, tmp_path):
    """Looked for in the cache of the hub without its library; found once they lie there."""
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    assert encoder.missing() is None
    assert "hf download timm/vit_base_patch32_clip_224.openai" in OpenClip().missing()
    assert "there is no folder" in OpenClip(str(tmp_path / "none")).missing()
    assert "holds no open_clip_model.safetensors" in OpenClip(str(tmp_path)).missing()
    hub.cached(tmp_path, OpenClip().repo, {"open_clip_model.safetensors": (2).to_bytes(8, "little") + b"{}"})
    assert OpenClip().missing() is None


# ---------------------------------------------------------------------- Janus
class Sides:
    """An encoder that knows which side it sees: the first number of a picture says which."""

    def missing(self):
        return None

    def pictures(self, rgb):
        return torch.eye(3)[rgb[:, 0, 0, 0].long()]

    def texts(self, texts, device):
        order = [next(i for i, side in enumerate(("front", "side", "back")) if side in t) for t in texts]
        return torch.eye(3)[order]


def test_janus_counts_fronts_from_behind():
    """Views from 0, 90, 180, 270°, one of them from behind: 0 if it shows a back, 1 if it shows a front."""
    azimuth = torch.tensor([0.0, 90.0, 180.0, 270.0])
    for seen, expected in (((0, 1, 2, 1), 0.0), ((0, 1, 0, 1), 1.0), ((0, 0, 2, 0), 0.0)):
        views = torch.tensor(seen, dtype=torch.float32)[:, None, None, None].expand(-1, 2, 2, 3)
        likely = janus(Sides(), views, "a dog")
        assert torch.allclose(likely.sum(1), torch.ones(4))
        assert front_everywhere(likely, azimuth) == expected
    with pytest.raises(ValueError, match="from behind"):
        front_everywhere(likely, torch.tensor([0.0, 90.0, -90.0, 45.0]))


# ---------------------------------------------------------------------- LAION
@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_aesthetic_score_is_the_linear_head(encoder, tmp_path, suffix):
    from safetensors.torch import save_file

    w, b = torch.randn(1, 16, generator=torch.Generator().manual_seed(0)), torch.tensor([5.0])
    file = tmp_path / f"head{suffix}"
    (torch.save if suffix == ".pth" else save_file)({"weight": w, "bias": b}, file)
    found = Aesthetic(str(file), encoder=encoder)(film())
    assert torch.allclose(found, encoder.pictures(film()) @ w[0] + 5.0, atol=1e-6)


def test_head_of_another_encoder_is_refused(encoder, tmp_path):
    torch.save({"weight": torch.zeros(1, 768), "bias": torch.zeros(1)}, tmp_path / "head.pth")
    with pytest.raises(ValueError, match="takes 768 numbers, the encoder gives 16"):
        Aesthetic(str(tmp_path / "head.pth"), encoder=encoder)(film())


def test_altered_weights_are_refused(encoder, tmp_path):
    (tmp_path / "head.pth").write_bytes(b"x")
    with pytest.raises(ValueError, match="SHA-256"):
        Aesthetic(str(tmp_path / "head.pth"), sha256="0" * 64, encoder=encoder)(film())
    assert "evaluate.aesthetic.head" in Aesthetic().missing()


# ---------------------------------------------------------------------- features of clips
def test_i3d_loads_the_published_names_and_shapes():
    """12.7 M numbers in 344 tensors: 57 convolutions with five tensors of batch normalisation each, and the logits."""
    with torch.device("meta"):
        state = InceptionI3d().state_dict()
    assert state["Conv3d_1a_7x7.conv3d.weight"].shape == (64, 3, 7, 7, 7)
    assert state["Mixed_4f.b1b.conv3d.weight"].shape == (320, 160, 3, 3, 3)
    assert state["Mixed_5c.b3b.bn.running_var"].shape == (128,)
    assert state["logits.conv3d.weight"].shape == (400, 1024, 1, 1, 1)
    assert len(state) == 57 * 6 + 2
    trained = (v for k, v in state.items() if not k.endswith(("running_mean", "running_var", "num_batches_tracked")))
    assert sum(v.numel() for v in trained) == 12_697_264


@pytest.mark.parametrize(("size", "k", "s"), [(8, 3, 2), (7, 3, 2), (224, 7, 2), (5, 2, 2), (6, 3, 1)])
def test_same_padding_gives_the_size_of_tensorflow(size, k, s):
    """⌈size/stride⌉ windows, and the odd zero at the end."""
    x = same(torch.ones(1, 1, size, size, size), (k,) * 3, (s,) * 3)
    assert (x.shape[2] - k) // s + 1 == -(-size // s)
    before = int((x[0, 0, :, x.shape[3] // 2, x.shape[4] // 2] == 0).int().argmin())
    assert before == (x.shape[2] - size) // 2


def test_i3d_loads_from_a_file_and_answers(tmp_path):
    i3d = I3D(str(tiny.i3d(tmp_path / "i3d.pt")), width=1 / 32)
    clips = torch.rand(2, 9, 16, 16, 3, generator=torch.Generator().manual_seed(0))
    x = i3d.prepared(clips)
    assert x.shape == (2, 3, 9, 224, 224) and -1 <= float(x.min()) < float(x.max()) <= 1
    features = i3d(clips)
    assert features.shape == (2, 400) and torch.isfinite(features).all()
    with pytest.raises(RuntimeError, match="size mismatch"):
        I3D(i3d.checkpoint)(clips)


def test_videomae_loads_from_a_folder_and_answers(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    videomae = VideoMAE(str(tiny.videomae(tmp_path / "videomae")))
    assert videomae.missing() is None
    clips = torch.rand(3, 4, 24, 24, 3, generator=torch.Generator().manual_seed(0))
    features = videomae(clips)
    assert features.shape == (3, 16)
    assert not torch.allclose(features, videomae(clips.flip(1))), "it sees the order of the frames"
    with pytest.raises(ValueError, match="takes clips of 4 frames, got 5"):
        videomae(torch.rand(1, 5, 24, 24, 3))
    assert "hf download MCG-NJU" in VideoMAE().missing()
