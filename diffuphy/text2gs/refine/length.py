"""How long a sentence is for CLIP, which reads 77 tokens and cuts off the rest without a word."""

import functools
from collections.abc import Callable

CONTEXT = 77
"""Tokens that the text encoders of CLIP, and with them of Stable Diffusion, read, start and end among them (Radford
et al. 2021, §2.4)."""
ENDS = 2


@functools.cache
def _tokenizer() -> Callable[[str], list[int]]:
    """CLIP's byte-pair encoding; open_clip brings the vocabulary with it, nothing is downloaded."""
    from open_clip.tokenizer import SimpleTokenizer

    return SimpleTokenizer().encode


def tokens(text: str) -> int:
    """Number of CLIP tokens of a text, start and end among them.

    A token is one byte or more, so that what is short in bytes fits in any case: only for longer texts the tokenizer
    is loaded, which takes seconds.
    """
    most = len(text) + ENDS
    return most if text.isascii() and most <= CONTEXT else len(_tokenizer()(text)) + ENDS
