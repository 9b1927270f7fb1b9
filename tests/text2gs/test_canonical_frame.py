"""The frame of a prior's clouds is told from clouds whose frame is known."""

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[1]))
import tiny_models

from diffuphy.text2gs.canonical_frame import canonical_frame, chamfer, turned
from diffuphy.types import Look

ROOT = Path(__file__).parents[2]
LOOK = Look("corgi", "a corgi")


@dataclass(frozen=True)
class Drawer:
    """Draws a body with a head in front (+x) and a tail, anew each time, ``step`` degrees further for each view."""

    step: float
    round: bool = False

    def sample(self, words, camera, generator, device="cpu", view=None):
        body = (2 * torch.rand(300, 3, generator=generator) - 1) * torch.tensor([0.6, 0.6 if self.round else 0.2, 0.3])
        if self.round:  # a barrel
            body[:, :2] /= body[:, :2].norm(dim=1, keepdim=True)
        head = 0.4 * torch.rand(100, 3, generator=generator) + torch.tensor([0.5, 0.0, 0.3])
        x = body if self.round else torch.cat([body, head])
        return turned(x, self.step * view), torch.rand(len(x), 3, generator=generator)


@pytest.mark.parametrize(
    ("step", "frame"), [(0.0, "object"), (-90.0, "camera"), (90.0, "mirrored camera"), (0.0, "unclear")]
)
def test_the_frame_is_told_from_four_views(step, frame):
    """A cloud that turns with the camera needs the camera's azimuth to come back; one that is round tells nothing."""
    drawer = Drawer(step, round=frame == "unclear")
    verdict = canonical_frame(drawer, LOOK, torch.Generator().manual_seed(0))
    assert verdict.frame == frame
    if frame != "unclear":
        expected = [(-step * v + 180) % 360 - 180 for v in range(4)]
        off = [abs((a - b + 180) % 360 - 180) for a, b in zip(verdict.turns, expected, strict=True)]
        assert max(off) <= 10  # steps of 5°, and clouds of 400 points drawn anew
        assert min(verdict.distance, key=verdict.distance.get) == frame and frame in str(verdict)


def test_turns_and_distances():
    x = torch.tensor([[1.0, 0.0, 2.0]])
    torch.testing.assert_close(turned(x, 90.0), torch.tensor([[0.0, 1.0, 2.0]]), rtol=0, atol=1e-6)
    a, b = torch.tensor([[0.0, 0, 0], [1.0, 0, 0]]), torch.tensor([[0.0, 0, 0]])
    assert chamfer(a, b) == pytest.approx(0.25)  # ½ ((0 + 1)/2 + 0)


def test_the_command_asks_the_weights_it_is_given(tmp_path, capsys):
    """On tiny checkpoints and a painter of noise: one line a fact, and a status that says whether the supposition of
    the shape prior holds."""
    pytest.importorskip("transformers")
    tiny_models.clip(tmp_path / "clip")
    file = tiny_models.point_e(tmp_path / "tiny.pt", kind="grid", features=32)
    tiny_models.mvdream(tmp_path / "mvdream")
    spec = importlib.util.spec_from_file_location("canonical_frame_tool", ROOT / "tools/canonical_frame.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    guidance = "fit.shape.guidance"
    settings = {"checkpoint": file, "clip": tmp_path / "clip", "painter.model": tmp_path / "mvdream"}
    settings |= {"painter.dtype": "float32"}
    added = {"painter.size": 32, "points": 8, "steps": 2}
    options = [f"{guidance}.{k}={v}" for k, v in settings.items()] + [f"+{guidance}.{k}={v}" for k, v in added.items()]
    status = tool.main(["prompt=a corgi, sitting", "device=cpu", *options])
    said = capsys.readouterr().out
    assert status == (0 if "frame: object" in said else 1)
    assert all(word in said for word in ("corgi", "mean distance", "best turns", "°"))
