"""``python -m handctl.cli``: the same as ``handctl``."""

import sys

from handctl.cli.main import main

sys.exit(main())
