"""The page about priors does what it says."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs/guidance.md"


def test_every_code_block_runs_in_order():
    """One namespace for the page; the prior of one's own finds its colour, to 0.05."""
    text, names = PAGE.read_text(encoding="utf-8"), {}
    blocks = list(re.finditer(r"```python\n(.*?)```", text, re.S))
    assert len(blocks) == 2
    for block in blocks:
        above = text[: block.start(1)].count("\n")
        exec(compile("\n" * above + block.group(1), str(PAGE), "exec"), names)
