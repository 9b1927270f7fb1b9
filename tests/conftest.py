"""What every test has in common: no network, one thread a process, GPU tests only where there is a GPU."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

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


@pytest.fixture(scope="session")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of tiny checkpoints of the real classes: sd-epsilon, sd-v_prediction, mvdream, mvdream-v_prediction and
    modelscope."""
    for package in ("diffusers", "transformers"):
        pytest.importorskip(package)
    sys.path.insert(0, str(Path(__file__).parent))
    import tiny_models

    root = tmp_path_factory.mktemp("checkpoints")
    for prediction in ("epsilon", "v_prediction"):
        tiny_models.stable_diffusion(root / f"sd-{prediction}", prediction)
    tiny_models.mvdream(root / "mvdream")
    tiny_models.mvdream(root / "mvdream-v_prediction", "v_prediction")
    tiny_models.modelscope(root / "modelscope")
    return root


@pytest.fixture
def quiet():
    """Hydra sets up logging for the whole process and torch its threads; each test leaves both as it found them."""
    import logging

    import torch

    root = logging.getLogger()
    handlers, level, threads = root.handlers[:], root.level, torch.get_num_threads()
    yield
    root.handlers[:] = handlers
    root.setLevel(level)
    torch.set_num_threads(threads)


@dataclass(frozen=True)
class WholeRun:
    """One undisturbed run of ``train.py`` in a process of its own."""

    arguments: list[str]
    store: Path
    folder: Path
    """The run's own folder, with the film."""
    output: str
    """What it wrote to standard error."""
    modules: frozenset[str]
    """Everything it had imported at its end."""


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> WholeRun:
    """A rubber burger, falling, in a quarter of a minute. Read its results, or copy them to change them."""
    base = tmp_path_factory.mktemp("whole")
    arguments = ["prompt=a rubber burger falling", "experiment=tiny", f"store={base / 'store'}", "device=cpu"]
    code = (
        "import atexit, runpy, sys\nfrom pathlib import Path\n"
        f"atexit.register(lambda: Path({str(base / 'modules')!r}).write_text('\\n'.join(sys.modules)))\n"
        f"sys.argv = ['train.py', *{arguments!r}]\nrunpy.run_path('train.py', run_name='__main__')"
    )
    root = Path(__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (folder,) = (base / "store/runs").iterdir()
    modules = frozenset((base / "modules").read_text().splitlines())
    return WholeRun(arguments, base / "store", folder, done.stderr, modules)
