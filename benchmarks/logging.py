"""Compare the log writer of handctl with mcap-ros2-support, rosbags, JSON and the Foxglove SDK.

``python benchmarks/logging.py [--quick] [--json]``. Each library writes the same messages of a run
of the hand jamia11 at 1 kHz. The messages include the raw frames. Absolute times of different runs
are not comparable. Compare only ratios of times from the same run. The control loop of handctl
passes each record to another process, which writes the log. All log writers except the writer of
handctl write the log within the control loop.
"""

import sys
from pathlib import Path

BENCHMARKS_FOLDER = Path(__file__).resolve().parent
if (
    __name__ == "logging"
):  # If this file could be imported, it would hide Python's module ``logging``, which other scripts need.
    import importlib.machinery
    import importlib.util

    other_folders = [
        search_path
        for search_path in sys.path
        if Path(search_path or ".").resolve() != BENCHMARKS_FOLDER
    ]
    spec = importlib.machinery.PathFinder.find_spec("logging", other_folders)
    sys.modules["logging"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
else:
    sys.path[:] = [
        search_path
        for search_path in sys.path
        if Path(search_path or ".").resolve() != BENCHMARKS_FOLDER
    ]
    sys.path[:0] = [str(BENCHMARKS_FOLDER.parent), str(BENCHMARKS_FOLDER.parent / "tests" / "log")]

    from benchmarks.writers.measure_writers import main

    if __name__ == "__main__":
        main(__doc__)
