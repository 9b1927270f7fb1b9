"""``python -m benchmarks.study``."""

from benchmarks.study import main

raise SystemExit(main())
