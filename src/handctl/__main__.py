"""Program `python -m handctl`.

``python -m handctl`` runs the command line on a machine that has no `handctl` script on the PATH.
"""

import sys

from handctl.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
