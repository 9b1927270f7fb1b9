"""The page about the Python API does what it says."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "api.md"


def test_every_code_block_runs_in_order():
    """One namespace for the page, as for somebody who types it in; a block that fails names its line."""
    text, names = PAGE.read_text(encoding="utf-8"), {}
    blocks = list(re.finditer(r"```python\n(.*?)```", text, re.S))
    assert len(blocks) > 5
    for block in blocks:
        above = text[: block.start(1)].count("\n")
        exec(compile("\n" * above + block.group(1), str(PAGE), "exec"), names)
