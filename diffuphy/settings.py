"""Do the values of a configuration have the kinds that its components declare? Asked before anything is made."""

import dataclasses
import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from hydra.utils import get_object

RUN = {
    "seed": int,
    "device": str,
    "threads": int,
    "store": str,
    "until": str,
    "force": str | tuple[str, ...],
    "accuracy": float | None,
    "outputs": tuple[str, ...],
    "checkpoint_seconds": float,
    "viewer": Literal["off", "on"],
}
"""Kinds of the settings that belong to no component."""

PLAIN = {bool: "true or false", int: "a whole number", float: "a number", str: "text", types.NoneType: "null"}
"""How a person calls them."""


def check(tree: dict[str, Any]) -> None:
    """Refuse the first value of a resolved configuration whose kind is wrong.

    Raises:
        ValueError: with the path of the setting, what it must be and what it is.
    """
    checks = [(name, tree[name], hint) for name, hint in RUN.items() if name in tree]
    checks += [(f"stages.{name}", node, object) for name, node in tree.get("stages", {}).items()]
    checks += sorted(_declared(tree, ""), key=lambda found: found[0].count("."))  # where the user sets it, not a copy
    for name, value, hint in checks:
        if not fits(value, hint):
            raise ValueError(f"{name} must be {words(hint)}, got {value!r}")
    if not -(2**63) <= (seed := tree.get("seed", 0)) < 2**63:
        raise ValueError(f"seed must be a whole number from -2^63 to 2^63 - 1, got {seed}")


def _declared(tree: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any, Any]]:
    """Path, value and declared kind of every setting of every component, outermost first."""
    hints = _hints(tree.get("_target_"))
    yield from ((f"{prefix}{key}", tree[key], hint) for key, hint in hints.items() if key in tree)
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _declared(value, f"{prefix}{key}.")


def _hints(target: Any) -> dict[str, Any]:
    """Declared kinds of the settings of a component, or of a function that makes one; none for what is neither or
    cannot be imported."""
    try:
        component = get_object(target) if isinstance(target, str) else None
    except Exception:  # said better by whoever makes the component
        return {}
    declares = dataclasses.is_dataclass(component) or isinstance(component, types.FunctionType)
    return get_type_hints(component) if declares else {}


def fits(value: Any, hint: Any) -> bool:
    """Whether a plain value, or the mapping of a component, may stand where ``hint`` is declared."""
    origin, args = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if origin in (Union, types.UnionType):
        return any(fits(value, arg) for arg in args)
    if origin is Literal:
        return value in args
    if origin is tuple:
        kinds = args[:1] * len(value) if args[1:] == (...,) and isinstance(value, list) else args
        return isinstance(value, list) and len(value) == len(kinds) and all(map(fits, value, kinds))
    if origin is dict:
        return isinstance(value, dict) and all(fits(k, args[0]) and fits(v, args[1]) for k, v in value.items())
    if hint in PLAIN:
        exact = isinstance(value, int | float if hint is float else hint)
        return exact and (hint is bool or not isinstance(value, bool))
    return isinstance(value, dict) and "_target_" in value


def words(hint: Any) -> str:
    """A kind in words."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(words(arg) for arg in args))
    if origin is Literal:
        return " or ".join(map(repr, args))
    if origin is tuple:
        inner = ", ".join(words(arg) for arg in args if arg is not ...)
        return f"a list of {inner} each" if args[1:] == (...,) else f"a list [{inner}]"
    if origin is dict:
        return f"a mapping from {words(args[0])} to {words(args[1])}"
    return PLAIN.get(hint, "a component, which is named by _target_")
