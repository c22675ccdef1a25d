"""Run the command line: ``python -m planopt``."""

import sys

from planopt.cli import main

if __name__ == "__main__":  # Worker processes import this file as well.
    sys.exit(main())
