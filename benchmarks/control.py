"""Measure how the parts of the control law change the tracking error and the reaction to a force step.

Each case of the benchmark uses one more part of the control law than the case before it.

``python benchmarks/control.py [--quick] [--json] [--seeds N] [--tune] [--page]``, see
``trials.tracking``.
"""

import sys
from importlib import import_module
from pathlib import Path

if __name__ == "__main__":
    from trials.tracking import main

    main()
else:
    # Python searches the folder of this script first. Because of the name of this script, ``import
    # control`` would import this script instead of the package ``control``.
    sys.path = [
        search_path
        for search_path in sys.path
        if Path(search_path).resolve() != Path(__file__).parent
    ] + [str(Path(__file__).parent)]
    del sys.modules[__name__]
    sys.modules[__name__] = import_module(__name__)
