"""``python -m benchmarks.work_precision``."""

from benchmarks.work_precision import main

if __name__ == "__main__":
    raise SystemExit(main())
