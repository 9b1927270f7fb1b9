"""The models that are known: ``conf/models.yaml``, by role and in order of preference."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from diffuphy.models.cache import kept, place
from diffuphy.models.files import KINDS, lacking

WIDTH = {"float32": 4, "float16": 2, "bfloat16": 2}
"""Bytes of a number."""

NETWORKS = {"diffusers", "transformers", "multimodal", "open_clip", "file"}
"""Kinds of parts whose size counts."""


@dataclass(frozen=True)
class Part:
    """One folder of a repository, or one file."""

    kind: str
    """A key of ``files.KINDS``, or ``file``."""
    parameters: int | None = None
    """Numbers in it; None where they are not known, or where it is no network."""

    def __post_init__(self) -> None:
        if self.kind not in (*KINDS, "file"):
            raise ValueError(f"kind must be one of {', '.join(KINDS)} or file, got {self.kind!r}")


@dataclass(frozen=True)
class Model:
    """One model, and what is known of it; nothing that is not known is guessed."""

    id: str
    """Repository of the hub, or the name of a single file."""
    role: str
    """What it is for."""
    setting: str
    """What names another one."""
    parts: Mapping[str, Part]
    """By folder, ``.`` for the root; by name for a file."""
    licence: str
    """By the model's card or licence file."""
    network: str
    """Class of the denoiser or encoder."""
    noncommercial: bool = False
    """The licence forbids commercial use."""
    backend: str | None = None
    """Choice of guidance that reads it; None where none does, or where the role says it."""
    prediction: str | None = None
    """What a denoiser predicts: epsilon, v_prediction, flow."""
    stored: str | None = None
    """Precision of the published files."""
    revision: str | None = None
    """Commit that was tried."""
    sha256: Mapping[str, str] | None = None
    """Digests, by path in the repository."""
    url: str = ""
    """Where a single file is published."""
    note: str = ""
    """What else one should know, such as the names it had."""
    unverified: tuple[str, ...] = ()
    """Fields that are from memory or from a page about it."""

    def __post_init__(self) -> None:
        if self.stored is not None and self.stored not in WIDTH:
            raise ValueError(f"{self.id}: stored must be one of {', '.join(WIDTH)} or null, got {self.stored!r}")
        if bool(self.url) != all(part.kind == "file" for part in self.parts.values()):
            raise ValueError(f"{self.id}: a single file has a url, a repository has none")
        if unknown := set(self.unverified) - set(self.__dataclass_fields__):
            raise ValueError(f"{self.id}: unverified names {sorted(unknown)}, which are no fields")

    @property
    def bytes(self) -> int | None:
        """Size of what is fetched: that of its tensors; None where it is not known."""
        return self.size(self.parts)

    def size(self, parts: Any) -> int | None:
        """Size of some parts [byte]."""
        counts = [self.parts[p].parameters for p in parts if self.parts[p].kind in NETWORKS]
        known = [c for c in counts if c is not None]
        return None if self.stored is None or len(known) < len(counts) else sum(known) * WIDTH[self.stored]

    def missing(self) -> list[str]:
        """Paths of the files that are not on this machine."""
        if self.url:
            return [] if kept(self.url).is_file() else [self.id]
        folder = place(self.id, self.revision)
        found = ((p, lacking(folder / p if folder else None, part.kind)) for p, part in self.parts.items())
        return [name if p == "." else f"{p}/{name}" for p, names in found for name in names]


@cache
def roles() -> Mapping[str, tuple[Model, ...]]:
    """All models by role, the preferred first.

    Raises:
        ValueError: the file says something that is no field, or misses one.
    """
    from omegaconf import OmegaConf

    tree: Any = OmegaConf.to_container(OmegaConf.load(_file()))
    return {role: tuple(_model(role, said["set"], m) for m in said["models"]) for role, said in tree.items()}


def _file() -> Path:
    """Beside the package in a checkout, inside it when installed."""
    package = Path(__file__).resolve().parents[1]
    return next(p for p in (package.parent / "conf/models.yaml", package / "conf/models.yaml") if p.exists())


def _model(role: str, setting: str, said: Mapping[str, Any]) -> Model:
    fields = dict(said)
    name, parts = fields.pop("class", ""), fields.pop("parts", {})
    counted = {p: Part(part["kind"], int(part["parameters"]) if "parameters" in part else None)
               for p, part in parts.items()}  # fmt: skip
    try:
        return Model(role=role, setting=setting, network=name, parts=counted, **fields)
    except TypeError as e:
        raise ValueError(f"conf/models.yaml: {role}, {said.get('id')}: {e}") from None


def known(model: str) -> Model | None:
    """What is known of an id; None of a folder or another id."""
    return next((m for models in roles().values() for m in models if m.id == model), None)


def for_backend(backend: str) -> tuple[Model, ...]:
    """Models that a choice of guidance reads, the preferred first."""
    return tuple(m for models in roles().values() for m in models if m.backend == backend)


def stand_ins(model: Model) -> list[Model]:
    """Others of the same role and backend that are on this machine, the preferred first."""
    others = (m for m in roles()[model.role] if m.backend == model.backend and m.id != model.id)
    return [m for m in others if not m.missing()]


def choose(model: str, default: str) -> str:
    """``auto`` is the first model on this machine that can take the place of the default, else the preferred one; any
    other name is itself.

    Results depend on which it is: a component keeps what was chosen, never ``auto``.

    Raises:
        ValueError: ``auto`` for a component whose default is no known model.
    """
    if model != "auto":
        return model
    entry = known(default)
    if entry is None:
        raise ValueError(f"model=auto: {default!r} is in no role of conf/models.yaml; name a hub id or a folder")
    models = [m for m in roles()[entry.role] if m.backend == entry.backend]
    return next((m for m in models if not m.missing()), models[0]).id
