"""Run the command line as `python -m handctl`, for a machine without the `handctl` script on its PATH."""

import sys

from handctl.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
