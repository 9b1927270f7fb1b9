"""Tiny networks of the real classes of refinement, saved as a user finds them: a language model that sees, Stable
Diffusion as a whole pipeline, CLIP."""

import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parents[2]))
import tiny_models

SPECIAL = [
    "<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>",
    "<|video_pad|>",
]  # fmt: skip
TEMPLATE = (
    "{% for m in messages %}<|im_start|>{{ m.role }}\n{% for c in m.content %}{% if c.type == 'image' %}"
    "<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ c.text }}{% endif %}{% endfor %}<|im_end|>\n{% endfor %}"
    "{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)
"""The form that Qwen's own template gives a conversation."""


def _tokenizer(said: str):
    """Bytes, the special tokens of Qwen, and one token for the whole of ``said``."""
    from tokenizers import AddedToken, Tokenizer, decoders, models, pre_tokenizers
    from transformers import Qwen2TokenizerFast

    words = Tokenizer(models.BPE({s: i for i, s in enumerate(tiny_models.byte_symbols())}, []))
    words.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    words.decoder = decoders.ByteLevel()
    words.add_special_tokens(SPECIAL)
    words.add_tokens([AddedToken(said, normalized=False)])
    return Qwen2TokenizerFast(tokenizer_object=words, eos_token="<|im_end|>", pad_token="<|endoftext|>")


def qwen(folder: Path, said: str | None = None) -> Path:
    """Qwen3-VL with 0.1 M parameters; with ``said`` it answers just that, else what random weights say.

    Without attention and perceptrons the last hidden state is the embedding of the last token: e₀ for all of them, e₁
    for the token ``said``; the head sends e₀ to ``said`` and e₁ to the end.
    """
    from transformers import (
        Qwen2VLImageProcessor,
        Qwen3VLConfig,
        Qwen3VLForConditionalGeneration,
        Qwen3VLProcessor,
        Qwen3VLVideoProcessor,
    )

    words = _tokenizer(said or "{}")
    ids = {s: words.convert_tokens_to_ids(s) for s in SPECIAL}
    text = {
        "vocab_size": len(words), "hidden_size": 32, "intermediate_size": 16, "num_hidden_layers": 1,
        "num_attention_heads": 2, "num_key_value_heads": 2, "head_dim": 16,
        "rope_parameters": {"rope_type": "default", "rope_theta": 1e4, "mrope_section": [4, 2, 2]},
    }  # fmt: skip
    vision = {
        "depth": 1, "hidden_size": 16, "intermediate_size": 16, "num_heads": 2, "patch_size": 4, "out_hidden_size": 32,
        "num_position_embeddings": 16, "deepstack_visual_indexes": [0],
    }  # fmt: skip
    config = Qwen3VLConfig(
        text_config=text,
        vision_config=vision,
        image_token_id=ids["<|image_pad|>"],
        video_token_id=ids["<|video_pad|>"],
        vision_start_token_id=ids["<|vision_start|>"],
        vision_end_token_id=ids["<|vision_end|>"],
    )
    torch.manual_seed(0)
    model = Qwen3VLForConditionalGeneration(config)
    model.generation_config.eos_token_id = ids["<|im_end|>"]
    model.generation_config.pad_token_id = ids["<|endoftext|>"]
    if said is not None:
        answer = words.convert_tokens_to_ids(said)
        with torch.no_grad():
            for layer in model.model.language_model.layers:
                layer.self_attn.o_proj.weight.zero_()
                layer.mlp.down_proj.weight.zero_()
            model.model.language_model.embed_tokens.weight.zero_()
            model.model.language_model.embed_tokens.weight[:, 0] = 1.0
            model.model.language_model.embed_tokens.weight[answer] = torch.eye(32)[1]
            model.lm_head.weight.zero_()
            model.lm_head.weight[answer, 0] = 1.0
            model.lm_head.weight[ids["<|im_end|>"], 1] = 1.0
    model.save_pretrained(folder)
    sizes = {"shortest_edge": 64, "longest_edge": 4096}
    pictures = Qwen2VLImageProcessor(patch_size=4, size=sizes)
    films = Qwen3VLVideoProcessor(patch_size=4, size=sizes)
    Qwen3VLProcessor(pictures, words, films, chat_template=TEMPLATE).save_pretrained(folder)
    return folder


def stable_diffusion(folder: Path) -> Path:
    """Stable Diffusion with 0.1 M parameters, with the list of its parts that a pipeline begins with."""
    from diffusers import AutoencoderKL, DDIMScheduler, StableDiffusionPipeline, UNet2DConditionModel
    from transformers import CLIPTextModel, CLIPTokenizer

    parts = tiny_models.stable_diffusion(folder / "parts")
    StableDiffusionPipeline(
        vae=AutoencoderKL.from_pretrained(parts / "vae"),
        text_encoder=CLIPTextModel.from_pretrained(parts / "text_encoder"),
        tokenizer=CLIPTokenizer.from_pretrained(parts / "tokenizer"),
        unet=UNet2DConditionModel.from_pretrained(parts / "unet"),
        scheduler=DDIMScheduler.from_pretrained(parts / "scheduler"),
        safety_checker=None,
        feature_extractor=None,
        requires_safety_checker=False,
    ).save_pretrained(folder)
    return folder


def clip(folder: Path) -> Path:
    """CLIP with 0.04 M parameters."""
    from transformers import CLIPConfig, CLIPImageProcessor, CLIPModel, CLIPProcessor

    words = tiny_models.tokenizer()
    small = {"hidden_size": 16, "intermediate_size": 16, "num_attention_heads": 2, "num_hidden_layers": 1}
    text = small | {
        "vocab_size": len(words), "max_position_embeddings": 77, "bos_token_id": words.bos_token_id,
        "eos_token_id": words.eos_token_id, "pad_token_id": words.pad_token_id,
    }  # fmt: skip
    config = CLIPConfig(text_config=text, vision_config=small | {"image_size": 16, "patch_size": 8}, projection_dim=16)
    torch.manual_seed(0)
    CLIPModel(config).save_pretrained(folder)
    square = {"height": 16, "width": 16}
    pictures = CLIPImageProcessor(size={"shortest_edge": 16}, crop_size=square)
    CLIPProcessor(pictures, words).save_pretrained(folder)
    return folder
