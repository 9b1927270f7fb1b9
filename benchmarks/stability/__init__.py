"""Where the simulation is stable, where it says that it is not, and where it would be wrong in silence.

python -m benchmarks stability            # the whole map, seven minutes on two cores: docs/numerics/stability.md
python -m benchmarks stability --quick    # one law and a few cells, to see that it runs

Law × E × ν × speed of impact × CFL × precision on lines, corners and points inside; the largest stable step of every
law; runs of 1e5 substeps; extreme input and what is said to it. Ends with an error if anything is silent but bodies of
one and two cells at rest on an elastic floor, of which the page says so.
"""

from benchmarks.stability.report import main

__all__ = ["main"]
