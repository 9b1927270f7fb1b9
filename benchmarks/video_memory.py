"""Memory and time of a step of video score distillation."""

import contextlib
from collections.abc import Iterator
import torch
from torch import Tensor


class Saved:
    """Bytes of tensors that graphs keep for their backward pass, each storage counted once."""

    def __init__(self) -> None:
        self.now, self.peak = 0, 0
        self._uses: dict[int, int] = {}

    def keep(self, tensor: Tensor) -> "_Kept":
        return _Kept(self, tensor)


class _Kept:
    """A saved tensor; counted until its node lets it go."""

    def __init__(self, saved: Saved, tensor: Tensor):
        self.saved, self.tensor = saved, tensor
        storage = tensor.untyped_storage()
        self.key, self.size = storage.data_ptr(), storage.nbytes()
        uses = saved._uses.get(self.key, 0)
        saved._uses[self.key] = uses + 1
        saved.now += self.size * (uses == 0)
        saved.peak = max(saved.peak, saved.now)

    def __del__(self) -> None:
        uses = self.saved._uses[self.key] - 1
        self.saved._uses[self.key] = uses
        self.saved.now -= self.size * (uses == 0)


@contextlib.contextmanager
def saved_activations() -> Iterator[Saved]:
    """Watch what graphs keep inside the block, forward and backward."""
    saved = Saved()
    with torch.autograd.graph.saved_tensors_hooks(saved.keep, lambda kept: kept.tensor):
        yield saved
