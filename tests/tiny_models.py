"""Tiny random-weight models of the real classes, saved as a user finds them, so that ``from_pretrained`` itself is
tested offline.

Every builder writes one folder in the layout of diffusers: ``unet``, ``vae``, ``text_encoder``, ``tokenizer``,
``scheduler``.
"""

from pathlib import Path

import torch

DIM = 32


def byte_symbols() -> list[str]:
    """The 256 printable stand-ins for bytes of GPT-2's and CLIP's tokenizers (Radford et al. 2019)."""
    printable = [*range(ord("!"), ord("~") + 1), *range(ord("¡"), ord("¬") + 1), *range(ord("®"), ord("ÿ") + 1)]
    rest = iter(range(256, 512))
    return [chr(b) if b in printable else chr(next(rest)) for b in range(256)]


def tokenizer():
    """A CLIPTokenizer of bytes without merges: any string tokenises, and the embedding stays small."""
    from transformers import CLIPTokenizer

    symbols = byte_symbols()
    words = [*symbols, *(s + "</w>" for s in symbols), "<|startoftext|>", "<|endoftext|>"]
    return CLIPTokenizer(vocab={w: i for i, w in enumerate(words)}, merges=[], model_max_length=77)


def save_text(folder: Path) -> None:
    from transformers import CLIPTextConfig, CLIPTextModel

    words = tokenizer()
    words.save_pretrained(folder / "tokenizer")
    config = CLIPTextConfig(
        vocab_size=len(words),
        hidden_size=DIM,
        intermediate_size=37,
        num_attention_heads=4,
        num_hidden_layers=2,
        max_position_embeddings=77,
        bos_token_id=words.bos_token_id,
        eos_token_id=words.eos_token_id,
        pad_token_id=words.pad_token_id,
    )
    torch.manual_seed(0)
    CLIPTextModel(config).save_pretrained(folder / "text_encoder")


def save_vae(folder: Path) -> None:
    from diffusers import AutoencoderKL

    torch.manual_seed(1)
    AutoencoderKL(
        block_out_channels=[8, 8, 16, 16],
        down_block_types=["DownEncoderBlock2D"] * 4,
        up_block_types=["UpDecoderBlock2D"] * 4,
        latent_channels=4,
        layers_per_block=1,
        norm_num_groups=4,
    ).save_pretrained(folder / "vae")


def save_scheduler(folder: Path, prediction: str) -> None:
    from diffusers import DDIMScheduler

    DDIMScheduler(
        beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", clip_sample=False, prediction_type=prediction
    ).save_pretrained(folder / "scheduler")


def stable_diffusion(folder: Path, prediction: str = "epsilon") -> Path:
    """Stable Diffusion with 0.1 M parameters."""
    from diffusers import UNet2DConditionModel

    torch.manual_seed(2)
    UNet2DConditionModel(
        block_out_channels=(8, 16),
        layers_per_block=1,
        in_channels=4,
        out_channels=4,
        down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
        up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
        cross_attention_dim=DIM,
        attention_head_dim=4,
        norm_num_groups=4,
    ).save_pretrained(folder / "unet")
    save_text(folder)
    save_vae(folder)
    save_scheduler(folder, prediction)
    return folder


def mvdream(folder: Path, prediction: str = "epsilon") -> Path:
    """MVDream with 1 M parameters, its denoiser in the published layout: other names, and a class that nobody has."""
    import json

    import mvdream_reference
    from safetensors.torch import save_file

    torch.manual_seed(2)
    (folder / "unet").mkdir(parents=True)
    weights = {k: v.contiguous() for k, v in mvdream_reference.Denoiser(mvdream_reference.TINY).state_dict().items()}
    save_file(weights, folder / "unet/diffusion_pytorch_model.safetensors", metadata={"format": "pt"})
    (folder / "unet/config.json").write_text(json.dumps(mvdream_reference.TINY), encoding="utf-8")
    save_text(folder)
    save_vae(folder)
    save_scheduler(folder, prediction)
    return folder


def modelscope(folder: Path, prediction: str = "epsilon") -> Path:
    """ModelScope text-to-video with 0.2 M parameters."""
    from diffusers import UNet3DConditionModel

    torch.manual_seed(2)
    UNet3DConditionModel(
        block_out_channels=(8, 16),
        layers_per_block=1,
        in_channels=4,
        out_channels=4,
        down_block_types=("CrossAttnDownBlock3D", "DownBlock3D"),
        up_block_types=("UpBlock3D", "CrossAttnUpBlock3D"),
        cross_attention_dim=DIM,
        attention_head_dim=4,
        norm_num_groups=4,
    ).save_pretrained(folder / "unet")
    save_text(folder)
    save_vae(folder)
    save_scheduler(folder, prediction)
    return folder


def save_t5(folder: Path, kind: str) -> None:
    """A T5 or UMT5 encoder with a tokenizer of single characters."""
    import string

    import transformers

    pieces = [("<pad>", 0.0), ("</s>", 0.0), ("<unk>", 0.0), ("▁", -2.0)]
    words = transformers.T5Tokenizer(vocab=[*pieces, *((c, -3.0) for c in string.printable if c.strip())], extra_ids=0)
    words.save_pretrained(folder / "tokenizer")
    config = getattr(transformers, f"{kind}Config")(
        vocab_size=len(words), d_model=DIM, d_kv=8, d_ff=37, num_layers=2, num_heads=4
    )
    torch.manual_seed(0)
    getattr(transformers, f"{kind}EncoderModel")(config).save_pretrained(folder / "text_encoder")


