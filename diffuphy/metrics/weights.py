"""Are the weights of a metric on this machine? Asked before anything is loaded, without a network or a library."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def hub_cache() -> Path:
    """Folder where huggingface_hub keeps what it has fetched, by its own environment variables."""
    home = Path(os.environ.get("HF_HOME") or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface")
    return Path(os.environ.get("HF_HUB_CACHE") or home / "hub").expanduser()


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
    if any(path.is_file() for f in files for path in snapshots.glob(f"*/{f}")):
        return None
    return f"no weights of {model} on this machine; run `hf download {model}`, or set {setting}=/path/to/folder"


def missing_file(path: str, setting: str) -> str | None:
    """The same of a single file."""
    if not path:
        return f"no weights are named; set {setting}=/path/to/file"
    return None if Path(path).expanduser().is_file() else f"there is no file {path}; set {setting}=/path/to/file"


def verified(path: str, sha256: str) -> Path:
    """The file, if its bytes are those expected; an empty ``sha256`` expects nothing.

    Raises:
        ValueError: with the digest that was found.
    """
    file = Path(path).expanduser()
    if sha256:
        found = hashlib.sha256(file.read_bytes()).hexdigest()
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
