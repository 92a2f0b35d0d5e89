"""Test that ``handctl --help`` starts fast: the libraries of a command are imported only when the command runs."""

import importlib.util
import subprocess
import sys
import time

import pytest

HEAVY_LIBRARIES = (
    "can",
    "control",
    "daqp",
    "filterpy",
    "matplotlib",
    "mcap",
    "mujoco",
    "pyarrow",
    "pydantic",
    "rerun",
    "scipy",
)
UNUSED_SCIPY_PACKAGES = (
    "fft",
    "interpolate",
    "ndimage",
    "optimize",
    "signal",
    "spatial",
    "special",
    "stats",
)
"""Packages of scipy that a run does not import if its hand has springs."""
MAX_HELP_TIME_S = 0.3
MAX_HELP_TIME_RATIO = 10
"""Longest permitted run time of ``handctl --help`` on a slow or busy machine.

The longest permitted run time is given in units of the start-up time of an empty Python
interpreter.
"""
HELP_SCRIPT = (
    "from handctl.cli.main import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
)

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("handctl.cli") is None
    or importlib.util.find_spec("handctl.cli.main") is None,
    reason="there is no command line yet",
)


def run_duration_s(program_text: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", program_text], check=True, capture_output=True)
    return time.perf_counter() - start


@pytest.mark.realtime
@pytest.mark.alone
def test_help_answers_at_once() -> None:
    pairs = [(run_duration_s("pass"), run_duration_s(HELP_SCRIPT)) for _ in range(5)]
    bare, full_time_s = (min(column) for column in zip(*pairs, strict=True))
    allowed = max(MAX_HELP_TIME_S, MAX_HELP_TIME_RATIO * bare)
    assert full_time_s <= allowed, (
        f"handctl --help {full_time_s:.2f} s, bare interpreter {bare:.3f} s"
    )


def test_help_imports_no_heavy_library() -> None:
    code = f"{HELP_SCRIPT}import sys\nprint('loaded:', *(name for name in {HEAVY_LIBRARIES} if name in sys.modules))"
    result = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert result.stdout.startswith("usage: handctl")
    assert result.stdout.splitlines()[-1] == "loaded:"


def test_a_run_starts_without_packages_that_it_does_not_use() -> None:
    unused_packages = ("control", "matplotlib", "numpy.f2py", "numpy.testing")
    names = (
        "filterpy.kalman",
        *unused_packages,
        *(f"scipy.{scipy_package}" for scipy_package in UNUSED_SCIPY_PACKAGES),
    )
    code = (
        "import sys\nfrom handctl.cli.main import main\nmain(['demo', '--lockstep', '--dry-run'])\n"
    )
    code += f"print([name for name in {names} if name in sys.modules])\n"
    code += (
        "from control import dlqr\nfrom scipy.signal import find_peaks_cwt\nimport numpy as np\n"
    )
    code += "print(dlqr(np.eye(1), np.eye(1), np.eye(1), np.eye(1))[0].size)\n"
    code += "print(find_peaks_cwt(np.sin(np.arange(0.0, 9.0, 0.05)), [20]).size)\n"
    code += "np.testing.assert_allclose(1.0, 1.0)\nprint(np.f2py.__name__)"
    result = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert result.stdout.splitlines()[-4:] == ["['filterpy.kalman']", "1", "2", "numpy.f2py"]
