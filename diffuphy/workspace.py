"""What a running stage may use besides its inputs: a checkpoint, a metrics file, previews, a progress bar."""

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

TENSOR = "\0tensor"

Watch = Callable[[str, int, int, Callable[[], Any]], None]
"""Told the stage, the step, how many there are, and how to make what can be seen; must not raise."""


class CheckpointCorrupted(ValueError):
    """A checkpoint whose bytes are not the ones that were written."""


class Workspace:
    """Scratch folder of one running stage. Without a folder nothing is kept: that is the form for the Python API.

    Args:
        directory: scratch folder, kept between runs until the stage is complete.
        interval: seconds between checkpoints; content never depends on it.
        progress: show bars; by default only when standard error is a terminal.
        device: where a stage that has no tensor among its inputs puts its own.
        watch: who wants to see what a stage has so far (``viewer.training``).
    """

    def __init__(
        self,
        directory: Path | None = None,
        *,
        interval: float = 5.0,
        progress: bool | None = None,
        device: str = "cpu",
        watch: Watch | None = None,
    ):
        self.directory = directory
        self.device = device
        self.watch = watch
        self.interval = interval
        self.progress = sys.stderr.isatty() if progress is None else progress
        self._saved_at = time.monotonic()
        if directory is not None:
            directory.mkdir(parents=True, exist_ok=True)

    # ------------------------------------------------------------------ checkpoint
    def due(self) -> bool:
        """True when ``interval`` seconds have passed since the last checkpoint."""
        return self.directory is not None and time.monotonic() - self._saved_at >= self.interval

    def save(self, state: dict[str, Any]) -> None:
        """Replace the checkpoint by ``state``, a nest of dicts, lists, tensors and JSON scalars (atomic).

        The file name carries the SHA-256 of the content, so that damage is found when it is read.
        """
        if self.directory is None:
            return
        from safetensors.torch import save

        tensors: dict[str, Any] = {}
        tree = json.dumps(_pack(state, tensors))
        data = save(tensors, metadata={"tree": tree, "time": str(time.time_ns())})
        name = f"checkpoint-{hashlib.sha256(data).hexdigest()[:32]}.safetensors"
        old = self._checkpoints()
        temporary = self.directory / "checkpoint.tmp"
        temporary.write_bytes(data)
        os.replace(temporary, self.directory / name)
        for path in old:
            if path.name != name:
                path.unlink()
        self._saved_at = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """The last checkpoint, or None if there is none."""
        from safetensors.torch import load

        best: tuple[int, dict[str, Any]] | None = None
        for path in self._checkpoints():
            data = path.read_bytes()
            if path.name != f"checkpoint-{hashlib.sha256(data).hexdigest()[:32]}.safetensors":
                raise CheckpointCorrupted(
                    f"checkpoint {path} is damaged: its bytes do not match its name; "
                    "delete this one file to start the stage again (finished stages are not touched)"
                )
            header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
            state = (int(header["time"]), _unpack(json.loads(header["tree"]), load(data)))
            best = state if best is None or state[0] > best[0] else best
        return None if best is None else best[1]

    def _checkpoints(self) -> list[Path]:
        return [] if self.directory is None else sorted(self.directory.glob("checkpoint-*.safetensors"))

    # ------------------------------------------------------------------ what a person looks at
    def log(self, step: int, **scalars: float | int | str) -> None:
        """Append one line to ``metrics.jsonl``."""
        if self.directory is not None:
            with open(self.directory / "metrics.jsonl", "a", encoding="utf-8") as f:
                f.write(json.dumps({"step": step, "time": round(time.time(), 3), **scalars}) + "\n")

    def summary(self, numbers: dict[str, Any]) -> None:
        """Write what the stage has to say about its result to ``summary.json``."""
        if self.directory is not None:
            (self.directory / "summary.json").write_text(
                json.dumps(numbers, indent=1, ensure_ascii=False), encoding="utf-8"
            )

    def image(self, name: str, rgb: Any) -> None:
        """Write a preview PNG from values in [0, 1], shape (H, W, 3)."""
        if self.directory is not None:
            from PIL import Image

            folder = self.directory / "previews"
            folder.mkdir(exist_ok=True)
            pixels = (rgb.detach().clamp(0, 1) * 255).round().byte().cpu().numpy()
            Image.fromarray(pixels).save(folder / f"{name}.png")

    def show(self, stage: str, step: int, total: int, seen: Callable[[], Any]) -> None:
        """Let whoever watches look at what there is after ``step`` of ``total`` steps.

        Args:
            seen: makes it: ``Gaussians``, or a ``Skin`` with the ``Trajectory`` that it follows; called only when it
                is wanted, never when nobody watches.
        """
        if self.watch is not None:
            self.watch(stage, step, total, seen)

    def bar(self, total: int, description: str, initial: int = 0) -> tqdm:
        """A progress bar with the time left; silent when standard error is not a terminal."""
        return tqdm(total=total, desc=description, initial=initial, disable=not self.progress, leave=False)


def _pack(value: Any, tensors: dict[str, Any]) -> Any:
    if hasattr(value, "detach"):
        tensors[f"{len(tensors)}"] = value.detach().cpu().contiguous().clone()
        return {TENSOR: f"{len(tensors) - 1}"}
    if isinstance(value, dict):
        return {
            "keys": [[type(k).__name__, str(k)] for k in value],
            "values": [_pack(v, tensors) for v in value.values()],
        }
    if isinstance(value, list | tuple):
        return [_pack(v, tensors) for v in value]
    return value


def _unpack(value: Any, tensors: dict[str, Any]) -> Any:
    if isinstance(value, dict):
        if TENSOR in value:
            return tensors[value[TENSOR]]
        keys = [int(k) if kind == "int" else k for kind, k in value["keys"]]
        return dict(zip(keys, (_unpack(v, tensors) for v in value["values"]), strict=True))
    if isinstance(value, list):
        return [_unpack(v, tensors) for v in value]
    return value
