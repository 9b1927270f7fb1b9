"""Weights of pretrained models: are they on this machine, what to do when they are not, and how they are read.

Asking needs neither a network nor a library; only tensors are read, never code; nothing is fetched without a line that
says its licence, its size and where it goes.
"""

import hashlib
import logging
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from diffuphy.models.cache import hub_cache, is_path, kept, offline, place, shown
from diffuphy.models.files import KINDS, check_tensors, kind_of, lacking, refused, weights
from diffuphy.models.registry import NETWORKS, Model, for_backend, known, stand_ins

log = logging.getLogger(__name__)


class MissingWeights(FileNotFoundError):
    """A pretrained model is not on this machine; the message is one line and says what to run or change."""


Parts = Mapping[str, str]
"""Kinds (``files.KINDS``) of the parts of a model, by folder; ``.`` is its root."""


# ------------------------------------------------------------------ what to say
def command(model: str, parts: Parts | None = None, revision: str | None = None) -> str:
    """What fetches a model: of the parts their tensors once, as safetensors, and what describes them.

    Args:
        model: hub id, or the name of a known file.
        parts: which; those that are known of the model, or all there is.
    """
    entry = known(model)
    if entry is not None and entry.url:
        return f"curl -L --create-dirs -o {shown(kept(entry.url))} {entry.url}"
    parts = parts or _parts(entry)
    wanted = [(p, f) for p, kind in parts.items() for f in KINDS[kind].fetch]
    # what describes the parts is small: of several it is named once
    patterns = dict.fromkeys(
        f if f.startswith("*.") and len(parts) > 1 else str(PurePosixPath(p, f)) for p, f in wanted
    )
    pinned = f" --revision {revision}" if revision else ""
    return f"hf download {shlex.quote(model)}{pinned}" + "".join(f" --include {shlex.quote(p)}" for p in patterns)


def size(count: int | None) -> str:
    """Bytes in words, in powers of ten."""
    if count is None:
        return "size unknown"
    return (
        f"{count / 1e9:.1f} GB"
        if count >= 1e9
        else f"{count / 1e6:.0f} MB"
        if count >= 1e6
        else f"{count / 1e3:.0f} kB"
    )


def terms(entry: Model | None) -> str:
    """A licence, with what it forbids."""
    if entry is None:
        return "licence: see its card"
    return f"licence {entry.licence}" + (", NON-COMMERCIAL USE ONLY" if entry.noncommercial else "")


def absent(model: str, setting: str, parts: Parts | None = None, revision: str | None = None) -> str:
    """That a model is not here, which files it lacks, and what to do.

    Args:
        setting: what to change to use other weights.
        parts: what was looked for.
    """
    if is_path(model):
        return _absent_folder(model, setting, parts or {})
    entry, root = known(model), place(model, revision)
    parts = parts or _parts(entry)
    files = ", ".join(_lacking(root, parts))
    others = stand_ins(entry) if entry else []
    return (
        f"no weights of {model!r} on this machine{f' ({files})' if files else ''}; run "
        f"`{command(model, parts, revision)}` where there is a network ({_terms(entry, parts)}), or set "
        f"{setting}=/path/to/folder"
        + (f"; {others[0].id} is on this machine: {setting}={others[0].id} takes it" if others else "")
    )


def _absent_folder(model: str, setting: str, parts: Parts) -> str:
    folder = Path(model).expanduser()
    if not folder.is_dir():
        return f"there is no folder {model}; set {setting}=/path/to/folder"
    unread = [str(PurePosixPath(p, name)) for p in parts for name in refused(folder / p)]
    why = f"; {', '.join(unread)} is not read, as it may hold code: use safetensors" if unread else ""
    return f"{model} holds no {', '.join(_lacking(folder, parts))}{why}; set {setting}=/path/to/folder"


def _parts(entry: Model | None) -> Parts:
    return {p: part.kind for p, part in entry.parts.items()} if entry else {}


def _lacking(root: Path | None, parts: Parts) -> list[str]:
    found = ((p, lacking(root / p if root else None, kind)) for p, kind in parts.items())
    return [str(PurePosixPath(p, name)) for p, names in found for name in names]


def _terms(entry: Model | None, parts: Parts) -> str:
    """Size of some parts, and the licence."""
    count = entry.size(p for p in parts if p in entry.parts) if entry else None
    return f"{size(count)}, {terms(entry)}"


# ------------------------------------------------------------------ asking
def missing(model: str, parts: Parts, setting: str) -> str | None:
    """Why a model cannot be loaded, in one line with the remedy; None if all its parts are here and sound.

    Args:
        model: folder, or hub id ``owner/name``.
        setting: what to change to use other weights.
    """
    root = place(model)
    if root is None or _lacking(root, parts):
        return absent(model, setting, parts)
    try:
        return _check(root, parts, known(model))
    except ValueError as e:
        return f"{model}: {e}"


def located(path: str) -> Path:
    """A file by its path; or, by the name of a known file, where it is kept."""
    file = Path(path).expanduser()
    entry = None if file.is_file() else known(path)
    return kept(entry.url) if entry is not None and entry.url else file


