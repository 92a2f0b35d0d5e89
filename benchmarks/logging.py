"""The log writer of handctl beside mcap-ros2-support, rosbags, JSON and the Foxglove SDK: the same messages.

``python benchmarks/logging.py [--quick] [--json]``. Each writes the messages of a run of hand jamia11 at 1 kHz,
raw frames included. Compare ratios within one run only. The cost for the loop differs in kind: handctl hands a
record to another process, the others write in the loop.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
if __name__ == "logging":  # a script beside this one wants Python's own module, which this file hides from it
    import importlib.machinery
    import importlib.util

    elsewhere = [place for place in sys.path if Path(place or ".").resolve() != HERE]
    spec = importlib.machinery.PathFinder.find_spec("logging", elsewhere)
    sys.modules["logging"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
else:
    sys.path[:] = [place for place in sys.path if Path(place or ".").resolve() != HERE]
    sys.path[:0] = [str(HERE.parent), str(HERE.parent / "tests" / "log")]

    from benchmarks.writers.measure import main

    if __name__ == "__main__":
        main(__doc__)
