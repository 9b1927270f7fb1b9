"""Weights of pretrained models: are they on this machine, what to do when they are not, and how they are read.

Asking needs neither a network nor a library; only tensors are read, never code.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any


class MissingWeights(FileNotFoundError):
    """A pretrained model is not on this machine; the message is one line and says what to run or change."""


def hub_cache() -> Path:
    """Folder where huggingface_hub keeps what it has fetched, by its own environment variables."""
    home = Path(os.environ.get("HF_HOME") or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface")
    return Path(os.environ.get("HF_HUB_CACHE") or home / "hub").expanduser()


# ------------------------------------------------------------------ what to say
def absent(model: str, setting: str, part: str = "") -> str:
    """That a model is not here, and what to do.

    Args:
        model: folder, or hub id ``owner/name``.
        setting: what to change to use other weights.
        part: folder inside it that was looked for.
    """
    return (
        f"no weights of {model!r}{f' ({part})' if part else ''} on this machine; run `hf download {model}` where "
        f"there is a network, or set {setting}=/path/to/folder"
    )


def missing(model: str, files: Sequence[str], setting: str) -> str | None:
    """Why a model cannot be loaded, in one line with the remedy; None if one of ``files`` is there.

    Args:
        model: folder, or hub id ``owner/name``.
        files: names of the weights, any of which will do.
        setting: what to change to use other weights.
    """
    folder = Path(model).expanduser()
    if folder.is_dir():
        found = any((folder / f).is_file() for f in files)
        return None if found else f"{model} holds none of {', '.join(files)}"
    if model.startswith(("/", ".", "~")):
        return f"there is no folder {model}; set {setting}=/path/to/folder"
    snapshots = hub_cache() / f"models--{model.replace('/', '--')}" / "snapshots"
    found = any(path.is_file() for f in files for path in snapshots.glob(f"*/{f}"))
    return None if found else absent(model, setting)


def missing_file(path: str, setting: str) -> str | None:
    """The same of a single file."""
    if not path:
        return f"no weights are named; set {setting}=/path/to/file"
    return None if Path(path).expanduser().is_file() else f"there is no file {path}; set {setting}=/path/to/file"


# ------------------------------------------------------------------ loading
def where(revision: str | None, local_files_only: bool) -> dict[str, Any]:
    """What every ``from_pretrained`` is told about where to look."""
    return ({} if revision is None else {"revision": revision}) | {"local_files_only": local_files_only}


def load_component(load: Callable[..., Any], model: str, subfolder: str, backend: str, **options: Any) -> Any:
    """``load(model, subfolder=..., ...)``, that is ``from_pretrained``; absence becomes one line that says what to
    do.

    Raises:
        MissingWeights: they are not on this machine.
    """
    try:
        return load(model, subfolder=subfolder, **options)
    except (OSError, ValueError) as e:
        if os.path.isdir(os.path.join(model, subfolder)):  # present but unreadable: the library's own words say more
            raise
        raise MissingWeights(
            f"guidance={backend}: {absent(model, 'guidance.model', subfolder)}, "
            f"or use guidance=analytic, which needs none ({type(e).__name__})"
        ) from None


def verified(path: str, sha256: str) -> Path:
    """The file, if its bytes are those expected; an empty ``sha256`` expects nothing.

    Raises:
        ValueError: with the digest that was found.
    """
    file = Path(path).expanduser()
    if sha256:
        with file.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
        if found != sha256.lower():
            raise ValueError(f"{path} has SHA-256 {found}, expected {sha256}; fetch it again, or correct sha256")
    return file


def read(path: str, sha256: str = "") -> dict[str, Any]:
    """Tensors of a checkpoint: safetensors, or a torch file that holds nothing but tensors."""
    file = verified(path, sha256)
    if file.suffix == ".safetensors":
        from safetensors.torch import load_file

        return load_file(file)
    import torch

    return torch.load(file, map_location="cpu", weights_only=True)
