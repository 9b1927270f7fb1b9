"""The material stage under each real video prior, by the lines that a user with real weights types."""

import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parent))
import tiny_models

from diffuphy.cli import main
from diffuphy.types import MaterialField

FRAMES = {"modelscope": 4, "wan": 5, "cogvideox": 5}


pytestmark = pytest.mark.usefixtures("quiet")


def fitted(store: Path, name: str, folder: Path, *more: str) -> int:
    """A tiny film up to its material, with the object of the whole run."""
    n = FRAMES[name]
    return main(
        [
            "prompt=a rubber burger falling", "experiment=tiny", f"store={store}", "device=cpu", "until=material",
            f"video_guidance={name}", f"video_guidance.model={folder}", "video_guidance.size=32",
            f"material.probe.frames={n}", f"material.scan_frames={n}", "material.steps=2", *more,
        ]
    )  # fmt: skip


@pytest.mark.parametrize("name", FRAMES)
def test_a_material_is_fitted_to_a_real_video_prior(name, whole_run, tmp_path):
    """Scan and training run through the prior; the field differs from the one of the embedded prior."""
    store = tmp_path / "store"
    shutil.copytree(whole_run.store, store, symlinks=True)
    known = set(store.glob("material/*/meta.json"))
    assert fitted(store, name, getattr(tiny_models, name)(tmp_path / name)) == 0
    (found,) = set(store.glob("material/*/meta.json")) - known
    field = MaterialField.load(found.parent)
    assert all(bool(v.isfinite().all()) for v in field.theta.values())


def test_a_clip_of_a_wrong_length_is_refused_in_one_line(whole_run, tmp_path, caplog):
    """Wan's autoencoder takes 4 k + 1 frames; the run ends with the lengths that it would take."""
    store = tmp_path / "store"
    shutil.copytree(whole_run.store, store, symlinks=True)
    folder = tiny_models.wan(tmp_path / "wan")
    assert fitted(store, "wan", folder, "material.probe.frames=4", "material.scan_frames=4") != 0
