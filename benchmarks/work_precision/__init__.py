"""Error against run time, ours and others': a bar, a manufactured solution, a beam, friction, water, a ball, gradients.

    python -m benchmarks work_precision                       # all cases, fifteen minutes
    python -m benchmarks work_precision --cases W1 W6         # some
    python -m benchmarks work_precision --quick               # two resolutions of four settings each, half a minute
    python -m benchmarks work_precision --peers-python PATH   # with other codes, where that Python has them

Each case is swept over Δx with the default and with one setting changed at a time; runs take turns (ABBA), seconds are
medians of processor time on one thread. Writes docs/benchmarks/work_precision/*.csv and *.svg and
docs/numerics/accuracy.md.
"""

from benchmarks.work_precision.command import main

__all__ = ["main"]
