"""``python -m benchmarks.verification``."""

from benchmarks.verification import main

if __name__ == "__main__":
    raise SystemExit(main())
