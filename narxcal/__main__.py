"""`python -m narxcal`, the command where no script is installed."""

import sys

from narxcal.cli.app import main

if __name__ == "__main__":
    sys.exit(main())
