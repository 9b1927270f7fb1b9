"""Where weights lie on this machine, by the environment variables of huggingface_hub; found without asking anybody."""

import hashlib
import os
from pathlib import Path
from urllib.parse import urlsplit

TRUE = {"1", "ON", "YES", "TRUE"}
"""What huggingface_hub takes for yes."""


def _home() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()


def hub_cache() -> Path:
    """Folder where huggingface_hub keeps what it has fetched."""
    home = Path(os.environ.get("HF_HOME") or _home() / "huggingface")
    return Path(os.environ.get("HF_HUB_CACHE") or home / "hub").expanduser()


def file_cache() -> Path:
    """Folder of single files that belong to no repository of the hub."""
    return _home() / "diffuphy/weights"


def kept(address: str) -> Path:
    """Where the file of an address is, or would be, kept: two addresses never share a file."""
    name = Path(urlsplit(address).path).name
    return file_cache() / f"{hashlib.sha256(address.encode()).hexdigest()[:12]}-{name}"


def offline() -> bool:
    """Whether the environment forbids the network."""
    said = os.environ.get("HF_HUB_OFFLINE") or os.environ.get("TRANSFORMERS_OFFLINE") or ""
    return said.upper() in TRUE


def endpoint() -> str:
    """Address of the hub, or of the mirror that the environment names."""
    return (os.environ.get("HF_ENDPOINT") or "https://huggingface.co").rstrip("/")


def is_path(model: str) -> bool:
    """Whether a model is named by a folder or file rather than by its id."""
    return model.startswith(("/", ".", "~")) or Path(model).is_dir()


def place(model: str, revision: str | None = None) -> Path | None:
    """Folder of a model: itself, or the snapshot of a commit, branch or tag in the cache; None if it is not here.

    The hub's cache has ``models--OWNER--NAME/refs/main``, which holds a commit, and ``snapshots/COMMIT``.
    """
    if is_path(model):
        folder = Path(model).expanduser()
        return folder if folder.is_dir() else None
    repository = hub_cache() / f"models--{model.replace('/', '--')}"
    ref = repository / "refs" / (revision or "main")
    commit = ref.read_text(encoding="utf-8").strip() if ref.is_file() else revision
    snapshot = repository / "snapshots" / (commit or "")
    return snapshot if commit and snapshot.is_dir() else None


def shown(path: Path) -> str:
    """A path for people: their home is ``~``."""
    home = Path.home()
    return f"~/{path.relative_to(home)}" if path.is_relative_to(home) else str(path)
