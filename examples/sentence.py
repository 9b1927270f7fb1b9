"""A sentence becomes a film, and every result on the way can be looked at.

python examples/sentence.py
python examples/sentence.py experiment=tiny seed=3
"""

import sys

import diffuphy
from diffuphy.making import Made


def main(*overrides: str) -> Made:
    made = diffuphy.film("a rubber burger falling", *overrides)
    field, motion = made.result("material"), made.result("trajectory")
    share = dict(zip(field.elastic, field.w_e.mean(0).tolist(), strict=True))
    print(f"{len(field)} particles, laws {share}, E = {field.theta['E'].mean():.3g} Pa")
    print(f"lowest point of the flight: {motion.x[:, :, 2].min():.3f} m; film: {made.files['film']}")
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
