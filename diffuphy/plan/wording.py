"""What became of the words."""

from diffuphy.plan.line import Line
from diffuphy.types import Prompt


def prompt_lines(prompt: Prompt) -> list[Line]:
    """How refinement by a language model ended; said in every run, also where its result is cached."""
    if not prompt.turns:
        return []
    tried = f"{len(prompt.turns)} tried, taken: {prompt.look.text}"
    if failure := prompt.turns[-1].failure:
        return [Line("prompt refinement", "ended early", f"{failure}; force=prompt tries again; {tried}")]
    return [Line("prompt refinement", "kept", tried)]
