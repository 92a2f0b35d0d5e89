"""What each part of the controller is worth: tracking at three speeds and a step of force, one thing more at a time.

``python benchmarks/control.py [--quick] [--json] [--seeds N] [--tune] [--page]``; all of it is in ``trials.tracking``.
"""

import sys
from importlib import import_module
from pathlib import Path

if __name__ == "__main__":
    from trials.tracking import main

    main()
else:
    # A benchmark's folder comes first on its path, so whoever imports python-control from there meets this file.
    sys.path = [place for place in sys.path if Path(place).resolve() != Path(__file__).parent] + [
        str(Path(__file__).parent)
    ]
    del sys.modules[__name__]
    sys.modules[__name__] = import_module(__name__)
