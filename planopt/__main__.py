"""Run the command line: ``python -m planopt``."""

import sys

from planopt.cli import main

sys.exit(main())
