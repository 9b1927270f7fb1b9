"""Free text on the command line: any prompt survives Hydra's override grammar.

Hydra reads ``key=value`` with a grammar of its own, in which a comma starts a sweep, an apostrophe opens a string,
``1`` is a number and every letter outside ASCII is an error. A value that is *text* must reach the configuration as it
was typed, so the keys named in ``FREE_TEXT`` are quoted here before Hydra sees them.

Two ways of writing keep their meaning: a value that is already one quoted string (``prompt="'a, b'"`` is ``a, b``),
and, in a sweep (``-m``), a comma between texts or a Hydra function such as ``choice(a,b)``.
"""

import re
from collections.abc import Sequence

from hydra.core.override_parser.types import Quote, QuotedString

FREE_TEXT = frozenset({"prompt", "negative", "path"})
"""Last component of the keys whose values are text."""

FUNCTION = re.compile(r"(choice|shuffle|sort|range|glob|interval|str)\(.*\)", re.DOTALL)
"""A sweep written as a Hydra function."""

STRING = r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*\""""
"""One string in quotes; a backslash protects the character after it."""

QUOTED = re.compile(rf"\s*(?:{STRING})\s*", re.DOTALL)

ELEMENT = re.compile(rf"\s*(?:{STRING})\s*(?=,|$)|[^,]*", re.DOTALL)
"""What stands between two commas of a sweep: a quoted string, or anything without a comma."""

INTERPOLATION = re.compile(r"(\\*)\$\{")


def protect(argv: Sequence[str]) -> list[str]:
    """Quote the free text among command-line arguments; everything else passes unchanged.

    Args:
        argv: arguments without the program's name.
    """
    sweep = any(re.fullmatch(r"-m|--mu[a-z]*|hydra\.mode=MULTIRUN", a) for a in argv)
    return [_protect(a, sweep) for a in argv]


def quote(text: str) -> str:
    """``text`` as a Hydra string that is read back as exactly ``text``.

    Two readers stand behind each other. OmegaConf would replace ``${``, so that gets a backslash, and backslashes
    before it are doubled; Hydra would end the string at an apostrophe, which its own ``QuotedString`` takes care of.
    """
    return QuotedString(literal(text), Quote.single).with_quotes()


def literal(text: str) -> str:
    """``text`` as OmegaConf reads it back: an interpolation in it is none."""
    return INTERPOLATION.sub(lambda m: m[1] * 2 + "\\${", text)


def split(value: str) -> list[str]:
    """The elements of a sweep over texts: at every comma outside a quoted element."""
    parts, start = [], 0
    while start <= len(value):
        match = ELEMENT.match(value, start)
        assert match is not None  # the second alternative matches anything, the empty string too
        parts.append(match[0].strip())
        start = match.end() + 1
    return parts


def _protect(argument: str, sweep: bool) -> str:
    key, equals, value = argument.partition("=")
    if not equals or key.lstrip("+").rpartition(".")[2] not in FREE_TEXT:
        return argument
    if sweep and FUNCTION.fullmatch(value):
        return argument
    parts = split(value) if sweep else [value]
    return f"{key}={','.join(part if QUOTED.fullmatch(part) else quote(part) for part in parts)}"
