"""What a choice needs, counted by hand."""

from dataclasses import dataclass, field, replace

import pytest

from diffuphy.doctor.machine import Gpu, Machine
from diffuphy.doctor.needs import ALLOWANCE, need
from diffuphy.models import roles

SD, MS, CHAT = (roles()[role][0] for role in ("image", "video", "chat-local"))

CPU = Machine("3", "2", None, "1", None, None, 2, 8 * 2**30, 8 * 2**30, 2**40, (), {})


@dataclass(frozen=True)
class Network:
    model: str
    dtype: str = "float16"


@dataclass(frozen=True)
class Stage:
    guidance: Network
    other: tuple = field(default_factory=tuple)


def test_memory_is_that_of_the_weights_and_the_allowance():
    """Denoiser in its precision, autoencoder in float32; the text encoder has gone by then. One model counts once."""
    unet, vae = (SD.parts[p].parameters for p in ("unet", "vae"))
    for dtype, width in (("float16", 2), ("float32", 4)):
        stage = Stage(Network(SD.id, dtype))
        assert need("x", {"a": stage, "b": stage}).bytes == width * unet + 4 * vae + ALLOWANCE


def test_two_models_are_added_and_scores_are_not():
    alone = [need("", {"a": Stage(Network(m.id))}).bytes - ALLOWANCE for m in (SD, MS)]
    both = need("", {"a": Stage(Network(SD.id)), "b": Stage(Network(MS.id)), "evaluate": Stage(Network(CHAT.id))})
    assert both.bytes == sum(alone) + ALLOWANCE and both.scores == (CHAT,) and both.models == (SD, MS)


def test_a_model_of_unknown_size_is_not_guessed():
    assert need("", {"a": Stage(Network(CHAT.id))}).bytes is None


def test_what_is_in_a_folder_of_ones_own_needs_nothing_known():
    assert need("", {"a": Stage(Network("/path/to/folder"))}).models == ()


@pytest.mark.parametrize("spare", [0, -1])
def test_the_verdict_turns_at_the_last_byte(spare):
    """On the largest GPU, or on the CPU where there is none."""
    wanted = need("", {"a": Stage(Network(SD.id))})
    gpus = (Gpu("small", 1, 1, "9.0"), Gpu("large", wanted.bytes + spare, 1, "9.0"))
    on_gpu, on_cpu = (replace(CPU, **has) for has in ({"gpus": gpus}, {"bytes": wanted.bytes + spare}))
    assert ("does not fit" in wanted.verdict(on_gpu)) == ("does not fit" in wanted.verdict(on_cpu)) == bool(spare)
    assert "large" in wanted.verdict(on_gpu) and "no GPU" in wanted.verdict(on_cpu)
    assert need("", {}).verdict(CPU) == "runs"
