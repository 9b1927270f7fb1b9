"""Rows of eight numbers as the registers they fit into.

Warp spells vectors out, number by number, and leaves it to the compiler to find the registers again, which on a CPU
succeeds in part. These functions say it outright; on a GPU, where a thread has no vectors, they are the same sums.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

LANES = """{{
#if defined(__CUDACC__)
    {cuda}
#else
    #pragma clang fp contract(fast)
    typedef {real} lanes_t __attribute__((vector_size(8 * sizeof({real}))));
    {cpu}
#endif
}}"""

PLUS = {
    "cuda": "for (int i = 0; i < 8; ++i) s[i] += w * r[i]; return s;",
    "cpu": """
    lanes_t a, b;
    __builtin_memcpy(&a, &r, sizeof a);
    __builtin_memcpy(&b, &s, sizeof b);
    b = b + w * a;
    __builtin_memcpy(&s, &b, sizeof b);
    return s;
    """,
}

ADD = {
    "cuda": "wp::atomic_add(rows, o, wp::mul(w, r));",
    "cpu": """
    lanes_t a, b;
    auto& at = wp::index(rows, o);
    __builtin_memcpy(&a, &r, sizeof a);
    __builtin_memcpy(&b, &at, sizeof b);
    b = b + w * a;
    __builtin_memcpy(&at, &b, sizeof b);
    """,
}


@lru_cache
def make_simd(real: type) -> SimpleNamespace:
    """Warp functions ``plus``: s + w r, and ``add``: row o of an array += w r, of one writer at a time on a CPU."""
    row_t = wp.types.vector(8, real)
    name = "wp::float32" if real is wp.float32 else "wp::float64"

    @wp.func_native(LANES.format(real=name, **PLUS))
    def plus(s: row_t, w: real, r: row_t) -> row_t: ...

    @wp.func_native(LANES.format(real=name, **ADD))
    def add(rows: wp.array[row_t], o: int, w: real, r: row_t): ...

    return SimpleNamespace(plus=plus, add=add)
