"""Points: Point-E (Nichol et al. 2022), which knows the shapes of things as coloured clouds. Its weights are MIT."""

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import torch
from torch import Tensor

from diffuphy.losses.guidance import Layout
from diffuphy.losses.guidance.clip_features import picture_features, text_vectors
from diffuphy.losses.guidance.memory import PointFootprint, forward_bytes, weight_bytes
from diffuphy.losses.guidance.point_sampler import draw
from diffuphy.losses.guidance.point_transformer import (
    BIASES,
    CHANNELS,
    PATCHES,
    SCALES,
    STEPS,
    Kind,
    PointTransformer,
)
from diffuphy.losses.schedules import cosine, linear_betas, timestep, variance_preserving
from diffuphy.models import read, where
from diffuphy.models.fetch import file
from diffuphy.models.weights import shapes
from diffuphy.types import Camera, Look, Motion


class Painter(Protocol):
    """What paints consistent pictures of one object, as MVDream does."""

    def pictures(self, words: Look, camera: Camera, generator: torch.Generator) -> Tensor:
        """Pictures (C, H, W, 3) in [0, 1] from C cameras."""
        ...


class Features(NamedTuple):
    """What CLIP says of the text or of each view: the condition of ``PointE``."""

    views: Tensor | None
    """Embeddings (V, D) or patches (V, L, D); None for the network that takes none."""
    order: tuple[int, ...] = (0,)
    """Row b of a batch looks at view ``order[b mod V]``."""

    def rows(self, count: int) -> Tensor | None:
        """The condition of each row of a batch."""
        if self.views is None:
            return None
        return self.views[[self.order[b % len(self.order)] for b in range(count)]]


