"""Pretrained models: which are known, where their weights are, and how they are read."""

from diffuphy.models.cache import hub_cache, offline, place
from diffuphy.models.registry import Model, choose, known, roles
from diffuphy.models.weights import (
    MissingWeights,
    Parts,
    absent,
    command,
    load_component,
    missing,
    missing_file,
    read,
    require,
    verified,
    where,
)

__all__ = [
    "MissingWeights", "Model", "Parts", "absent", "choose", "command", "hub_cache", "known", "load_component",
    "missing", "missing_file", "offline", "place", "read", "require", "roles", "verified", "where",
]  # fmt: skip
