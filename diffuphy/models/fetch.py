"""A single file of weights, by path or by address; what was fetched once is kept."""

import hashlib
import logging
import os
import shutil
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

from diffuphy.models.weights import MissingWeights, verified

log = logging.getLogger(__name__)


def cache() -> Path:
    """Folder of the files that were fetched."""
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "diffuphy/weights"


def kept(address: str) -> Path:
    """Where the file of an address is, or would be, kept: two addresses never share a file."""
    return cache() / f"{hashlib.sha256(address.encode()).hexdigest()[:12]}-{Path(urlsplit(address).path).name}"


def offline() -> bool:
    """Whether the environment forbids the network, by the variable that huggingface_hub obeys."""
    return os.environ.get("HF_HUB_OFFLINE", "").upper() in {"1", "ON", "YES", "TRUE"}


def file(source: str, sha256: str, setting: str, *, local: bool = False) -> Path:
    """The file of a path, or of an ``http(s)://`` address, fetched if it is not kept yet.

    Args:
        source: path or address.
        sha256: digest that the file must have; empty trusts it.
        setting: what to change to use another file.
        local: never ask the network.

    Raises:
        MissingWeights: it is not here and the network is absent or forbidden.
        ValueError: the bytes are not those expected; nothing is kept of a wrong download.
    """
    if not source:
        raise MissingWeights(f"no weights are named; set {setting}=/path/to/file or to an https:// address")
    if not source.startswith(("http://", "https://")):
        if not Path(source).expanduser().is_file():
            raise MissingWeights(f"there is no file {source}; set {setting}=/path/to/file")
        return verified(source, sha256)
    path = kept(source)
    if path.is_file():
        return verified(str(path), sha256)
    fetch = f"fetch {source} where there is a network and set {setting}=/path/to/file"
    if local or offline():
        raise MissingWeights(f"{source} is not on this machine and the network is not to be asked; {fetch}")
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with urllib.request.urlopen(source, timeout=30) as answer, part.open("wb") as out:
            log.info("fetching %s (%s bytes) to %s", source, answer.headers.get("Content-Length", "?"), path)
            shutil.copyfileobj(answer, out, 1 << 20)
        verified(str(part), sha256)
        os.replace(part, path)
    except OSError as error:
        raise MissingWeights(f"{source} cannot be fetched ({error}); {fetch}") from None
    finally:
        part.unlink(missing_ok=True)
    return path
