"""`python -m wtg_gym.cli` is `wtg-gym`."""

import sys

from wtg_gym.cli import main

if __name__ == "__main__":
    sys.exit(main())
