"""How much memory a diffusion model will take, before any of its weights is there.

Weights are counted on networks built from ``config.json`` without storage (the "meta" device). Activations are measured
by running those networks on tensors without storage and adding up what is alive at any moment: everything that torch
would allocate, but for the allocator's own rounding, workspaces of convolutions and the context of a GPU.
"""

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves


@dataclass(frozen=True)
class Footprint:
    """Memory of a guidance on the device [bytes]."""

    unet: int
    """Weights of the denoiser, in its precision."""
    vae: int
    """Weights of the autoencoder, float32."""
    text: int
    """Weights of the text encoder, which is gone before the others come."""
    denoising: int
    """Most that is alive during one call of the denoiser, besides its weights."""
    encoding: int
    """Most that is alive while one frame is encoded and its gradient computed, likewise."""
    offload: bool = False
    """Whether each network is on the device only while it computes."""

    @property
    def peak(self) -> int:
        """Most that is taken at any time."""
        steps = (self.unet + self.denoising, self.vae + self.encoding)
        both = max(steps) if self.offload else self.unet + self.vae + max(self.denoising, self.encoding)
        return max(self.text, both)

    @property
    def parts(self) -> str:
        """Each part in words."""
        parts = {"denoiser": self.unet, "autoencoder": self.vae, "text encoder, first": self.text,
                 "denoising": self.denoising, "encoding": self.encoding}  # fmt: skip
        return ", ".join(f"{name} {gigabytes(size)}" for name, size in parts.items())


def gigabytes(n: int) -> str:
    """A size in GB with two decimals, in MB below 10 MB."""
    return f"{n / 1e9:.2f} GB" if n >= 1e7 else f"{n / 1e6:.2f} MB"


@dataclass(frozen=True)
class PointFootprint:
    """Memory of Point-E on the device [bytes]."""

    network: int
    """Weights of the base network, in its precision."""
    working: int
    """Most that is alive during one call of it, besides."""
    painting: int
    """What the painter takes, before the network works; 0 without one."""

    @property
    def peak(self) -> int:
        """Most that is taken at any time."""
        return max(self.painting, self.network + self.working)

    @property
    def parts(self) -> str:
        """Each part in words."""
        first = f"painting, first {gigabytes(self.painting)}, " if self.painting else ""
        return f"{first}network {gigabytes(self.network)}, working {gigabytes(self.working)}"


def weight_bytes(network: Any) -> int:
    """Bytes of all parameters and buffers."""
    return sum(x.numel() * x.element_size() for x in (*network.parameters(), *network.buffers()))


class _Lean(TorchFunctionMode):
    """Attention without the matrix of all pairs, as on a GPU (Dao et al. 2022); for tensors without storage."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is torch.nn.functional.scaled_dot_product_attention:
            query = args[0] if args else kwargs["query"]
            return query.clone() if torch.is_grad_enabled() else torch.empty_like(query)
        return func(*args, **(kwargs or {}))


class _Alive(TorchDispatchMode):
    """Adds up the storages that operations make, while they live."""

    def __init__(self) -> None:
        super().__init__()
        self.now = self.peak = 0
        self._known: set[int] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        for leaf in tree_leaves(out):
            if isinstance(leaf, Tensor):
                self._see(leaf.untyped_storage())
        return out

    def ignore(self, tensors: Any) -> None:
        """Do not count what was there before."""
        self._known |= {x.untyped_storage()._cdata for x in tensors}

    def _see(self, storage: Any) -> None:
        key, size = storage._cdata, storage.nbytes()
        if key in self._known:
            return
        self._known.add(key)
        self.now += size
        self.peak = max(self.peak, self.now)
        weakref.finalize(storage, self._gone, key, size)

    def _gone(self, key: int, size: int) -> None:
        self._known.discard(key)
        self.now -= size


def peak_bytes(run: Callable[[], Any], given: Any = ()) -> int:
    """Most bytes that operations of ``run`` keep alive at one time, besides the tensors ``given``."""
    alive = _Alive()
    alive.ignore(given)
    with alive:
        run()
    return alive.peak


def forward_bytes(run: Callable[[], Any], given: Any = ()) -> int:
    """The same of networks that are only asked, not differentiated."""
    with _Lean(), torch.no_grad():
        return peak_bytes(run, given)


def footprint(prior: Any, count: int) -> Footprint:
    """Of a latent diffusion model that judges ``count`` pictures, or a clip of ``count`` frames, at a time.

    Args:
        prior: ``LatentDiffusion``; only its ``config.json`` files are read.

    Raises:
        MissingWeights: not even those are on this machine or in reach.
    """
    dtype = getattr(torch, prior.dtype)
    with torch.device("meta"):
        unet, vae, text = (
            prior.skeleton(part).eval().requires_grad_(False) for part in ("unet", "vae", "text_encoder")
        )
        unet, text = (module._apply(lambda x: x.to(dtype)) for module in (unet, text))
        z = torch.empty(*prior.latents(count))
        length = prior.text_length or text.config.max_position_embeddings
        states = torch.empty(2 * len(z), length, text.config.hidden_size, dtype=dtype)
        width = unet.config.get("projection_class_embeddings_input_dim")
        labels = torch.empty(2 * len(z), width, dtype=dtype) if width else None
        rows = prior.rows(torch.cat([z, z]).to(dtype), torch.zeros(2 * len(z)), states, labels)
        given = {k: v[: prior.chunk] for k, v in rows.items()} | prior.shared(unet, z)
        frame = torch.empty(prior.sight(count), requires_grad=True)

        @torch.enable_grad()  # also asked for while nothing else is differentiated
        def encode() -> None:
            z = vae.encode(frame).latent_dist.mode()
            torch.autograd.grad(z, frame, torch.empty_like(z))

        with _Lean(), torch.enable_grad():
            with torch.no_grad():
                denoising = peak_bytes(lambda: unet(**given), [*tree_leaves(given), *unet.parameters()])
            encoding = peak_bytes(encode, [frame, *vae.parameters()])
    weights = (weight_bytes(module) for module in (unet, vae, text))
    return Footprint(*weights, denoising, encoding, offload=prior.offload)
