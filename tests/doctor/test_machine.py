"""What the machine says of itself."""

import pytest

from diffuphy.doctor.machine import OPTIONAL, Machine, memory, version


@pytest.mark.parametrize(
    ("limit", "total", "free"), [("max", 8000, 4000), ("5120000", 5000, 4000), ("1024000", 1000, 1000)]
)
def test_memory_is_that_of_the_control_group_if_that_is_less(tmp_path, limit, total, free):
    (tmp_path / "meminfo").write_text("MemTotal: 8000 kB\nMemFree: 1 kB\nMemAvailable: 4000 kB\n")
    (tmp_path / "max").write_text(f"{limit}\n")
    assert memory(tmp_path / "meminfo", tmp_path / "max") == (1024 * total, 1024 * free)


def test_this_machine(monkeypatch, tmp_path):
    """Disk is that of the weights' folder, or of the nearest one above it; versions are those that run."""
    import torch
    import warp

    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "not/yet/there"))
    m = Machine.this()
    assert m.torch == torch.__version__ and m.warp == warp.__version__ and 0 < m.free <= m.bytes and m.disk > 0
    assert len(m.gpus) == torch.cuda.device_count() and m.cores >= 1 and set(m.packages) == set(OPTIONAL)


def test_a_package_that_is_not_there_has_no_version():
    assert version("no-such-package") is None and version("pytest") == pytest.__version__
