"""``python -m benchmarks.stability``."""

from benchmarks.stability import main

if __name__ == "__main__":
    raise SystemExit(main())
