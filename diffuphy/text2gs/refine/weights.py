"""Pretrained parts of the refinement: what they share, loading and letting go."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

from diffuphy.models import MissingWeights, Parts, choose, command, require, where
from diffuphy.text2gs.refine.protocols import Unavailable

Dtype = Literal["float32", "float16", "bfloat16"]


@dataclass(frozen=True)
class Pretrained:
    """Base of what is loaded with ``from_pretrained``, on first use, and let go of by ``close``."""

    model: str = ""
    """Hub id, or a folder laid out the same way; ``auto`` is the first known one that is on this machine."""
    revision: str | None = None
    """Commit of the hub repository, for results that can be repeated."""
    dtype: Dtype = "float32"
    """Of the network on a GPU; a CPU computes in float32."""
    local_files_only: bool = field(default=False, metadata={"runtime": True})
    """Never ask the network, use what is on this machine."""

    part = ""
    """Its name among the settings of ``refine``."""
    kinds: ClassVar[Parts] = {".": "multimodal"}
    """What is loaded of the repository."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", choose(self.model, type(self).model))
        if not self.model:
            raise ValueError(f"{type(self).__name__}.model is empty; give a hub id or a folder")
        if self.dtype not in ("float32", "float16", "bfloat16"):
            raise ValueError(f"dtype must be float32, float16 or bfloat16, got {self.dtype!r}")

    @cached_property
    def _memory(self) -> dict[str, Any]:
        """Networks: a cache, no setting."""
        return {}

    def options(self, device: str) -> dict[str, Any]:
        """What every ``from_pretrained`` of a network is told; pickled weights are refused."""
        import torch

        dtype = getattr(torch, "float32" if device == "cpu" else self.dtype)
        return self.place() | {"dtype": dtype, "use_safetensors": True}

    def place(self) -> dict[str, Any]:
        """What every ``from_pretrained`` is told."""
        return where(self.revision, self.local_files_only)

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Absence becomes one line that says what to do.

        Raises:
            Unavailable: no weights, none that can be read, no package that reads them, no memory.
        """
        setting = f"refine.{self.part}.model"
        try:
            require(self.model, self.kinds, setting, **self.place())
            with self.running():
                yield
        except MissingWeights as e:
            raise Unavailable(str(e)) from None
        except (OSError, ValueError, ImportError) as e:
            said = " ".join(str(e).split())[:200]
            raise Unavailable(
                f"{self.model!r} cannot be loaded ({type(e).__name__}: {said}); run "
                f"`{command(self.model, self.kinds)}` where there is a network, or set {setting}=/path/to/folder"
            ) from None

    @contextmanager
    def running(self) -> Iterator[None]:
        """Want of memory becomes one line.

        Raises:
            Unavailable: no memory.
        """
        import torch

        try:
            yield
        except torch.OutOfMemoryError:
            raise Unavailable(f"{self.model!r} does not fit into memory; choose a smaller one") from None

    def close(self) -> None:
        """Let go of the networks."""
        if self._memory:
            import torch

            self._memory.clear()
            if torch.cuda.is_available():
                torch.cuda.empty_cache()
