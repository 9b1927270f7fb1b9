"""A value of the wrong kind is refused by its path before anything is made."""

from dataclasses import dataclass, field
from typing import Any, Literal

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from diffuphy.composing import conf_dir
from diffuphy.settings import check, fits


@dataclass(frozen=True)
class Inner:
    width: float = 1.0


@dataclass(frozen=True)
class Outer:
    steps: int = 3
    rate: float = 0.1
    on: bool = True
    name: str = "a"
    mode: Literal["x", "y"] = "x"
    color: tuple[float, float] | None = None
    names: tuple[str, ...] = ()
    table: dict[str, float | None] = field(default_factory=dict)
    inner: Inner = field(default_factory=Inner)
    free: Any = None


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Test files are no modules of their own; the configuration names classes by module."""
    import sys
    from types import ModuleType

    module = ModuleType("components_of_a_test")
    module.Outer, module.Inner = Outer, Inner
    monkeypatch.setitem(sys.modules, module.__name__, module)


def outer(**settings):
    return {"fit": {"_target_": "components_of_a_test.Outer", **settings}}


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("steps", "abc", "fit.steps must be a whole number, got 'abc'"),
        ("steps", 1.5, "fit.steps must be a whole number, got 1.5"),
        ("steps", True, "fit.steps must be a whole number, got True"),
        ("rate", "fast", "fit.rate must be a number, got 'fast'"),
        ("rate", None, "fit.rate must be a number, got None"),
        ("on", 1, "fit.on must be true or false, got 1"),
        ("name", 5, "fit.name must be text, got 5"),
        ("mode", "z", "fit.mode must be 'x' or 'y', got 'z'"),
        ("color", "red", r"fit.color must be a list \[a number, a number\] or null, got 'red'"),
        ("color", [1, 2, 3], r"a list \[a number, a number\]"),
        ("names", "a", "fit.names must be a list of text each"),
        ("names", [1], "fit.names must be a list of text each"),
        ("table", {"E": "x"}, "fit.table must be a mapping from text to a number or null"),
        ("inner", {"width": 2}, "fit.inner must be a component, which is named by _target_"),
        ("inner", {"_target_": "components_of_a_test.Inner", "width": "w"}, "fit.inner.width must be a number"),
    ],
)
def test_wrong_kind_is_named_by_its_path(name, value, says):
    with pytest.raises(ValueError, match=says):
        check(outer(**{name: value}))


def test_right_kinds_pass():
    """A whole number is a number; the settings of what cannot be imported are its own affair."""
    inner = {"_target_": "components_of_a_test.Inner", "width": 2}
    check(
        outer(
            steps=1,
            rate=1,
            on=False,
            name="",
            mode="y",
            color=[0, 1.0],
            names=[],
            table={"E": None},
            inner=inner,
            free={"a": 1},
        )
    )
    check(outer(color=None))
    check({"fit": {"_target_": "no.such.Class", "steps": "abc"}, "other": {"steps": "abc"}})


def test_a_function_that_makes_a_component_declares_kinds_too():
    scene = {"_target_": "diffuphy.physgaussian.scene", "file": "a.json", "particles": None, "scheme": {}}
    check({"scene": scene})
    with pytest.raises(ValueError, match=r"scene\.particles must be a whole number or null, got 'many'"):
        check({"scene": scene | {"particles": "many"}})


@pytest.mark.parametrize(
    ("tree", "says"),
    [
        ({"seed": "x"}, "seed must be a whole number"),
        ({"checkpoint_seconds": "x"}, "checkpoint_seconds must be a number"),
        ({"force": [1]}, "force must be text or a list of text each"),
        ({"stages": {"clip": None}}, "stages.clip must be a component"),
    ],
)
def test_settings_of_the_run_are_checked(tree, says):
    with pytest.raises(ValueError, match=says):
        check(tree)


@pytest.mark.parametrize("experiment", ["", "tiny", "fast", "quality", "faithful", "multiview"])
def test_every_shipped_configuration_passes(experiment):
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides=["prompt=a", *([f"experiment={experiment}"] if experiment else [])])
    check(OmegaConf.to_container(cfg, resolve=True))


def test_a_list_of_any_length_fits_an_open_tuple():
    assert fits([], tuple[int, ...]) and fits([1, 2, 3], tuple[int, ...]) and not fits([1.5], tuple[int, ...])


@pytest.mark.parametrize("seed", [10**20, 2**63, -(2**63) - 1])
def test_a_seed_that_no_generator_takes_is_refused(seed):
    with pytest.raises(ValueError, match=f"seed must be a whole number from .* got {seed}"):
        check({"seed": seed})
    check({"seed": 2**63 - 1})
