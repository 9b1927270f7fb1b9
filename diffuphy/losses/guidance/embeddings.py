"""Embedded texts on the disk: a T5 encoder of ten gigabytes need not be loaded to read the same sentence again."""

import hashlib
import os
import tempfile
from pathlib import Path

from torch import Tensor


class Folder:
    """Embeddings of one text encoder, a file for each text, named by the hash of all that they depend on."""

    def __init__(self, folder: str | None, model: str, revision: str | None, dtype: str, length: int):
        """``folder`` None remembers nothing. ``model`` is a hub id, or a folder, whose files then count as well."""
        self.folder = None if folder is None else Path(folder)
        self.key = (model, revision, dtype, length, _stamps(Path(model)))

    def _file(self, text: str) -> Path:
        assert self.folder is not None
        name = hashlib.sha256(repr((self.key, text)).encode()).hexdigest()
        return self.folder / f"{name}.safetensors"

    def get(self, text: str) -> Tensor | None:
        """What was put under this text, on the host, or None."""
        if self.folder is None or not self._file(text).is_file():
            return None
        from safetensors.torch import load_file

        return load_file(self._file(text))["states"]

    def put(self, text: str, states: Tensor) -> None:
        """Keep the states of a text; a reader sees all of a file or none of it."""
        if self.folder is None:
            return
        from safetensors.torch import save_file

        self.folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=self.folder)
        os.close(handle)
        save_file({"states": states.contiguous()}, name)
        os.replace(name, self._file(text))


def _stamps(model: Path) -> tuple[tuple[str, int, int], ...]:
    """Name, size and time of the files that embed texts, of a model in a folder."""
    files = sorted(f for part in ("text_encoder", "tokenizer") for f in (model / part).glob("*"))
    return tuple((f.name, f.stat().st_size, f.stat().st_mtime_ns) for f in files)