def wan(folder: Path, shift: float = 3.0) -> Path:
    """Wan 2.1 text-to-video with 0.1 M parameters."""
    import diffusers

    torch.manual_seed(1)
    diffusers.AutoencoderKLWan(
        base_dim=3, z_dim=16, dim_mult=[1, 1, 1, 1], num_res_blocks=1, temperal_downsample=[False, True, True]
    ).save_pretrained(folder / "vae")
    torch.manual_seed(2)
    diffusers.WanTransformer3DModel(
        num_attention_heads=2, attention_head_dim=12, in_channels=16, out_channels=16, text_dim=DIM, ffn_dim=32,
        num_layers=2, rope_max_seq_len=32,
    ).save_pretrained(folder / "transformer")  # fmt: skip
    save_t5(folder, "UMT5")
    # the scheduler that the published folder names
    diffusers.UniPCMultistepScheduler(
        prediction_type="flow_prediction", use_flow_sigmas=True, flow_shift=shift
    ).save_pretrained(folder / "scheduler")
    return folder


def cogvideox(folder: Path, *, rotary: bool = False) -> Path:
    """CogVideoX with 0.1 M parameters; ``rotary`` as the 5b models."""
    import diffusers

    torch.manual_seed(1)
    diffusers.AutoencoderKLCogVideoX(
        block_out_channels=(8, 8, 8, 8), latent_channels=4, layers_per_block=1, norm_num_groups=2,
        down_block_types=("CogVideoXDownBlock3D",) * 4, up_block_types=("CogVideoXUpBlock3D",) * 4,
    ).save_pretrained(folder / "vae")  # fmt: skip
    torch.manual_seed(2)
    diffusers.CogVideoXTransformer3DModel(
        num_attention_heads=2, attention_head_dim=16, in_channels=4, out_channels=4, time_embed_dim=2,
        text_embed_dim=DIM, num_layers=2, sample_width=6, sample_height=4, sample_frames=9, patch_size=2,
        max_text_seq_length=226, use_rotary_positional_embeddings=rotary,
    ).save_pretrained(folder / "transformer")  # fmt: skip
    save_t5(folder, "T5")
    diffusers.CogVideoXDDIMScheduler(
        beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", prediction_type="v_prediction",
        rescale_betas_zero_snr=True, snr_shift_scale=3.0, timestep_spacing="trailing",
    ).save_pretrained(folder / "scheduler")  # fmt: skip
    return folder


def point_e(file: Path, *, kind: str = "vector", features: int = 24, upsampler: bool = False, width: int = 64) -> Path:
    """Point-E with 0.1 M parameters, under the names of the published files; its last layer is not zero."""
    from diffuphy.losses.guidance.point_transformer import PointTransformer

    torch.manual_seed(6)
    settings = {} if kind == "none" else {"kind": kind, "features": features}
    network = PointTransformer(width, 2, width // 64, **settings, upsampler=upsampler)
    torch.save(network.state_dict(), file)
    return file


def clip(folder: Path, *, side: int = 32, dim: int = 24) -> Path:
    """CLIP in the layout of transformers: embeddings of length 24, 16 patches of length 32 of pictures of 32 px."""
    from transformers import CLIPConfig, CLIPModel

    words = tokenizer()
    words.save_pretrained(folder)
    text = {
        "vocab_size": len(words),
        "hidden_size": DIM,
        "intermediate_size": 37,
        "num_attention_heads": 4,
        "num_hidden_layers": 2,
        "max_position_embeddings": 77,
        "bos_token_id": words.bos_token_id,
        "eos_token_id": words.eos_token_id,
        "pad_token_id": words.pad_token_id,
    }
    vision = {
        "hidden_size": DIM,
        "intermediate_size": 37,
        "num_attention_heads": 4,
        "num_hidden_layers": 2,
        "image_size": side,
        "patch_size": 8,
    }
    torch.manual_seed(7)
    CLIPModel(CLIPConfig(text_config=text, vision_config=vision, projection_dim=dim)).save_pretrained(folder)
    return folder


def open_clip(folder: Path, *, width: int = 32, dim: int = 16) -> Path:
    """A CLIP of open_clip for 32 px: 1.6 M parameters, nearly all of them its vocabulary."""
    import json

    import open_clip
    from safetensors.torch import save_file

    model = {
        "embed_dim": dim,
        "quick_gelu": True,
        "vision_cfg": {"image_size": 32, "layers": 1, "width": width, "head_width": 16, "patch_size": 8},
        "text_cfg": {"context_length": 77, "vocab_size": 49408, "width": width, "heads": 2, "layers": 1},
    }
    torch.manual_seed(3)
    folder.mkdir(parents=True, exist_ok=True)
    network = open_clip.CLIP(**model)
    save_file({k: v.contiguous() for k, v in network.state_dict().items()}, folder / "open_clip_model.safetensors")
    means = {"mean": list(open_clip.OPENAI_DATASET_MEAN), "std": list(open_clip.OPENAI_DATASET_STD)}
    config = {"model_cfg": model, "preprocess_cfg": means}
    (folder / "open_clip_config.json").write_text(json.dumps(config), encoding="utf-8")
    return folder


def videomae(folder: Path) -> Path:
    """VideoMAE for 4 frames of 32 px."""
    from transformers import VideoMAEConfig, VideoMAEModel

    torch.manual_seed(4)
    VideoMAEModel(
        VideoMAEConfig(
            image_size=32, patch_size=16, num_frames=4, tubelet_size=2, hidden_size=16, num_hidden_layers=1,
            num_attention_heads=2, intermediate_size=16,
        )
    ).save_pretrained(folder)  # fmt: skip
    return folder


def i3d(file: Path, width: float = 1 / 32) -> Path:
    """I3D with a 32nd of its channels, as a torch file of tensors."""
    from diffuphy.metrics.i3d import InceptionI3d

    torch.manual_seed(5)
    torch.save(InceptionI3d(width=width).state_dict(), file)
    return file
