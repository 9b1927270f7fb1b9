"""A run in a browser: play it, paint it by stress, change what it is made of, pull at it. And without a browser.

    python examples/viewer.py --serve                                # open the address that it prints; Ctrl-C ends it
    python examples/viewer.py experiment=tiny                        # without a browser: drop it as clay, film that

``--serve`` is ``python -m diffuphy.viewer outputs/examples/runs/NAME`` and wants viser
(pip install 'diffuphy[viewer]'); it listens on this machine alone. Writes
outputs/examples/runs/a-jelly-burger-falling-…/viewer/film_001.mp4. 17 seconds of one core, with experiment=tiny.
"""

import sys
import time

import diffuphy
from diffuphy.viewer.__main__ import main as view
from diffuphy.viewer.change import Change
from diffuphy.viewer.opened import Run
from diffuphy.viewer.session import Session


def main(*settings: str) -> tuple[float, float]:
    made = diffuphy.film("a jelly burger falling", "store=outputs/examples", *(s for s in settings if s != "--serve"))
    if "--serve" in settings:
        view([str(made.folder)])
    session = Session(Run.open(made.folder))
    as_found = session.shot.trajectory
    for work in (lambda: session.simulate(Change(material="clay", height=0.8, particles=800)), session.export_film):
        work()  # in the background, as buttons of a page do
        while session.job.running:
            time.sleep(0.05)
        print(session.job.message)
    as_clay = session.shot.trajectory
    heights = [(t.x[-1, :, 2].amax() - t.x[-1, :, 2].amin()).item() for t in (as_found, as_clay)]
    print(f"in the end {heights[0]:.3f} m high as it was found, {heights[1]:.3f} m as clay from 0.8 m")
    session.close()
    return heights[0], heights[1]


if __name__ == "__main__":
    main(*sys.argv[1:])
