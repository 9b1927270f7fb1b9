"""The page about weights says what the registry and the doctor say."""

import re
import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import weights_page

from diffuphy.losses.guidance.stable_diffusion import StableDiffusion
from diffuphy.models import MissingWeights

TEXT = weights_page.PAGE.read_text(encoding="utf-8")


def part(name: str) -> str:
    return TEXT.split(f"<!-- {name} -->\n")[1].split(f"\n<!-- /{name} -->")[0]


def test_the_tables_are_those_of_the_registry():
    """Run tools/weights_page.py when this fails."""
    assert part("models") == weights_page.models_table()
    assert part("memory") == weights_page.memory_table()


def test_the_output_is_the_doctors(monkeypatch):
    """All but versions and sizes of the machine it was written on. Run tools/weights_page.py when this fails."""
    for name in ("HF_HOME", "HF_HUB_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")

    def comparable(text: str) -> list[str]:
        machine, rest = text.split("\n\n", 1)
        labels = [line.split()[0] for line in machine.splitlines()]
        return [*labels, *re.sub(r"[\d.]+ GiB, where", "GiB, where", rest).splitlines()]

    assert comparable(part("doctor")) == comparable(weights_page.doctor_output(weights_page.bare()))


def test_the_message_of_the_page_is_the_one_that_is_printed(monkeypatch, tmp_path):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(MissingWeights) as e:
        StableDiffusion().networks(torch.device("cpu"))
    assert str(e.value) in " ".join(TEXT.split())
