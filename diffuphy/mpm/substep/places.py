"""Indices of nodes in their block."""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp


@lru_cache
def make_places() -> SimpleNamespace:
    """Warp functions ``index`` of a row, and ``flat``, the row of three indices."""

    @wp.func(module="unique")
    def index(o: wp.int32, n: wp.vec3i) -> wp.vec3i:
        """Indices of a node along the axes."""
        yz = n[1] * n[2]
        i = o // yz
        j = (o - i * yz) // n[2]
        return wp.vec3i(i, j, o - i * yz - j * n[2])

    @wp.func(module="unique")
    def flat(i: wp.int32, j: wp.int32, k: wp.int32, n: wp.vec3i) -> wp.int32:
        """Row of a node, −1 outside of the block."""
        if i < 0 or j < 0 or k < 0 or i >= n[0] or j >= n[1] or k >= n[2]:
            return -1
        return (i * n[1] + j) * n[2] + k

    return SimpleNamespace(index=index, flat=flat)
