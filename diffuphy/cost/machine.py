"""How fast the present machine is, against the one on which the prices were measured.

A yardstick of a tenth of a second, a step of material points written in torch so that nothing has to be compiled: its
processor time here over that on the reference machine scales all prices. It runs when a plan first wants it, and its
result is kept in the user's cache folder; a person who changes the processor deletes that file.
"""

import json
import os
import platform
import time
from functools import cache
from pathlib import Path

import torch

POINTS = 20_000
"""Points of the yardstick; their 27 nodes each stay in a second-level cache, as those of a usual object do."""


def folder() -> Path:
    """Where the result is kept: ``$XDG_CACHE_HOME/diffuphy``, by default ``~/.cache/diffuphy``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "diffuphy"


def name(device: str = "cpu") -> str:
    """What the machine calls itself."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    try:
        info = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        return next(line.split(":")[1].strip() for line in info.splitlines() if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def measure(device: str = "cpu", repeats: int = 5) -> float:
    """Time of the yardstick [s]: the best of some, on one thread; processor time on a CPU."""
    g = torch.Generator().manual_seed(0)
    x = torch.rand(POINTS, 3, generator=g).to(device)
    node = torch.randint(0, 27_000, (POINTS,), generator=g).to(device)
    clock = time.perf_counter if device.startswith("cuda") else time.process_time
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return min(_once(x, node, device, clock) for _ in range(repeats))
    finally:
        torch.set_num_threads(threads)


def _once(x: torch.Tensor, node: torch.Tensor, device: str, clock) -> float:
    begin = clock()
    grid = torch.zeros(27_000 + 27, 3, device=device)
    F = torch.eye(3, device=device).expand(POINTS, 3, 3)
    for k in range(9):
        grid.index_add_(0, node + k, x * (0.1 * k))
        F = F + 1e-3 * (F @ (x[:, :, None] * grid[node + k][:, None, :]))
    float((F.sum() + grid.sum()).log1p())
    return clock() - begin


@cache
def pace(reference: float, device: str = "cpu") -> float:
    """Time of the yardstick here over ``reference`` [-]; more than 1 is slower than the reference machine."""
    file = folder() / "pace.json"
    key = f"{name(device)}, torch {torch.__version__}"
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        kept = {}
    if not isinstance(kept.get(key), float):
        kept[key] = measure(device)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            temporary = file.with_name(f"{file.name}.{os.getpid()}")
            temporary.write_text(json.dumps(kept, indent=1), encoding="utf-8")
            temporary.replace(file)
        except OSError:  # a home that cannot be written: measured again next time
            pass
    return kept[key] / reference
