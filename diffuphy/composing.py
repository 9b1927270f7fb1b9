"""From settings to objects: where the settings are, and the component of each stage."""

import hashlib
import re
import unicodedata
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from diffuphy.quoting import literal


def make(stages: dict[str, Any]) -> dict[str, Any]:
    """The component of each stage, from resolved settings. Hydra reads a text twice, so it is made literal twice."""
    from hydra.utils import instantiate

    def twice(node: Any) -> Any:
        if isinstance(node, dict):
            return {key: twice(value) for key, value in node.items()}
        if isinstance(node, list):
            return [twice(value) for value in node]
        return literal(literal(node)) if isinstance(node, str) else node

    return instantiate(OmegaConf.create({"stages": twice(stages)}).stages, _convert_="all")


def conf_dir() -> Path:
    """The folder of the settings: ``conf/`` beside the package in a checkout, inside the package when installed."""
    package = Path(__file__).resolve().parent
    return next(path for path in (package.parent / "conf", package / "conf") if (path / "train.yaml").exists())


def slug(*texts: str) -> str:
    """A folder name for texts: what is left of them in ASCII, then six hexadecimal digits of their SHA-256.

    The same text always gives the same name, so the same command continues in the same folder. Empty texts do not
    count.
    """
    text = "\n".join(filter(None, texts))
    ascii_text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    words = re.sub(r"[^a-z0-9]+", "-", ascii_text.lower()).strip("-")[:48].rstrip("-")
    return "-".join(filter(None, (words, hashlib.sha256(text.encode()).hexdigest()[:6])))


OmegaConf.register_new_resolver("slug", slug, replace=True)


def device(name: str) -> str:
    """``auto`` is the first GPU where there is one.

    Raises:
        ValueError: no such device.
    """
    import torch

    found = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "auto":
        return "cuda" if found else "cpu"
    kind, _, index = name.partition(":")
    if name != "cpu" and not (kind == "cuda" and (index.isdecimal() or name == "cuda")):
        raise ValueError(f"device must be auto, cpu, cuda or cuda:1, got {name!r}")
    if kind == "cuda" and int(index or 0) >= found:
        there = f"cuda:0 to cuda:{found - 1} are there" if found else "there is no CUDA device"
        raise ValueError(f"device={name}: {there}; use device=cpu or device=auto")
    return name


def set_threads(number: int) -> None:
    """Let torch use this many threads on the CPU."""
    import torch

    if number < 1:
        raise ValueError(f"threads must be at least 1, got {number}")
    torch.set_num_threads(number)
