"""A sentence becomes a film, and every result on the way can be looked at.

    python examples/sentence.py
    python examples/sentence.py experiment=tiny seed=3

Arguments are settings, as those of train.py. Writes outputs/examples/runs/a-rubber-burger-falling-…/: film.mp4,
contact_sheet.png, report.html and the rest. 21 seconds of one core, with experiment=tiny.
"""

import sys

import diffuphy
from diffuphy.making import Made


def main(*settings: str) -> Made:
    made = diffuphy.film("a rubber burger falling", "store=outputs/examples", *settings)
    field, motion = made.result("material"), made.result("trajectory")
    share = dict(zip(field.elastic, field.w_e.mean(0).tolist(), strict=True))
    print(f"{len(field)} particles, elastic laws {share}, mean E {field.theta['E'].mean():.3g} Pa")
    fastest = motion.v.norm(dim=2).max()
    print(f"fastest particle {fastest:.2f} m/s, lowest {motion.x[:, :, 2].min():.3f} m; {made.files['film']}")
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
