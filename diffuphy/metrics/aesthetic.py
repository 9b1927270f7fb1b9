"""LAION's aesthetic score: a linear head on CLIP, fitted to what people liked (Schuhmann et al. 2022)."""

from dataclasses import dataclass, field
from functools import cached_property

from torch import Tensor

from diffuphy.metrics.encoder import Encoder, OpenClip
from diffuphy.models import missing_file, read


@dataclass(frozen=True)
class Aesthetic:
    """w·e + b with the unit vector e of a picture: about 1 to 10, 5 is ordinary."""

    head: str = "sa_0_4_vit_l_14_linear.pth"
    """File of the head, of LAION's aesthetic-predictor or the same as safetensors: a path, or a name of
    ``conf/models.yaml``."""
    sha256: str = ""
    """What the file must have; empty trusts it."""
    encoder: Encoder = field(
        default_factory=lambda: OpenClip("ViT-L-14-quickgelu", "openai", "timm/vit_large_patch14_clip_224.openai")
    )
    """The CLIP that the head was fitted to: ViT-L-14 for heads of 768 numbers, ViT-B-32 for those of 512."""

    def missing(self) -> str | None:
        return missing_file(self.head, "evaluate.aesthetic.head", self.sha256) or self.encoder.missing()

    @cached_property
    def _head(self) -> tuple[Tensor, Tensor]:
        """w (D,) and b (1,)."""
        state = read(self.head, self.sha256)
        if set(state) != {"weight", "bias"} or state["weight"].ndim != 2 or len(state["weight"]) != 1:
            shapes = {k: tuple(v.shape) for k, v in state.items()}
            raise ValueError(f"{self.head} must hold weight (1, D) and bias (1,), got {shapes}")
        return state["weight"][0].float(), state["bias"].float()

    def __call__(self, rgb: Tensor) -> Tensor:
        """Score of each picture (n, H, W, 3) in [0, 1], shape (n,).

        Raises:
            ValueError: a head that was fitted to another encoder.
        """
        e = self.encoder.pictures(rgb)
        w, b = (t.to(e.device) for t in self._head)
        if len(w) != e.shape[1]:
            raise ValueError(f"the head takes {len(w)} numbers, the encoder gives {e.shape[1]}; they must be a pair")
        return e @ w + b
