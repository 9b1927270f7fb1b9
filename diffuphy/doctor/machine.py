"""The machine: processors, memory, versions."""

import os
import platform
import shutil
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from diffuphy.models import hub_cache

OPTIONAL = (
    "diffusers", "transformers", "open_clip_torch", "accelerate", "safetensors", "huggingface_hub", "openai", "gsplat",
    "lpips", "torchmetrics", "viser", "num2words",
)  # fmt: skip
"""Packages that some choices need."""


@dataclass(frozen=True)
class Gpu:
    """One CUDA device."""

    name: str
    bytes: int
    """Its memory."""
    free: int
    """What of it nobody uses now [byte]."""
    capability: str
    """Compute capability, ``9.0``."""


@dataclass(frozen=True)
class Machine:
    """What decides which models run."""

    python: str
    torch: str
    torch_cuda: str | None
    """CUDA that torch was built for; None of a build for CPUs."""
    warp: str
    warp_cuda: str | None
    """CUDA that Warp was built for."""
    driver: str | None
    """Newest CUDA that the driver runs; None without a driver."""
    cores: int
    bytes: int
    """Memory that this process may have: of the machine, or of its control group if that is less."""
    free: int
    """What of the machine's memory is available now [byte]."""
    disk: int
    """Free where weights are kept [byte]."""
    gpus: tuple[Gpu, ...]
    packages: dict[str, str | None]
    """Version of each of ``OPTIONAL``; None where it is not installed."""

    @classmethod
    def this(cls) -> "Machine":
        """The present one."""
        import torch
        import warp

        import diffuphy.compiling  # noqa: F401, starts Warp silently

        total, free = memory()
        return cls(
            python=platform.python_version(),
            torch=torch.__version__,
            torch_cuda=torch.version.cuda,
            warp=warp.__version__,
            warp_cuda=_dotted(warp.get_cuda_toolkit_version()),
            driver=_dotted(warp.get_cuda_driver_version()),
            cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
            bytes=total,
            free=free,
            disk=shutil.disk_usage(_existing(hub_cache())).free,
            gpus=gpus(),
            packages={name: version(name) for name in OPTIONAL},
        )


def gpus() -> tuple[Gpu, ...]:
    """CUDA devices that torch sees."""
    import torch

    found = []
    for k in range(torch.cuda.device_count() if torch.cuda.is_available() else 0):
        free, total = torch.cuda.mem_get_info(k)
        major, minor = torch.cuda.get_device_capability(k)
        found.append(Gpu(torch.cuda.get_device_name(k), total, free, f"{major}.{minor}"))
    return tuple(found)


def memory(proc: Path = Path("/proc/meminfo"), group: Path = Path("/sys/fs/cgroup/memory.max")) -> tuple[int, int]:
    """Memory of the machine or of the control group, and what is available [byte]."""
    total = free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if proc.is_file():
        lines = dict(line.split(":") for line in proc.read_text(encoding="utf-8").splitlines() if ":" in line)
        total, free = (1024 * int(lines[key].split()[0]) for key in ("MemTotal", "MemAvailable"))
    limit = group.read_text(encoding="utf-8").strip() if group.is_file() else "max"
    return (total, free) if limit == "max" else (min(total, int(limit)), min(free, int(limit)))


def version(package: str) -> str | None:
    """Of an installed package, without importing it."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _dotted(pair: tuple[int, int] | None) -> str | None:
    return None if pair is None else ".".join(map(str, pair))


def _existing(path: Path) -> Path:
    """The folder itself, or the nearest above it that is there."""
    return next(p for p in (path, *path.absolute().parents) if p.exists())
