"""One line about an error that the user can mend: what was got, what is allowed, what to change."""

import dataclasses
import difflib
import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, InstantiationException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

EXAMPLE = 'prompt="a rubber burger falling"'

EXTRAS = {
    "gsplat": "gsplat",
    "hydra_plugins": "sweep",
    "lpips": "eval",
    "openai": "llm",
    "ray": "ray",
    "tensorboard": "track",
    "torchmetrics": "eval",
    "trimesh": "mesh",
    "viser": "viewer",
}
"""Which extra brings an optional package."""


def explain(error: Exception, arguments: Sequence[str], conf: Path) -> str | None:
    """One line about ``error``, or None if it is a bug, whose traceback is worth more.

    Args:
        arguments: those of the command line, as Hydra got them.
        conf: the folder of the settings.
    """
    if missing := re.search(r"Missing mandatory value: (\S+)", str(error)):
        key = missing[1].removeprefix("stages.")  # a stage only points at what the user sets
        return f"{key} is missing; write {EXAMPLE if key == 'prompt' else f'{key}=...'}"
    if isinstance(error, InstantiationException):
        return _instantiation(error)
    if isinstance(error, HydraException | OmegaConfBaseException):
        return _composition(error, arguments, conf)
    if isinstance(error, OSError) and error.filename:
        return _file(error, arguments)
    return _plain(error)


def nearest(key: str, known: Sequence[str]) -> str | None:
    """The known name most like ``key``, by its last component or, among equals, by the whole; one that only goes on
    where ``key`` ends counts as nearer than four letters in five. None if none is alike."""

    def likeness(name: str) -> tuple[float, float]:
        ends = key.rpartition(".")[2], name.rpartition(".")[2]
        whole, end = (difflib.SequenceMatcher(None, *pair).ratio() for pair in ((key, name), ends))
        begun = 0.8 if len(key) > 2 and name.startswith(key) else 0.0
        return max(whole, end, begun), whole

    best = max(known, key=likeness, default=None)
    return best if best is not None and likeness(best)[0] >= 0.6 else None


def _plain(error: BaseException) -> str | None:
    """The error's own words, if it speaks to the user. A class whose module is not loaded cannot have been raised."""
    if isinstance(error, ModuleNotFoundError) and error.name in EXTRAS:
        return f"{error.name} is not installed; run: pip install 'diffuphy[{EXTRAS[error.name]}]'"
    heavy = (("diffuphy.types", "SimulationDiverged"), ("torch", "OutOfMemoryError"))
    expected = (ValueError, OSError, *(getattr(sys.modules[m], name) for m, name in heavy if m in sys.modules))
    return _flat(error) if isinstance(error, expected) else None


def _file(error: OSError, arguments: Sequence[str]) -> str:
    """Which file, and what to change when it lies in the store."""
    given = [a.partition("=")[2] for a in arguments if a.startswith("store=")]
    store, file = (Path(os.path.abspath(os.fsdecode(p))) for p in ((given or ["outputs"])[-1], error.filename))
    hint = "; choose another store with store=/path/to/folder" if store in (file, *file.parents) else ""
    return f"{os.fsdecode(error.filename)}: {error.strerror}{hint}"


def _flat(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _instantiation(error: InstantiationException) -> str | None:
    """Which component refused its settings, and what it said; also that there is no such component or setting."""
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    line = _plain(cause)
    if line is None and isinstance(cause, HydraException | ImportError | AttributeError | TypeError):
        line = _flat(cause)
    where = re.search(r"full_key: (\S+)", str(error))
    return f"{where[1]}: {line}" if where and line else line


def _composition(error: Exception, arguments: Sequence[str], conf: Path) -> str:
    """Find the override that does not fit by composing with one more at a time, and name what would."""
    from hydra._internal.utils import get_args_parser

    if isinstance(error, OverrideParseException):
        return f"cannot read {error.override!r}; a value with special characters goes in quotes, key='\"a, b\"'"
    args = get_args_parser().parse_args(list(arguments))
    name = args.config_name or "train"
    path = [f"hydra.searchpath=[file://{Path(args.config_dir).absolute()}]"] if args.config_dir else []
    overrides = sorted(OverridesParser.create().parse_overrides(args.overrides), key=lambda o: "." in o.key_or_group)
    with initialize_config_dir(str(Path(args.config_path or conf).absolute()), version_base="1.3"):
        accepted = path
        try:
            cfg = compose(name, overrides=accepted)
        except HydraException as broken:
            return _flat(broken)
        for override in overrides:
            try:
                cfg = compose(name, overrides=[*accepted, _one(override)])
                accepted = [*accepted, _one(override)]
            except (HydraException, OmegaConfBaseException) as refused:
                return _refused(override, cfg, refused)
    return _flat(error)


def _one(override: Override) -> str:
    """The override itself, or the first element of a sweep."""
    if not override.is_sweep_override():
        return str(override.input_line)
    return f"{override.get_key_element()}={next(iter(override.sweep_string_iterator()))}"


def _refused(override: Override, cfg: DictConfig, error: Exception) -> str:
    """Why ``cfg`` does not take ``override``: no such group option, no such key, or a value of the wrong kind."""
    hydra = GlobalHydra.instance()
    assert hydra.hydra is not None
    loader, key = hydra.config_loader(), override.key_or_group
    groups = sorted(_groups(loader))
    if key in groups:
        options = loader.get_group_options(key)
        guess = nearest(str(override.value()), options)
        hint = f"did you mean {key}={guess}? " if guess else ""
        return f"{key} has no option {override.value()!r}; {hint}the options are {', '.join(options)}"
    keys = [*_keys(OmegaConf.to_container(cfg)), *groups]
    if key in keys:
        return f"{override.input_line}: {_flat(error).partition(' full_key')[0]}"
    fields = _fields(cfg, key)
    if key in fields:
        return f"{key} is not listed in the configuration; write +{override.input_line}"
    guess = nearest(key, [*keys, *fields])
    mended = f"+{guess}" if guess in fields and guess not in keys else guess
    return f"there is no setting {key!r}; " + (f"did you mean {mended}?" if guess else "--help lists all settings")


def _keys(tree: Any, prefix: str = "") -> Iterator[str]:
    if isinstance(tree, dict):
        for name, value in tree.items():
            yield f"{prefix}{name}"
            yield from _keys(value, f"{prefix}{name}.")


def _groups(loader: ConfigLoader, parent: str = "") -> Iterator[str]:
    for name in loader.list_groups(parent):
        yield f"{parent}{name}"
        yield from _groups(loader, f"{parent}{name}/")


def _fields(cfg: DictConfig, key: str) -> list[str]:
    """Settings of the component that ``key`` would belong to, also those the configuration leaves at their default."""
    parent = key.rpartition(".")[0]
    node = OmegaConf.select(cfg, parent, throw_on_missing=False, throw_on_resolution_failure=False) if parent else None
    if not isinstance(node, DictConfig) or "_target_" not in node:
        return []
    from hydra.utils import get_object

    try:
        component = get_object(node["_target_"])
    except Exception:  # a component that cannot be imported has no settings to offer
        return []
    return [f"{parent}.{f.name}" for f in dataclasses.fields(component)] if dataclasses.is_dataclass(component) else []