@dataclass(frozen=True)
class PointE:
    """Point-cloud prior, and the sampler of clouds to start from.

    A cloud is (B, N, 6): positions and rgb in [0, 1]. Its latent is what the network was trained on: positions turned
    into the model's frame, centred, the longest side of their box from −1 to 1; colours in [−1, 1]. Which network it is
    the checkpoint says: conditioned on a text or image embedding (``base_40m_textvec``, ``base_40m_imagevec``), on the
    patches of an image (``base_40m``, ``base_300m``, ``base_1b``), or on nothing (``base_40m_uncond``).

    No network of several views was published. With V pictures each distillation step looks at one of them, drawn
    anew: an unbiased estimate of the mean score over the views at the price of one; sampling takes that mean itself.
    Both suppose that clouds stand in a frame of the object, not of the camera (``text2gs.canonical_frame`` finds out).
    """

    layout: ClassVar[Layout] = "points"

    checkpoint: str = "base_40m_textvec.pt"
    """A published file by name, path or address, or the same as safetensors."""
    sha256: str = ""
    """What that file must have; none is published, empty trusts it."""
    upsampler: str = ""
    """``upsample_40m.pt`` likewise; empty samples coarse clouds."""
    upsampler_sha256: str = ""
    """What that file must have."""
    painter: Painter | None = None
    """What paints the object's views, for networks that look at images; None for those that read the text."""
    clip: str = "openai/clip-vit-large-patch14"
    """Hub id or folder of the CLIP that Point-E was trained with."""
    revision: str | None = None
    """Commit of CLIP's repository."""
    cfg: float = 100.0
    """Guidance scale of distillation, ε̂ = ε̂_∅ + s (ε̂_c − ε̂_∅), as gsgen has it."""
    sample_cfg: float = 3.0
    """Guidance scale of sampling: Point-E's own."""
    steps: int = 64
    """Noise levels of the sampler, of either network."""
    churn: float = 3.0
    """Fresh noise of the sampler, S_churn; the upsampler has none."""
    points: int = 1024
    """Points of a coarse cloud: what the networks were trained with."""
    added: int = 3072
    """Points that the upsampler adds."""
    yaw: float = 90.0
    """Turn about z from the model's frame to ours [deg]: its objects face −y and ours +x, says gsgen."""
    dtype: Literal["float32", "float16", "bfloat16"] = "float32"
    """Of the networks, which were published in float32."""
    seed: int = 0
    """Of the painted views, which a resumed run paints again."""
    local_files_only: bool = field(default=False, metadata={"runtime": True})
    """Never ask the network."""

    def __post_init__(self) -> None:
        if min(self.cfg, self.sample_cfg, self.churn) < 0:
            raise ValueError(
                f"cfg, sample_cfg and churn must not be negative, got {self.cfg}, {self.sample_cfg} and {self.churn}"
            )
        if self.steps < 2 or self.points < 1 or self.added < 1:
            raise ValueError(
                f"steps must be ≥ 2, points and added ≥ 1, got {self.steps}, {self.points} and {self.added}"
            )
        if self.dtype not in ("float32", "float16", "bfloat16"):
            raise ValueError(f"dtype must be float32, float16 or bfloat16, got {self.dtype!r}")

    @cached_property
    def _memory(self) -> dict[Any, Any]:
        """Networks and features: a cache, no setting."""
        return {}

    # ------------------------------------------------------------------ weights and words
    def network(self, device: torch.device) -> PointTransformer:
        """The base network on ``device``, loaded on first use.

        Raises:
            MissingWeights: there is no such file.
            ValueError: other bytes than ``sha256`` says, or tensors of another network.
        """
        return self._network("checkpoint", self.checkpoint, self.sha256, device)

    def _network(self, setting: str, source: str, sha256: str, device: torch.device) -> PointTransformer:
        if setting not in self._memory:
            path = file(source, sha256, f"fit.shape.guidance.{setting}", local=self.local_files_only)
            network = PointTransformer.of(read(str(path))).to(getattr(torch, self.dtype))
            if network.upsampler != (setting == "upsampler"):
                raise ValueError(
                    f"{setting}={source} is {'the' if network.upsampler else 'no'} upsampler; "
                    "checkpoint wants base_*.pt and upsampler upsample_40m.pt"
                )
            self._memory[setting] = network
        return self._memory[setting].to(device)

    def _features(self, words: Look | Motion, camera: Camera, kind: Kind, device: torch.device) -> Tensor | None:
        """Embeddings or patches, (V, ...); painted and embedded once for these words and cameras."""
        if kind == "none":
            return None
        options = where(self.revision, self.local_files_only)
        if self.painter is None:
            if kind == "grid":
                raise ValueError(
                    "this checkpoint of Point-E looks at pictures and nobody paints any; set "
                    "fit.shape.guidance.painter, or use base_40m_textvec.pt, which reads the text"
                )
            key: Any = (words.text,)
            if key not in self._memory:
                self._memory[key] = text_vectors([words.text], self.clip, device, **options)
        else:
            key = (repr(words), kind, camera.viewmats.cpu().numpy().tobytes(), camera.Ks.cpu().numpy().tobytes())
            if key not in self._memory:
                rgb = self.pictures(words, camera, device)
                self._memory[key] = picture_features(rgb, self.clip, patches=kind == "grid", **options)
        return self._memory[key].to(device)

    def pictures(self, words: Look | Motion, camera: Camera, device: torch.device) -> Tensor:
        """The painter's views (C, H, W, 3) in [0, 1]; the same for the same seed. Its networks are freed afterwards."""
        if not isinstance(words, Look) or self.painter is None:
            raise ValueError(f"a painter paints a Look, got {type(words).__name__} and painter={self.painter}")
        once: Any = dataclasses.replace(self.painter) if dataclasses.is_dataclass(self.painter) else self.painter  # type: ignore[type-var]
        generator = torch.Generator().manual_seed(self.seed)
        return once.pictures(words, camera.to(device), generator).clamp(0, 1)

    def footprint(self, count: int) -> PointFootprint:
        """Memory that it takes to judge ``count`` clouds; of the checkpoint only shapes are read.

        Raises:
            MissingWeights: a file is not here; nothing is fetched for this.
        """
        path = file(self.checkpoint, "", "fit.shape.guidance.checkpoint", local=True)
        network = PointTransformer.of(shapes(path))._apply(lambda x: x.to(getattr(torch, self.dtype)))
        length = {"none": (), "vector": (network.features,), "grid": (PATCHES, network.features)}[network.kind]
        rows = count if network.kind == "none" else 2 * count
        with torch.device("meta"):
            x, t = torch.empty(rows, self.points, CHANNELS), torch.zeros(rows, dtype=torch.int64)
            given = [x, t, torch.empty(rows, *length)] if length else [x, t]
            working = forward_bytes(lambda: network(*given), [*given, *network.parameters()])
        painter = getattr(self.painter, "footprint", None)
        return PointFootprint(weight_bytes(network), working, 0 if painter is None else painter(4).peak)

    # ------------------------------------------------------------------ guidance
    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Features:
        """Features of the text, or of the views painted from these cameras in an order drawn by ``generator``."""
        views = self._features(words, camera, self.network(background.device).kind, background.device)
        if views is None or len(views) == 1:
            return Features(views)
        if generator is None:
            raise ValueError("Point-E looks at one view a step: call condition(..., generator=torch.Generator())")
        return Features(views, tuple(torch.randperm(len(views), generator=generator, device=generator.device).tolist()))

    def encode(self, sample: Tensor) -> Tensor:
        """z (B, N, 6) of clouds (B, N, 6): x ↦ (Rᵀ x − c)/r with the centre c and half the longest side r of the box of
        each turned cloud, which are held fixed in the gradient; rgb ↦ 2 rgb − 1."""
        if sample.ndim != 3 or sample.shape[-1] != CHANNELS:
            raise ValueError(f"Point-E takes clouds (B, N, 6) of positions and colours, got {tuple(sample.shape)}")
        x = sample[..., :3] @ self._turn(sample)
        low, high = x.detach().aminmax(dim=1, keepdim=True)
        half = (high - low).amax(-1, keepdim=True) / 2
        if not bool((half > 0).all()):
            raise ValueError("a cloud has no extent: all its points are at one place")
        return torch.cat([(x - (low + high) / 2) / half, 2 * sample[..., 3:] - 1], -1)

    def _turn(self, like: Tensor) -> Tensor:
        """R, which turns the model's frame into ours: x_ours = R x_model, x_modelᵀ = x_oursᵀ R."""
        c, s = math.cos(math.radians(self.yaw)), math.sin(math.radians(self.yaw))
        return like.new_tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def schedule(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """α_t and σ_t of the cosine schedule that the base networks were trained with."""
        return variance_preserving(t, cosine(STEPS))

    @torch.no_grad()
    def predict_noise(self, z_t: Tensor, t: Tensor, cond: Features) -> Tensor:
        """ε̂ = ε̂_∅ + cfg (ε̂_c − ε̂_∅) in float32, ∅ being zeros; one call of the network on both."""
        network = self.network(z_t.device)
        k, rows = timestep(t, STEPS).to(z_t.device), cond.rows(len(z_t))
        if rows is None:
            return network(z_t, k)[..., :CHANNELS].float()
        both = network(torch.cat([z_t, z_t]), torch.cat([k, k]), torch.cat([torch.zeros_like(rows), rows]))
        without, given = both[..., :CHANNELS].float().chunk(2)
        return without + self.cfg * (given - without)

    # ------------------------------------------------------------------ sampling
    @property
    def count(self) -> int:
        """Points of a sampled cloud."""
        return self.points + (self.added if self.upsampler else 0)

    @torch.no_grad()
    def sample(
        self,
        words: Look,
        camera: Camera,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
        view: int | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Positions (n, 3), longest side about 2, facing +x, and rgb (n, 3) in [0, 1] of an object, as Point-E draws
        it: ``points`` of them, and ``added`` more if there is an upsampler.

        Several views are looked at together: D = D_∅ + s (1/V Σ_v D_v − D_∅).

        Args:
            camera: from where the painter paints; not looked at without one.
            generator: source of all noise.
            view: look at this one alone.
        """
        device = torch.device(device)
        base = self.network(device)
        seen = slice(None) if view is None else slice(view, view + 1)

        def features(kind: Kind) -> Tensor | None:
            views = self._features(words, camera, kind, device)
            return None if views is None else views[seen]

        settings = {"steps": self.steps, "scale": self.sample_cfg, "generator": generator}
        z = draw(base, cosine(STEPS), features(base.kind), self.points, 120.0, churn=self.churn, **settings)
        if self.upsampler:
            network = self._network("upsampler", self.upsampler, self.upsampler_sha256, device)
            patches = None if self.painter is None else features(network.kind)
            scales, biases = (z.new_tensor(v) for v in (SCALES, BIASES))
            coarse = (z - biases) / scales
            z = torch.cat(
                [z, draw(network, linear_betas(STEPS), patches, self.added, 160.0, coarse=coarse, **settings)]
            )
        return z[:, :3] @ self._turn(z).T, ((z[:, 3:] + 1) / 2).clamp(0, 1)
