"""What ``conf/models.yaml`` says is what the code asks for and what the models are."""

import dataclasses
import importlib
import pkgutil
import re
import sys
import tomllib
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from diffuphy.models import choose, known, roles
from diffuphy.models.registry import Model, Part, _model, for_backend, stand_ins

sys.path.insert(0, str(Path(__file__).parent))
import hub

ROOT = Path(__file__).parents[2]
MODELS = [m for models in roles().values() for m in models]
HUB = re.compile(r"[\w.-]+/[\w.-]+")
ROOMS = ("losses.guidance", "metrics", "text2gs")


def preferred(model: Model) -> Model:
    """The first that could be in its place."""
    return next(m for m in roles()[model.role] if m.backend == model.backend)


def defaults():
    """Every setting of every component whose default is a name of the hub or of the registry."""
    for room in ROOMS:
        package = importlib.import_module(f"diffuphy.{room}")
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".kernels" in info.name:
                continue
            for thing in vars(importlib.import_module(info.name)).values():
                if dataclasses.is_dataclass(thing) and isinstance(thing, type) and thing.__module__ == info.name:
                    for f in dataclasses.fields(thing):
                        if isinstance(f.default, str) and (known(f.default) or HUB.fullmatch(f.default)):
                            yield f"{thing.__name__}.{f.name}", f.default


def configured():
    """The same of every file of the configuration."""

    def walk(node, path):
        for key, value in node.items() if isinstance(node, dict) else ():
            if isinstance(value, dict):
                yield from walk(value, f"{path}.{key}")
            elif isinstance(value, str) and (known(value) or (key in ("model", "repo") and HUB.fullmatch(value))):
                yield f"{path}.{key}", value

    for file in sorted((ROOT / "conf").rglob("*.yaml")):
        if file.name != "models.yaml":
            yield from walk(OmegaConf.to_container(OmegaConf.load(file), resolve=False), file.stem)


def test_what_components_and_configuration_name_is_the_preferred_of_its_role():
    """A default that is not known, or not the first, would be fetched without anybody being told its licence."""
    names = [*defaults(), *configured()]
    assert {"StableDiffusion.model", "Aesthetic.head", "paper.video.checkpoint"} <= {n for n, _ in names}
    for where, name in names:
        entry = known(name)
        assert entry is not None, f"{where}={name} is not in conf/models.yaml"
        assert preferred(entry).id == name, f"{where}={name}, but {entry.role} prefers {preferred(entry).id}"


def test_every_setting_of_a_role_has_a_group():
    """The remedy that a message names begins with a group of the configuration."""
    groups = {p.name for p in (ROOT / "conf").iterdir() if p.is_dir()}
    assert {m.setting.split(".")[0] for m in MODELS} <= groups


def test_names_are_unique_and_nothing_is_invented():
    ids = [m.id for m in MODELS]
    assert len(set(ids)) == len(ids)
    for m in MODELS:
        assert m.licence and (m.url or HUB.fullmatch(m.id))
        assert m.revision is None or re.fullmatch(r"[0-9a-f]{40}", m.revision)
        assert all(re.fullmatch(r"[0-9a-f]{64}", d) for d in (m.sha256 or {}).values())
        assert m.noncommercial == ("-NC" in m.licence)


def test_the_wheel_carries_it():
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    assert (
        build["targets"]["wheel"]["force-include"]["conf"] == "diffuphy/conf" and (ROOT / "conf/models.yaml").is_file()
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [({"licens": "MIT"}, "licens"), ({"stored": "float8"}, "float8"), ({"unverified": ["colour"]}, "colour"),
     ({"url": "https://a/b"}, "a single file has a url"), ({"parts": {"unet": {"kind": "magic"}}}, "magic")],
)  # fmt: skip
def test_a_mistake_in_the_file_is_named(change, said):
    right = {"id": "a/b", "class": "C", "licence": "MIT", "parts": {"unet": {"kind": "diffusers", "parameters": 3}}}
    assert _model("image", "guidance.model", right).parts["unet"] == Part("diffusers", 3)
    with pytest.raises(ValueError, match=said):
        _model("image", "guidance.model", right | change)


def test_size_follows_from_parameters_and_precision():
    """Two numbers of float16 take 2·2 bytes; with one unknown nothing is said."""
    model = Model("a/b", "r", "s", {"u": Part("diffusers", 2), "t": Part("tokenizer")}, "MIT", "C", stored="float16")
    assert model.bytes == 4
    assert dataclasses.replace(model, stored=None).bytes is None
    assert dataclasses.replace(model, parts={"u": Part("diffusers", 2), "v": Part("diffusers")}).bytes is None


# ---------------------------------------------------------------------- what is on the machine
@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "hub"


