"""Ask Point-E's real weights in which frame its clouds stand. The shape prior supposes: in that of the object.

    python tools/canonical_frame.py prompt="a corgi" fit.shape.guidance.checkpoint=base_40m.pt

Takes the settings of train.py. Answers "object" when the supposition holds; then look at the printed box, too: a corgi
that faces +x is longer in x than in y, or else ``yaw`` of ``PointE`` is wrong. Exit status 1 unless it holds.
"""

import sys
from collections.abc import Sequence

import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from diffuphy.composing import conf_dir, device
from diffuphy.quoting import protect
from diffuphy.text2gs.canonical_frame import canonical_frame
from diffuphy.workspace import Workspace

PRESET = ("fit=point_e", "guidance=mvdream", "fit.shape.guidance.upsampler=''")
"""Any noun phrase, and clouds as the base network draws them."""


def main(arguments: Sequence[str]) -> int:
    """Print the verdict."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides=[*PRESET, *protect(list(arguments))])
    words = instantiate(cfg.refine, _convert_="all")(work=Workspace()).look
    prior = instantiate(cfg.fit.shape.guidance, _convert_="all")
    verdict = canonical_frame(prior, words, torch.Generator().manual_seed(cfg.seed), device(cfg.device))
    print(f"{words.text}\n{verdict}")
    return 0 if verdict.frame == "object" else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
