"""Many runs, and a number of each. Whatever two of them share is computed once.

    python examples/sweep.py
    python examples/sweep.py experiment=tiny

The films of the same runs, and a table of their scores, from the command line:

    python train.py -m prompt="a rubber ball bouncing,a clay ball bouncing" seed=0,1
    python -m diffuphy.scorecard outputs/runs/a-*-ball-bouncing-*

A film that fails does not stop the others; docs/cli.md says how they run side by side or on a cluster. Writes
outputs/examples/runs/. 38 seconds of one core, with experiment=tiny.
"""

import sys

import diffuphy


def main(*settings: str, seeds: tuple[int, ...] = (0, 1)) -> dict[tuple[str, int], float]:
    heights = {}
    for material in ("rubber", "clay"):
        for seed in seeds:
            common = ("until=trajectory", "store=outputs/examples", *settings)
            made = diffuphy.film(f"a {material} ball bouncing", f"seed={seed}", *common)
            low = made.result("trajectory").x[:, :, 2].amin(1)  # underside [m]
            touched = int((low < 0.5 * low[0]).nonzero()[0]) if (low < 0.5 * low[0]).any() else 0
            heights[material, seed] = float(low[touched:].max() / low[0])
            print(f"{material}, seed {seed}: comes back to {heights[material, seed]:.0%} of the height of its fall")
    return heights


if __name__ == "__main__":
    main(*sys.argv[1:])
