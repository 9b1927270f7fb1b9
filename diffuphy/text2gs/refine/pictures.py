"""Pictures of a prompt, and how well they show it: Stable Diffusion and CLIP, as in Algorithm 1."""

from dataclasses import dataclass
from typing import Any, ClassVar

from diffuphy.models import Parts
from diffuphy.text2gs.refine.protocols import Picture
from diffuphy.text2gs.refine.weights import Dtype, Pretrained


@dataclass(frozen=True)
class Diffusion(Pretrained):
    """Draws with a text-to-image pipeline of diffusers, any that ``AutoPipelineForText2Image`` knows."""

    part: ClassVar[str] = "generator"
    kinds: ClassVar[Parts] = {".": "pipeline"}

    model: str = "stable-diffusion-v1-5/stable-diffusion-v1-5"
    """Hub id or folder; the model that the Gaussians are distilled from shows best what they will be."""
    dtype: Dtype = "float16"
    """Of the network on a GPU; a CPU computes in float32."""
    steps: int = 30
    """Steps of the sampler; more change pictures of Stable Diffusion little."""
    cfg: float = 7.5
    """Classifier-free guidance scale, the model's own default."""
    size: int = 512
    """Side of the picture [px], a multiple of 8: what the model was trained on."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps < 1:
            raise ValueError(f"steps must be at least 1, got {self.steps}")
        if self.cfg < 0:
            raise ValueError(f"cfg must not be negative, got {self.cfg}")
        if self.size < 8 or self.size % 8:
            raise ValueError(f"size must be a positive multiple of 8 px, got {self.size}")

    def _pipeline(self, device: str) -> Any:
        if "pipeline" not in self._memory:
            with self.loading():
                from diffusers import AutoPipelineForText2Image

                pipeline = AutoPipelineForText2Image.from_pretrained(self.model, **self.options(device))
                pipeline.set_progress_bar_config(disable=True)
                self._memory["pipeline"] = pipeline.to(device)
        return self._memory["pipeline"]

    def generate(self, prompt: str, *, seed: int, device: str) -> Picture:
        """See ``ImageGenerator.generate``. The noise is drawn on the CPU: the same picture on every device."""
        import torch

        pipeline = self._pipeline(device)
        with self.running():
            drawn = pipeline(
                prompt,
                num_inference_steps=self.steps,
                guidance_scale=self.cfg,
                height=self.size,
                width=self.size,
                generator=torch.Generator("cpu").manual_seed(seed),
            )
        return Picture(prompt, seed, drawn.images[0])


@dataclass(frozen=True)
class Clip(Pretrained):
    """CLIP score: the cosine of the angle between the embeddings of picture and text.

        s = ⟨f(image), g(text)⟩ / (‖f(image)‖ ‖g(text)‖)  ∈ [−1, 1],

    neither clamped nor scaled (Radford et al. 2021).
    """

    part: ClassVar[str] = "scorer"

    model: str = "openai/clip-vit-base-patch32"
    """Hub id or folder; ViT-B/32 is the one that CLIP scores of papers mean."""

    def _networks(self, device: str) -> tuple[Any, Any]:
        if "networks" not in self._memory:
            with self.loading():
                from transformers import CLIPModel, CLIPProcessor

                model = CLIPModel.from_pretrained(self.model, **self.options(device)).to(device).eval()
                self._memory["networks"] = (model, CLIPProcessor.from_pretrained(self.model, **self.place()))
        return self._memory["networks"]

    def score(self, picture: Picture, text: str, *, device: str) -> float:
        """See ``Scorer.score``. Of a text longer than 77 tokens the first 77 count."""
        import torch

        model, processor = self._networks(device)
        inputs = processor(
            text=[text], images=[picture.image], return_tensors="pt", padding="max_length", truncation=True
        )
        with self.running(), torch.no_grad():
            out = model(**inputs.to(device, model.dtype))
        return float((out.image_embeds.double() * out.text_embeds.double()).sum())
