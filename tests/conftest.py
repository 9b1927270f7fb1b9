"""What every test has in common: no network, one thread a process, GPU tests only where there is a GPU."""

import os

import pytest
from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small tensors: threads cost more than they bring
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.pop("HYDRA_FULL_ERROR", None)

settings.register_profile("diffuphy", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("diffuphy")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("gpu"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")
