"""The C++ that a kernel becomes."""

from pathlib import Path

import warp as wp


def source(kernel: wp.Kernel) -> str:
    """Text of a kernel compiled for a CPU, with every function that it calls."""
    kernel.module.load("cpu", 1)
    (path,) = Path(wp.config.kernel_cache_dir, kernel.module.get_module_identifier(1)).glob("*.cpp")
    return path.read_text()
