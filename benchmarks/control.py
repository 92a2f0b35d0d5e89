"""Ablation of the controller: tracking and a force step, with one more part of the control law in each case.

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
    # Python searches the folder of this script first. ``import control`` would find this script
    # there, and not the package ``control``.
    sys.path = [place for place in sys.path if Path(place).resolve() != Path(__file__).parent] + [
        str(Path(__file__).parent)
    ]
    del sys.modules[__name__]
    sys.modules[__name__] = import_module(__name__)
