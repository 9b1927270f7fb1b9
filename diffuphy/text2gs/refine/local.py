"""A refiner on this machine: any model of transformers that reads pictures and writes text."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from diffuphy.text2gs.refine.chat import Chat
from diffuphy.text2gs.refine.reply import Message, Unusable
from diffuphy.text2gs.refine.weights import Dtype, Pretrained


@dataclass(frozen=True)
class Transformers(Pretrained, Chat):
    """A model of the class ``AutoModelForImageTextToText``: Qwen-VL, SmolVLM, LLaVA, ...; it answers greedily."""

    part: ClassVar[str] = "refiner"

    model: str = "Qwen/Qwen3-VL-2B-Instruct"
    """Hub id or folder. Smaller ones seldom hold the form of the answer; larger ones reason better."""
    dtype: Dtype = "bfloat16"
    """Of the network on a GPU, as such models are trained; a CPU computes in float32."""
    max_new_tokens: int = 1024
    """Longest answer; five short paragraphs need about 400."""

    def __post_init__(self) -> None:
        Pretrained.__post_init__(self)
        Chat.__post_init__(self)
        if self.max_new_tokens < 1:
            raise ValueError(f"max_new_tokens must be at least 1, got {self.max_new_tokens}")

    @property
    def identity(self) -> str:
        return f"transformers {self.model}" + (f" at {self.revision}" if self.revision else "")

    def _networks(self, device: str) -> tuple[Any, Any]:
        if "networks" not in self._memory:
            with self.loading():
                from transformers import AutoModelForImageTextToText, AutoProcessor

                model = AutoModelForImageTextToText.from_pretrained(self.model, **self.options(device))
                processor = AutoProcessor.from_pretrained(self.model, **self.place())
                self._memory["networks"] = (model.to(device).eval(), processor)
        return self._memory["networks"]

    def ask(self, messages: Sequence[Message], *, device: str) -> str:
        """See ``Chat.ask``; the conversation is written in the form that the model's own template gives it."""
        import torch

        model, processor = self._networks(device)
        inputs = processor.apply_chat_template(
            [{"role": m.role, "content": _content(m)} for m in messages],
            add_generation_prompt=True,
            tokenize=True,
            return_dict=True,
            return_tensors="pt",
        ).to(device, model.dtype)
        with self.running(), torch.no_grad():
            out = model.generate(**inputs, max_new_tokens=self.max_new_tokens, do_sample=False)
        said = out[0, inputs["input_ids"].shape[1] :]
        ends = model.generation_config.eos_token_id
        ended = said[-1].item() in (ends if isinstance(ends, list) else [ends])
        if len(said) >= self.max_new_tokens and not ended:
            raise Unusable("it was cut off before its end; be brief")
        return processor.decode(said, skip_special_tokens=True)


def _content(message: Message) -> list[dict[str, Any]]:
    picture = [] if message.image is None else [{"type": "image", "image": message.image.convert("RGB")}]
    return [*picture, {"type": "text", "text": message.text}]
