"""``handctl --help`` answers at once, because a verb's libraries are imported when the verb is called."""

import importlib.util
import subprocess
import sys
import time

import pytest

HEAVY = ("can", "control", "daqp", "filterpy", "matplotlib", "mcap", "mujoco", "pyarrow", "pydantic", "rerun", "scipy")
LIMIT_S = 0.3
LIMIT_INTERPRETERS = 10
"""Limit on a slow or busy machine, in start-up times of an empty interpreter."""
HELP = "from handctl.cli.main import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("handctl.cli") is None or importlib.util.find_spec("handctl.cli.main") is None,
    reason="there is no command line yet",
)


def seconds(code: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return time.perf_counter() - start


@pytest.mark.realtime
@pytest.mark.alone
def test_help_answers_at_once() -> None:
    pairs = [(seconds("pass"), seconds(HELP)) for _ in range(5)]
    bare, full = (min(column) for column in zip(*pairs, strict=True))
    allowed = max(LIMIT_S, LIMIT_INTERPRETERS * bare)
    assert full <= allowed, f"handctl --help {full:.2f} s, bare interpreter {bare:.3f} s"


def test_help_imports_no_heavy_library() -> None:
    code = f"{HELP}import sys\nprint('loaded:', *(name for name in {HEAVY} if name in sys.modules))"
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.startswith("usage: handctl")
    assert ran.stdout.splitlines()[-1] == "loaded:"


def test_a_run_starts_without_scipy_stats() -> None:
    code = "import sys\nfrom handctl.cli.main import main\nmain(['demo', '--lockstep', '--dry-run'])\n"
    code += "print([name for name in ('control', 'filterpy.kalman', 'scipy.stats') if name in sys.modules])\n"
    code += "from scipy.signal import find_peaks_cwt\nimport numpy as np\n"
    code += "print(find_peaks_cwt(np.sin(np.arange(0.0, 9.0, 0.05)), [20]).size)"
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.splitlines()[-2:] == ["['control', 'filterpy.kalman']", "2"]
