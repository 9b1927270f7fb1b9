"""A cache of the hub as huggingface_hub lays it out, without a hub."""

import hashlib
from pathlib import Path

COMMIT = "0123456789abcdef0123456789abcdef01234567"


def cached(cache: Path, model: str, files: dict[str, bytes]) -> Path:
    """Put files of a model into a cache: blobs by their SHA-256, a snapshot of links, the branch ``main``."""
    repository = cache / f"models--{model.replace('/', '--')}"
    snapshot = repository / "snapshots" / COMMIT
    for folder in ("blobs", "refs"):
        (repository / folder).mkdir(parents=True, exist_ok=True)
    (repository / "refs/main").write_text(COMMIT, encoding="utf-8")
    for name, content in files.items():
        blob = repository / "blobs" / hashlib.sha256(content).hexdigest()
        blob.write_bytes(content)
        link = snapshot / name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(blob)
    return snapshot


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder."""
    return {f.relative_to(folder).as_posix(): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def whole(model) -> dict[str, bytes]:
    """The names that a known model must have, with next to nothing in them."""
    from diffuphy.models.files import KINDS

    rows = [(p, row) for p, part in model.parts.items() for row in KINDS[part.kind].needs]
    empty = (2).to_bytes(8, "little") + b"{}"  # of safetensors: a header without tensors
    return {(Path(p) / row[0]).as_posix(): empty if row[0].endswith(".safetensors") else b"{}" for p, row in rows}
