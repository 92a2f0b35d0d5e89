"""Program ``python -m handctl.cli``, the same as the command ``handctl``."""

import sys

from handctl.cli.main import main

sys.exit(main())
