"""No kernel reads or writes outside of its arrays: a run with Warp's bounds checks on."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import warp as wp
wp.config.mode = "debug"  # every array access is checked, and the first wrong one ends the process
import torch
from diffuphy.mpm import HalfSpace, Scene, Scheme, Sphere, Drag, rollout
from tests.mpm.bodies import block, field

if {wrong}:
    @wp.kernel
    def beyond(a: wp.array(dtype=float)):
        a[wp.tid() + 8] = 1.0
    wp.launch(beyond, 8, inputs=[wp.zeros(8, dtype=float, device="cpu")], device="cpu")

ball = Sphere(center=(0.3, 0.3, -0.1), radius=0.2)
walls = (HalfSpace(friction=0.3), HalfSpace(kind="slip", normal=(1.0, 0.0, 0.0)), ball)
x, vol = block((2, 2, 2), 0.1, (0.0, 0.1, 0.02))
f = field(len(x), ("hencky",), ("drucker_prager",), E=2e4)
f.theta["E"].requires_grad_()
for scheme in (Scheme(), Scheme(contact="elastic"), Scheme.mls()):
    scene = Scene(dx=0.1, fps=60.0, frames=2, lift=None, velocity=(0.5, 0.0, -2.0), boundaries=walls, scheme=scheme,
                  drives=(Drag(time=1.0),))
    out = rollout(scene, x, vol, f, grad=True, threads=1, velocity=3.0 * torch.sin(20.0 * x))
    (out.x[-1].square().sum() + out.v[-1].square().sum()).backward()
print("done")
"""


def run(tmp_path: Path, wrong: bool) -> subprocess.CompletedProcess:
    """The script in a process of its own, since a failed check ends it; with kernels of its own."""
    root = Path(__file__).parents[2]
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path), "PYTHONPATH": str(root)}
    return subprocess.run(
        [sys.executable, "-c", SCRIPT.format(wrong=wrong)], cwd=root, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


def test_kernels_stay_within_their_arrays(tmp_path):
    """Forward and backward, walls, mirrors, balls, drives, grains, three schemes; in one thread, since code with checks
    is not made for more."""
    result = run(tmp_path, wrong=False)
    assert result.returncode == 0 and "done" in result.stdout, result.stderr[-2000:]


def test_the_check_would_notice(tmp_path):
    """A kernel that writes beyond its array ends the process before anything else."""
    result = run(tmp_path, wrong=True)
    assert result.returncode != 0 and "done" not in result.stdout
