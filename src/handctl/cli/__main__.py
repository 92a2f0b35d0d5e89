"""Entry point of ``python -m handctl.cli``, which does the same as the command ``handctl``."""

import sys

from handctl.cli.main import main

sys.exit(main())
