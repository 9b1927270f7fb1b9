"""``python -m diffuphy prompt="a rubber burger falling"``."""

import sys

from diffuphy.cli import main

if __name__ == "__main__":
    sys.exit(main())
