"""Which files a part of a model consists of, and that they hold tensors and no code."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REFUSED = {".ckpt", ".pkl", ".pickle", ".joblib", ".npy", ".npz", ".h5", ".msgpack", ".onnx"}
"""Weights that are not read: they may hold code, or nothing that is read here."""


@dataclass(frozen=True)
class Kind:
    """How a library stores one part."""

    needs: tuple[tuple[str, ...], ...]
    """Of each row one file must be there; the first is what one wants."""
    fetch: tuple[str, ...]
    """Patterns of what one wants, without other precisions of the same tensors."""


def _weights(stem: str) -> tuple[str, ...]:
    """Names of tensors: whole or in shards, safetensors before torch's own."""
    return tuple(f"{stem}.{end}{index}" for end in ("safetensors", "bin") for index in ("", ".index.json"))


TENSORS = "[.-][s0]*"
"""Ends the name of a network's safetensors, whole (``.safetensors``, its index) or in shards (``-00001-of-...``), but
not of other precisions (``.fp16.``, ``.non_ema.``) or of torch's own form (``.bin``)."""


def _network(stem: str, torch_stem: str | None = None) -> Kind:
    names = (*_weights(stem)[:2], *_weights(torch_stem or stem)[2:])
    return Kind((("config.json",), names), ("*.json", f"{stem}{TENSORS}"))


KINDS = {
    "diffusers": _network("diffusion_pytorch_model"),
    "transformers": _network("model", "pytorch_model"),
    "multimodal": Kind(
        (
            ("preprocessor_config.json", "processor_config.json"),
            ("tokenizer.json", "vocab.json", "tokenizer.model"),
            *_network("model", "pytorch_model").needs,
        ),
        ("*.json", "*.txt", "*.jinja", f"model{TENSORS}"),
    ),
    "open_clip": Kind(
        (("open_clip_model.safetensors", "open_clip_pytorch_model.bin"),), (f"open_clip_model{TENSORS}",)
    ),
    "tokenizer": Kind((("tokenizer.json", "vocab.json", "spiece.model"),), ("*.json", "*.txt", "*.model")),
    "processor": Kind((("preprocessor_config.json", "processor_config.json"),), ("*.json", "*.txt", "*.jinja")),
    "scheduler": Kind((("scheduler_config.json",),), ("*.json",)),
    "pipeline": Kind((("model_index.json",),), ("*.json", "*.txt", "*.model", f"*/*model{TENSORS}")),
}
"""By the library that reads it (its constants of file names), or by what it is."""


def kind_of(load: Any) -> str | None:
    """The kind that a ``from_pretrained`` reads, by its class; None if it is none of these."""
    cls = getattr(load, "__self__", None)
    name, library = getattr(cls, "__name__", ""), (getattr(cls, "__module__", "") or "").split(".")[0]
    if hasattr(cls, "vocab_files_names") or name.startswith("AutoTokenizer"):
        return "tokenizer"
    if name.endswith("Processor"):
        return "processor"
    config = getattr(cls, "config_name", None)
    if library == "diffusers":
        return {"config.json": "diffusers", "scheduler_config.json": "scheduler"}.get(config or "", "pipeline")
    return "transformers" if library == "transformers" else None


def lacking(folder: Path | None, kind: str) -> list[str]:
    """Names of the files that a folder lacks; of no folder all. What an index lists must be there too: the shards of a
    network, the folders of a pipeline."""
    names: list[str] = []
    for row in KINDS[kind].needs:
        found = next((folder / name for name in row if (folder / name).is_file()), None) if folder else None
        if folder is None or found is None:
            names.append(row[0])
        elif found.name.endswith("index.json"):
            names += [name for name in _listed(found) if not (folder / name).exists()]
    return names


def _listed(index: Path) -> list[str]:
    """What an index of shards or of a pipeline lists."""
    said = json.loads(index.read_text(encoding="utf-8"))
    if "weight_map" in said:
        return sorted(set(said["weight_map"].values()))
    return sorted(k for k, v in said.items() if isinstance(v, list) and len(v) == 2 and v[0] is not None)


def refused(folder: Path | None) -> list[str]:
    """Names of files in a folder that look like weights and are not read."""
    return sorted(f.name for f in folder.iterdir() if f.suffix in REFUSED) if folder and folder.is_dir() else []


def weights(folder: Path, kind: str) -> list[Path]:
    """The files of tensors that would be read: of several forms the first."""
    file = next((folder / name for name in KINDS[kind].needs[-1] if (folder / name).is_file()), None)
    if file is None or kind == "pipeline":
        return []
    if file.name.endswith(".index.json"):
        return [folder / name for name in _listed(file)]
    return [file] if file.suffix in (".safetensors", ".bin") else []


def check_tensors(file: Path) -> None:
    """Refuse a file that holds anything but tensors, or fewer bytes than it says, without reading their values.

    Raises:
        ValueError: it is no such file, it is broken, or it holds objects, which could run code when they are loaded.
    """
    if file.suffix == ".safetensors":
        return _check_header(file)
    if file.suffix in REFUSED:
        raise ValueError(
            f"{file.name} is not read: such a file may hold code; use safetensors, or save its tensors alone "
            "with torch.save"
        )
    import torch

    try:
        torch.load(file, map_location="meta", weights_only=True, mmap=zipfile.is_zipfile(file))
    except Exception as e:  # of torch, zipfile and the unpickler, each in words of its own
        why = " ".join(str(e).split())[:160] or type(e).__name__
        raise ValueError(
            f"{file.name} is refused: it does not hold tensors alone, or is broken ({why}); use safetensors"
        ) from None


def _check_header(file: Path) -> None:
    """A file of safetensors is the length of its header (8 bytes), the header, and as many bytes as that promises."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        try:
            header = json.loads(stream.read(min(length, size)))
            ends = [said["data_offsets"][1] for name, said in header.items() if name != "__metadata__"]
        except (ValueError, AttributeError, KeyError, TypeError):
            raise ValueError(f"{file.name} is broken: it has no header of safetensors; fetch it again") from None
    promised = 8 + length + max(ends, default=0)
    if size != promised:
        raise ValueError(f"{file.name} is broken: {size} bytes, its header promises {promised}; fetch it again")
