"""Warp, set up once for every room: silent, and compiling in one thread at a time.

Warp builds and loads a module at its first launch, and two threads that do so at once crash the process. Whoever may
launch from several threads loads under ``LOCK`` first; after that launches need no lock.
"""

import threading
from typing import Any

import warp as wp

wp.config.log_level = wp.LOG_WARNING  # before Warp starts: a library does not greet
wp.init()

LOCK = threading.RLock()
"""Held by the one thread that makes, builds or loads kernels."""


def load(kernel: wp.Kernel, device: Any) -> None:
    """Build and load a kernel for a device, unless that was done before."""
    with LOCK:
        kernel.module.load(device, 256 if device.is_cuda else 1)
