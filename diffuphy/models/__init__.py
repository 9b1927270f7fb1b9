"""Pretrained models: where their weights are, and how they are read."""

from diffuphy.models.weights import (
    MissingWeights,
    absent,
    hub_cache,
    load_component,
    missing,
    missing_file,
    read,
    verified,
    where,
)

__all__ = [
    "MissingWeights",
    "absent",
    "hub_cache",
    "load_component",
    "missing",
    "missing_file",
    "read",
    "verified",
    "where",
]
