"""Stages that remember: each one's result is stored under a key made of its settings and its inputs.

    key = SHA-256(class, VERSION and every effective setting of the component; contents of its inputs)

So a changed default re-runs, an unchanged prompt does not, and a different prompt that refines to the same words stops
at the first stage whose inputs are the same again. Results are written next to their final place and renamed when
complete; an interrupted stage finds its scratch folder, with its checkpoint, where it left it.
"""

import dataclasses
import hashlib
import json
import logging
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from diffuphy.workspace import Watch, Workspace

log = logging.getLogger(__name__)
SCRATCH = "work"


@dataclass(frozen=True)
class Stage:
    """One arrow of the pipeline: ``result = run(*inputs, work=workspace)``."""

    name: str
    """Also the name of its result, by which later stages ask for it."""
    out: Any
    """Type of the result; has ``save(directory)``, ``load(directory)`` and ``to(device)``."""
    run: Callable[..., Any]
    """A component: a frozen dataclass whose fields are all its settings."""
    inputs: tuple[str, ...] = ()
    """Earlier results (``"gaussians"``) or one field of them (``"prompt.look"``), in the order ``run`` takes them."""


@dataclass(frozen=True)
class Done:
    """A stage that has its result."""

    name: str
    path: Path
    cached: bool
    seconds: float
    """Time the stage took when it ran [s]; of the last attempt if it was interrupted before."""
    megabytes: float
    """Peak resident memory of the process while it ran [MB]."""


def describe(component: Any) -> Any:
    """Class, version and every setting (defaults included) of a component, as plain data.

    A field with ``metadata={"runtime": True}`` changes how, not what, is computed and is left out. For one with
    ``metadata={"content": source}`` stand kind and SHA-256 of the file ``source(value)``, or of each of a tuple.
    """
    if dataclasses.is_dataclass(component) and not isinstance(component, type):
        fields = [f for f in dataclasses.fields(component) if not f.metadata.get("runtime")]
        return {
            "class": f"{type(component).__module__}.{type(component).__qualname__}",
            "version": getattr(component, "VERSION", 1),
            **{f.name: _setting(f, getattr(component, f.name)) for f in fields},
        }
    if isinstance(component, dict):
        return {str(k): describe(v) for k, v in component.items()}
    if isinstance(component, list | tuple):
        return [describe(v) for v in component]
    if component is None or isinstance(component, str | int | float | bool | Path):
        return str(component) if isinstance(component, Path) else component
    raise TypeError(f"a setting must be plain data or a component, got {type(component).__qualname__}: {component!r}")


def _setting(field: dataclasses.Field, value: Any) -> Any:
    source = field.metadata.get("content")
    if source is None:
        return describe(value)
    found = source(value)
    return [_content(file.resolve()) for file in found] if isinstance(found, tuple) else _content(found.resolve())


def _content(file: Path) -> dict[str, str]:
    seen = file.stat()
    return {"kind": file.suffix.lower(), "sha256": _file_sha256(file, seen.st_size, seen.st_mtime_ns, seen.st_ino)}


@lru_cache(maxsize=8192)
def _file_sha256(file: Path, *seen: int) -> str:
    """SHA-256 of a file, found once for each state ``seen`` of it."""
    with file.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def check_names(stages: Sequence[Stage], asked: Iterable[str]) -> None:
    """Refuse a name that no stage has."""
    names = [s.name for s in stages]
    for name in asked:
        if name not in names:
            raise ValueError(f"no stage named {name!r}; the stages are {', '.join(names)}")


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def digest(directory: Path) -> str:
    """SHA-256 of the contents of a result (names and bytes; not its scratch, not its dates)."""
    h = hashlib.sha256()
    for file in sorted(p for p in directory.iterdir() if p.is_file() and p.name != "meta.json"):
        h.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return h.hexdigest()


