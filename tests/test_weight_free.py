"""The default needs no weights and no optional package: what a run and each room really load, in fresh interpreters."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ABSENT = (
    "accelerate", "diffusers", "gsplat", "huggingface_hub", "lpips", "open_clip", "openai", "ray", "tensorboard",
    "tokenizers", "torchmetrics", "torchvision", "transformers", "viser",
)  # fmt: skip
"""Packages of real priors, of metrics with weights, and of extras."""


def python(code: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter; torch as it is without a network."""
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_whole_run_loads_no_model_library(whole_run):
    assert {"torch", "warp", "diffuphy.learning.fit_material"} <= whole_run.modules
    assert whole_run.modules.isdisjoint(ABSENT)


def test_a_whole_run_needs_no_model_library():
    """The stages are built and planned where those packages cannot be imported at all."""
    code = (
        f"import sys\nsys.modules.update(dict.fromkeys({(*ABSENT, 'imageio_ffmpeg', 'matplotlib')!r}))\n"
        "from hydra import compose, initialize_config_dir\nfrom hydra.utils import instantiate\n"
        "from diffuphy import composing, export, pipeline\nfrom diffuphy.plan import make_plan\n"
        "from diffuphy.workspace import Workspace\n"
        "with initialize_config_dir(str(composing.conf_dir()), version_base='1.3'):\n"
        "    cfg = compose('train', ['prompt=a rubber burger falling', 'hydra.run.dir=.'])\n"
        "components = instantiate(cfg.stages, _convert_='all')\n"
        "prompt = components['prompt'](work=Workspace())\n"
        "print(len(make_plan(components, prompt).lines) > 0)"
    )
    done = python(code)
    assert done.stdout.splitlines()[-1:] == ["True"], done.stderr


def test_importing_the_package_loads_no_torch():
    done = python("import diffuphy, sys\nprint({'torch', 'numpy', 'warp'} & set(sys.modules))")
    assert done.stdout.splitlines() == ["set()"], done.stderr


@pytest.mark.parametrize("room", ["mpm", "material"])
def test_physics_needs_torch_warp_and_numpy_alone(room):
    """And the file format of results and the progress bar; beyond these a room of physics loads this package alone."""
    code = (
        "import sys, numpy, safetensors.torch, torch, tqdm, warp\nbefore = set(sys.modules)\n"
        f"import diffuphy.{room}\n"
        "new = {name.partition('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)\n"
        "print(*sorted(new - {name.partition('.')[0] for name in before}))"
    )
    done = python(code)
    assert done.stdout.split() == ["diffuphy"], done.stderr
