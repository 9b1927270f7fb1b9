"""How long a sentence is for CLIP, which reads 77 tokens and cuts off the rest without a word."""

import functools
from collections.abc import Callable

CONTEXT = 77
"""Tokens that the text encoders of CLIP, and with them of Stable Diffusion, read, start and end among them (Radford
et al. 2021, §2.4)."""
ENDS = 2
"""Tokens that begin and end every text."""
ROOM = 3
"""Tokens of what a prior appends (", overhead view")."""
LIMIT = CONTEXT - ROOM
"""Tokens that a prompt may have, its ends among them."""


@functools.cache
def _tokenizer() -> Callable[[str], list[int]]:
    """CLIP's byte-pair encoding; open_clip brings the vocabulary with it, nothing is downloaded."""
    from open_clip.tokenizer import SimpleTokenizer

    return SimpleTokenizer().encode


def tokens(text: str) -> int:
    """Number of CLIP tokens of a text, start and end among them.

    A token of ASCII is one character or more, so that what has few characters fits in any case, and these are an upper
    bound that is good enough: only for longer texts the tokenizer is loaded, which takes seconds.
    """
    most = len(text) + ENDS
    return most if text.isascii() and most <= LIMIT else len(_tokenizer()(text)) + ENDS
