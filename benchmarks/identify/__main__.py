"""``python -m benchmarks.identify``."""

from benchmarks.identify import main

if __name__ == "__main__":
    raise SystemExit(main())