def missing_file(path: str, setting: str, sha256: str = "") -> str | None:
    """Why a single file cannot be read; None if it is there and sound.

    Args:
        sha256: digest that it must have; empty expects nothing.
    """
    if not path:
        return f"no weights are named; set {setting}=/path/to/file"
    if located(path).is_file():
        try:
            return check_tensors(verified(path, sha256))
        except ValueError as e:
            return f"{setting}: {e}"
    entry = known(path)
    fetch = f"run `{command(path)}` ({_terms(entry, _parts(entry))}), or " if entry is not None and entry.url else ""
    return f"there is no file {path}; {fetch}set {setting}=/path/to/file"


# ------------------------------------------------------------------ loading
def where(revision: str | None, local_files_only: bool) -> dict[str, Any]:
    """What every ``from_pretrained`` is told about where to look."""
    return ({} if revision is None else {"revision": revision}) | {"local_files_only": local_files_only}


def require(
    model: str, parts: Parts, setting: str, *, revision: str | None = None, local_files_only: bool = False
) -> None:
    """Before anything is loaded: the files are here and hold tensors alone, or they may be fetched, which is said.

    Raises:
        MissingWeights: they are not here, and there is no folder or the network is not to be asked.
        ValueError: a file that may hold code, or other bytes than the registry knows.
    """
    root, entry = place(model, revision), known(model)
    lacks = _lacking(root, parts)
    if not lacks and root is not None:
        _check(root, parts, entry)
    elif is_path(model) or local_files_only or offline():
        raise MissingWeights(absent(model, setting, parts, revision))
    elif any(kind in NETWORKS for kind in parts.values()):
        level = logging.WARNING if entry and entry.noncommercial else logging.INFO
        log.log(
            level, "fetching %s (%s): %s, into %s", model, ", ".join(parts), _terms(entry, parts), shown(hub_cache())
        )
        for other in stand_ins(entry) if entry else []:
            log.info("%s is on this machine: %s=%s would take it", other.id, setting, other.id)


def _check(root: Path, parts: Parts, entry: Model | None) -> None:
    """Refuse code, and bytes that are not those published."""
    for p, kind in parts.items():
        for file in weights(root / p, kind):
            check_tensors(file)
    for name, digest in ((entry.sha256 if entry else None) or {}).items():
        if (root / name).is_file():
            verified(str(root / name), digest)


def load_component(load: Callable[..., Any], model: str, subfolder: str, backend: str, **options: Any) -> Any:
    """``load(model, subfolder=..., ...)``, that is ``from_pretrained``; absence becomes one line that says what to
    do.

    Raises:
        MissingWeights: they are not on this machine, and cannot be fetched.
        ValueError: a file that may hold code, or other bytes than the registry knows.
    """
    kind, models = kind_of(load), for_backend(backend)
    parts = {subfolder or ".": kind} if kind else {}
    setting = models[0].setting if models else "guidance.model"
    group = setting.partition(".")[0]
    look = {key: options[key] for key in ("revision", "local_files_only") if key in options}
    try:
        require(model, parts, setting, **look)
        return load(model, subfolder=subfolder, **options)
    except (OSError, ValueError) as e:
        root = place(model, options.get("revision"))
        if root is not None and not _lacking(root, parts):  # present but unreadable: the library's own words say more
            raise
        said = str(e) if isinstance(e, MissingWeights) else absent(model, setting, parts, options.get("revision"))
        raise MissingWeights(f"{group}={backend}: {said}, or use {group}=analytic, which needs none") from None


def verified(path: str, sha256: str) -> Path:
    """The file, if its bytes are those expected; an empty ``sha256`` expects nothing.

    Raises:
        ValueError: with the digest that was found.
    """
    file = located(path)
    if sha256:
        with file.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
        if found != sha256.lower():
            raise ValueError(f"{path} has SHA-256 {found}, expected {sha256}; fetch it again, or correct sha256")
    return file


def read(path: str, sha256: str = "") -> dict[str, Any]:
    """Tensors of a checkpoint: safetensors, or a torch file that holds nothing but tensors.

    Args:
        sha256: digest that the file must have; empty takes that of the registry, if it knows one.

    Raises:
        ValueError: another digest, another kind of file, or one that holds objects.
    """
    entry = known(path)
    file = verified(path, sha256 or ((entry.sha256 if entry else None) or {}).get(path, ""))
    if file.suffix == ".safetensors":
        from safetensors.torch import load_file

        return load_file(file)
    check_tensors(file)
    import torch

    return torch.load(file, map_location="cpu", weights_only=True)


def shapes(file: Path) -> dict[str, Any]:
    """Tensors of a checkpoint without their numbers, on the device "meta": names, shapes and kinds, one at a time."""
    import torch

    if file.suffix != ".safetensors":
        check_tensors(file)
        return torch.load(file, map_location="meta", weights_only=True)
    from safetensors import safe_open

    with safe_open(file, framework="pt") as f:
        return {name: f.get_tensor(name).to("meta") for name in f.keys()}
