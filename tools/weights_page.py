"""Writes the tables of ``docs/weights.md``, from ``conf/models.yaml``, and the doctor's output.

``python tools/weights_page.py``; the output is that of the present machine without a GPU and without weights; a test
keeps the rest equal.
"""

import dataclasses
import os
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.errors import filled
from diffuphy.doctor.__main__ import examine
from diffuphy.doctor.needs import ALLOWANCE, gib, weights
from diffuphy.doctor.report import Report, terms
from diffuphy.models import roles
from diffuphy.models.weights import size

PAGE = Path(__file__).resolve().parents[1] / "docs/weights.md"


def models_table() -> str:
    """Every known model."""
    rows = ["| role | model | to fetch | licence | predicts | named by | note |", "|---|---|---|---|---|---|---|"]
    for role, models in roles().items():
        for k, m in enumerate(models):
            name = f"[{m.id}]({m.url})" if m.url else f"`{m.id}`"
            star = "*" if "stored" in m.unverified and m.bytes else ""
            cells = (role if k == 0 else "", name, size(m.bytes) + star, terms(m), m.prediction or "")
            rows.append(f"| {' | '.join(cells)} | {f'`{m.setting}`' if k == 0 else ''} | {m.note} |")
    return "\n".join(rows)


def memory_table() -> str:
    """Weights of the diffusion models in memory, computed from their parameters; those that nothing reads yet have no
    ``stored``, and an allowance of their own, as their autoencoders take a clip whole."""
    rows = ["| model | weights, float16 | weights, float32 | with the allowance, float16 |", "|---|---|---|---|"]
    for role in ("image", "views", "points", "points-pictures", "video"):
        for m in roles()[role]:
            half, full = (weights(m, SimpleNamespace(dtype=d)) for d in ("float16", "float32"))
            if half is not None and full is not None and m.stored is not None:
                rows.append(f"| `{m.id}` | {gib(half)} | {gib(full)} | {gib(half + ALLOWANCE)} |")
    return "\n".join(rows)


def bare() -> Report:
    """What the doctor finds here if there were no GPU and no weights."""
    with tempfile.TemporaryDirectory() as empty:
        before = {name: os.environ.get(name) for name in ("HF_HUB_CACHE", "XDG_CACHE_HOME")}
        os.environ.update(dict.fromkeys(before, empty))
        try:
            report = examine(ask=False)
        finally:
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})
    return dataclasses.replace(report, machine=dataclasses.replace(report.machine, gpus=(), driver=None))


def doctor_output(report: Report) -> str:
    """As it is printed, with the caches where they are by default."""
    for name in ("HF_HOME", "HF_HUB_CACHE", "XDG_CACHE_HOME"):
        os.environ.pop(name, None)
    return f"```text\n$ python -m diffuphy.doctor --offline\n{report}\n```"


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    parts = {"models": models_table(), "memory": memory_table(), "doctor": doctor_output(bare())}
    for part, content in parts.items():
        text = filled(text, part, content)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
