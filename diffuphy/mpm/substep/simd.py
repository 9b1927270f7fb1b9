"""Rows of eight numbers as the registers they fit into.

Warp spells vectors out, number by number, and leaves it to the compiler to find the registers again; how well that
goes depends on the compiler's mood, and is worth a third of the speed of a transfer. These functions say it outright.
On a GPU, where a thread has no vectors, they are the plain sums.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

PLUS = """{
#if defined(__CUDACC__)
    for (int i = 0; i < 8; ++i)
        s[i] += w * r[i];
#else
    #pragma clang fp contract(fast)
    typedef REAL lanes_t __attribute__((vector_size(8 * sizeof(REAL))));
    lanes_t a, b;
    __builtin_memcpy(&a, &r, sizeof a);
    __builtin_memcpy(&b, &s, sizeof b);
    b = b + w * a;
    __builtin_memcpy(&s, &b, sizeof b);
#endif
    return s;
}"""

ADD = """{
#if defined(__CUDACC__)
    wp::atomic_add(rows, o + k, wp::mul(w, r));
#else
    #pragma clang fp contract(fast)
    typedef REAL lanes_t __attribute__((vector_size(8 * sizeof(REAL))));
    assert(o + k < rows.shape[0]);
    auto* at = &wp::index(rows, o) + k;
    lanes_t a, b;
    __builtin_memcpy(&a, &r, sizeof a);
    __builtin_memcpy(&b, at, sizeof b);
    b = b + w * a;
    __builtin_memcpy(at, &b, sizeof b);
#endif
}"""

TAKE = """{
    assert(o + k < rows.shape[0]);
    return (&wp::index(rows, o))[k];
}"""


@lru_cache
def make_simd(real: type) -> SimpleNamespace:
    """Warp functions on rows; an array of them is contiguous, so that neighbours share the place o of the first.

    ``plus(s, w, r)``: s + w r. ``take(rows, o, k)``: row o + k. ``add(rows, o, k, w, r)``: row o + k += w r, by one
    writer at a time on a CPU, atomically on a GPU.
    """
    row_t = wp.types.vector(8, real)

    def native(snippet: str) -> str:
        return snippet.replace("REAL", f"wp::{real.__name__}")

    @wp.func_native(native(PLUS))
    def plus(s: row_t, w: real, r: row_t) -> row_t: ...

    @wp.func_native(native(ADD))
    def add(rows: wp.array[row_t], o: int, k: int, w: real, r: row_t): ...

    @wp.func_native(native(TAKE))
    def take(rows: wp.array[row_t], o: int, k: int) -> row_t: ...

    return SimpleNamespace(plus=plus, add=add, take=take)