def _peak_megabytes(reset: bool = False) -> float:
    """Peak resident memory [MB] since the last reset (Linux), or of the process (elsewhere)."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _stored_digest(directory: Path) -> str | None:
    """What ``meta.json`` says; None if it cannot be read."""
    try:
        return json.loads((directory / "meta.json").read_text(encoding="utf-8"))["digest"]
    except (ValueError, KeyError, TypeError):
        return None


class Store:
    """The folder that holds every result.

    Args:
        root: folder; made if missing.
        device: where inputs are put before a stage sees them.
        interval: seconds between the checkpoints of a long stage.
        progress: show bars; by default only when standard error is a terminal.
        watch: who is shown what a stage has so far; None: nobody.
    """

    def __init__(self, root: Path, *, device: str = "cpu", interval: float = 5.0, progress: bool | None = None,
                 watch: Watch | None = None):  # fmt: skip
        self.root, self.device, self.interval, self.progress, self.watch = root, device, interval, progress, watch
        self._digests: dict[Path, str] = {}
        try:
            root.mkdir(parents=True, exist_ok=True)
            probe = root / f".write-test-{os.getpid()}"
            probe.touch()
            probe.unlink()
        except OSError as e:
            raise OSError(
                f"the store {root} cannot be written ({e.strerror}); choose another with store=/path/to/folder"
            ) from None

    # ------------------------------------------------------------------ keys
    def recipe(self, stage: Stage, done: dict[str, Path]) -> dict[str, Any]:
        """What the key is made of."""
        return {"run": describe(stage.run), "inputs": {name: self._input_digest(name, done) for name in stage.inputs}}

    def path(self, stage: Stage, done: dict[str, Path]) -> Path:
        recipe = json.dumps(self.recipe(stage, done), sort_keys=True, ensure_ascii=True)
        return self.root / stage.name / _sha256(recipe.encode())[:16]

    def verified_digest(self, directory: Path) -> str:
        """Digest of a stored result, checked once against the one it was stored with."""
        if directory not in self._digests:
            found = digest(directory)
            if found != _stored_digest(directory):
                raise ValueError(
                    f"the stored result {directory} is damaged; delete this one folder to compute it again"
                )
            self._digests[directory] = found
        return self._digests[directory]

    def _input_digest(self, name: str, done: dict[str, Path]) -> str:
        result, _, field = name.partition(".")
        whole = self.verified_digest(done[result])
        if not field:
            return whole
        data = json.loads((done[result] / "result.json").read_text(encoding="utf-8"))[field]
        return _sha256(json.dumps(data, sort_keys=True).encode())

    # ------------------------------------------------------------------ running
    def look_up(self, stages: Sequence[Stage]) -> dict[str, Path]:
        """Results that are already there, as far down the line as keys can be known without running anything."""
        done: dict[str, Path] = {}
        for stage in stages:
            if any(name.partition(".")[0] not in done for name in stage.inputs):
                continue
            path = self.path(stage, done)
            if (path / "meta.json").exists():
                done[stage.name] = path
        return done

    def run(self, stages: Sequence[Stage], until: str, force: Iterable[str] = ()) -> list[Done]:
        """Run stages in order, skipping those already stored, up to and including ``until``."""
        check_names(stages, (until, *force))
        types = {s.name: s.out for s in stages}
        report, done = list[Done](), dict[str, Path]()
        for stage in stages[: list(types).index(until) + 1]:
            path = self.path(stage, done)
            report.append(self._run_one(stage, path, done, types, stage.name in set(force)))
            done[stage.name] = path
        return report

    def _run_one(self, stage: Stage, path: Path, done: dict[str, Path], types: dict[str, Any], force: bool) -> Done:
        from filelock import FileLock, Timeout

        path.parent.mkdir(exist_ok=True)
        lock = FileLock(path.with_suffix(".lock"))
        try:
            lock.acquire(timeout=0)
        except Timeout:
            log.info("%s: another run is computing this result; waiting for it", stage.name)
            lock.acquire()
        try:
            cached = (path / "meta.json").exists() and not force
            if not cached:
                self._compute(stage, path, done, types)
            self.verified_digest(path)
            meta = json.loads((path / "meta.json").read_text(encoding="utf-8"))
        finally:
            lock.release()
        log.info("%s: %s, %.1f s, %s", stage.name, "cached" if cached else "done", meta["seconds"], path)
        return Done(stage.name, path, cached, meta["seconds"], meta["megabytes"])

    def _compute(self, stage: Stage, path: Path, done: dict[str, Path], types: dict[str, Any]) -> None:
        partial = path.with_suffix(".partial")
        how = {"interval": self.interval, "progress": self.progress, "device": self.device, "watch": self.watch}
        work = Workspace(partial / SCRATCH, **how)
        inputs = [self._load(name, done, types) for name in stage.inputs]
        recipe = self.recipe(stage, done)
        log.info("%s: %s", stage.name, "continuing" if work.load() is not None else "started")
        _peak_megabytes(reset=True)
        start = time.perf_counter()
        with _fixed_order(self.device):
            result = stage.run(*inputs, work=work)
        seconds = time.perf_counter() - start
        result.to("cpu").save(partial)
        meta = {
            "digest": digest(partial),
            "seconds": round(seconds, 3),
            "megabytes": round(_peak_megabytes(), 1),
            "versions": _versions(),
            **recipe,
        }
        (partial / "meta.json").write_text(json.dumps(meta, indent=1, ensure_ascii=False), encoding="utf-8")
        old = path.with_suffix(".old")
        if path.exists():  # forced: the old result stays whole until the new one is complete
            if old.exists():
                shutil.rmtree(old)
            os.replace(path, old)
            self._digests.pop(path, None)
        os.replace(partial, path)  # atomic: a folder without a suffix is complete
        if old.exists():
            shutil.rmtree(old)
        for checkpoint in (path / SCRATCH).glob("checkpoint*"):
            checkpoint.unlink()

    def _load(self, name: str, done: dict[str, Path], types: dict[str, Any]) -> Any:
        result, _, field = name.partition(".")
        value = types[result].load(done[result])
        return getattr(value, field) if field else value.to(self.device)


@contextmanager
def _fixed_order(device: str) -> Iterator[None]:
    """On the CPU torch adds in one order: with several threads an indexed sum otherwise depends on who comes first."""
    import torch

    before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    torch.use_deterministic_algorithms(before[0] or device == "cpu", warn_only=before[1])
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])


def _versions() -> dict[str, str]:
    """Versions that made a result, for whoever wonders later; not part of the key."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version(), "machine": platform.machine()}
    for package in ("diffuphy", "torch", "warp-lang", "numpy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