def test_auto_takes_the_first_that_is_here_and_the_preferred_if_none_is(cache):
    first, second, third = for_backend("stable_diffusion")
    assert choose("auto", first.id) == first.id
    hub.cached(cache, third.id, hub.whole(third))
    assert choose("auto", first.id) == third.id and stand_ins(first) == [third]
    hub.cached(cache, second.id, hub.whole(second))
    assert choose("auto", first.id) == second.id
    hub.cached(cache, first.id, hub.whole(first))
    assert choose("auto", first.id) == first.id


def test_auto_never_swaps_what_was_named_nor_crosses_backends(cache):
    """A video model of another library cannot take the place of ModelScope; a name stays what it is."""
    (modelscope,), (wan,) = for_backend("modelscope"), for_backend("wan")
    hub.cached(cache, wan.id, hub.whole(wan))
    assert choose("auto", modelscope.id) == modelscope.id and choose("a/b", modelscope.id) == "a/b"
    with pytest.raises(ValueError, match="auto"):
        choose("auto", "nobody/knows")


def test_components_keep_what_auto_chose(cache):
    """What results depend on is a name, never ``auto``."""
    from diffuphy.losses.guidance.stable_diffusion import StableDiffusion
    from diffuphy.text2gs.refine.local import Transformers

    first, second, _ = for_backend("stable_diffusion")
    hub.cached(cache, second.id, hub.whole(second))
    assert StableDiffusion(model="auto").model == second.id and StableDiffusion().model == first.id
    assert Transformers(model="auto").model == roles()["chat-local"][0].id


# ---------------------------------------------------------------------- the real architectures
def test_parameters_are_those_of_the_real_architectures():
    """Counted on the meta device, from the published configurations of each; equal to the last one."""
    import diffusers as d
    import open_clip
    import transformers as t

    from diffuphy.metrics.i3d import InceptionI3d

    sd2 = {"cross_attention_dim": 1024, "attention_head_dim": [5, 10, 20, 20], "use_linear_projection": True}
    large = {"hidden_size": 768, "intermediate_size": 3072, "num_hidden_layers": 12, "num_attention_heads": 12}
    vision = {"hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24, "num_attention_heads": 16,
              "patch_size": 14}  # fmt: skip
    view = {"class_embed_type": "projection", "projection_class_embeddings_input_dim": 16}
    makers = {
        ("image", 0, "unet"): lambda: d.UNet2DConditionModel(cross_attention_dim=768),
        ("image", 0, "vae"): lambda: d.AutoencoderKL(
            block_out_channels=[128, 256, 512, 512], layers_per_block=2,
            down_block_types=["DownEncoderBlock2D"] * 4, up_block_types=["UpDecoderBlock2D"] * 4,
        ),
        ("image", 0, "text_encoder"): lambda: t.CLIPTextModel(t.CLIPTextConfig(**large)),
        ("image", 1, "unet"): lambda: d.UNet2DConditionModel(**sd2),
        ("image", 1, "text_encoder"): lambda: t.CLIPTextModel(
            t.CLIPTextConfig(hidden_size=1024, intermediate_size=4096, num_hidden_layers=23, num_attention_heads=16)
        ),
        ("views", 0, "unet"): lambda: d.UNet2DConditionModel(**sd2, **view),
        ("video", 0, "unet"): d.UNet3DConditionModel,
        ("video", 1, "transformer"): lambda: d.WanTransformer3DModel(
            num_attention_heads=12, attention_head_dim=128, ffn_dim=8960, num_layers=30
        ),
        ("video", 1, "vae"): d.AutoencoderKLWan,
        ("video", 1, "text_encoder"): lambda: t.UMT5EncoderModel(
            t.UMT5Config(vocab_size=256384, d_model=4096, d_ff=10240, d_kv=64, num_heads=64, num_layers=24)
        ),
        ("video", 2, "transformer"): d.CogVideoXTransformer3DModel,
        ("video", 2, "vae"): d.AutoencoderKLCogVideoX,
        ("points-clip", 0, "."): lambda: t.CLIPModel(
            t.CLIPConfig(text_config=large, vision_config=vision, projection_dim=768)
        ),
        ("clip-refine", 0, "."): lambda: t.CLIPModel(t.CLIPConfig()),
        ("clip", 0, "."): lambda: open_clip.CLIP(**open_clip.get_model_config("ViT-B-32-quickgelu")),
        ("clip-aesthetic", 0, "."): lambda: open_clip.CLIP(**open_clip.get_model_config("ViT-L-14-quickgelu")),
        ("fvd-motion", 0, "."): lambda: t.VideoMAEModel(t.VideoMAEConfig()),
        ("fvd", 0, "i3d_pretrained_400.pt"): InceptionI3d,
        ("aesthetic", 0, "sa_0_4_vit_l_14_linear.pth"): lambda: torch.nn.Linear(768, 1),
    }  # fmt: skip
    for (role, k, part), make in makers.items():
        with torch.device("meta"):
            counted = sum(p.numel() for p in make().parameters())
        assert counted == roles()[role][k].parts[part].parameters, (role, k, part)
