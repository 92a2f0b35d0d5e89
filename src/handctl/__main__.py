"""Run the command line as `python -m handctl`, where no script folder is on the path."""

import sys

from handctl.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
