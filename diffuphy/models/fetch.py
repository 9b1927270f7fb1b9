"""A single file of weights: by path, by the name of a known file, or by address; what was fetched once is kept."""

import logging
import os
import shutil
import urllib.request
from pathlib import Path

from diffuphy.models.cache import kept, offline, shown
from diffuphy.models.registry import known
from diffuphy.models.weights import MissingWeights, missing_file, terms, verified

log = logging.getLogger(__name__)


def file(source: str, sha256: str, setting: str, *, local: bool = False) -> Path:
    """The file, fetched if it has an address and is not kept yet.

    Args:
        source: path, name of a file that the registry knows, or ``http(s)://`` address.
        sha256: digest that the file must have; empty takes that of the registry, if it knows one.
        setting: what to change to use another file.
        local: never ask the network.

    Raises:
        MissingWeights: it is not here, and the network has it not or is not to be asked.
        ValueError: the bytes are not those expected; nothing is kept of a wrong download.
    """
    entry = known(source)
    sha256 = sha256 or ((entry.sha256 if entry else None) or {}).get(source, "")
    address = source if source.startswith(("http://", "https://")) else entry.url if entry else None
    if source and Path(source).expanduser().is_file():
        return verified(source, sha256)
    if address is None:
        raise MissingWeights(missing_file(source, setting))
    path = kept(address)
    if path.is_file():
        return verified(str(path), sha256)
    fetch = missing_file(source, setting) if entry else f"there is no {source} here; set {setting}=/path/to/file"
    if local or offline():
        raise MissingWeights(f"{fetch}; the network is not to be asked")
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with urllib.request.urlopen(address, timeout=30) as answer, part.open("wb") as out:
            count = answer.headers.get("Content-Length", "?")
            log.info("fetching %s (%s bytes; %s) to %s", address, count, terms(entry), shown(path))
            shutil.copyfileobj(answer, out, 1 << 20)
        verified(str(part), sha256)
        os.replace(part, path)
    except OSError as error:
        raise MissingWeights(f"{fetch}; {address} did not answer ({error})") from None
    finally:
        part.unlink(missing_ok=True)
    return path
