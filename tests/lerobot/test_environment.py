"""Run the tests of this folder with the real LeRobot, in an environment that the test creates.

The test runs only in nightly test runs, because the packages of LeRobot take 6 GB.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY_ROOT = Path(__file__).parents[2]
LEROBOT_REQUIREMENT = "lerobot==0.4.4"
LEROBOT_PYTHON_PATH = os.environ.get("HANDCTL_LEROBOT_PYTHON", "")
"""Path of the Python interpreter of an existing environment with LeRobot.

If ``LEROBOT_PYTHON_PATH`` is empty, the test creates a new environment.
"""
INSTALL_TIMEOUT_S = 3600.0
TESTS_TIMEOUT_S = 1800.0
MIN_PASSED_TESTS = 13
"""Smallest number of tests with the real LeRobot that must pass, so that skipped tests are noticed."""


def run_pip(lerobot_python: str, *pip_arguments: str) -> None:
    """Install packages into the environment of the Python interpreter ``lerobot_python``."""
    command = [
        lerobot_python,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "install",
        "--quiet",
        *pip_arguments,
    ]
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S, check=False
    )
    assert result.returncode == 0, result.stderr[-2000:]


def link_ffmpeg(lerobot_python: str, link_folder: Path) -> str:
    """Create links to the FFmpeg libraries of PyAV, with the names under which torchcodec looks for them.

    Returns: The folders that ``LD_LIBRARY_PATH`` must contain.
    """
    code = "import av, pathlib; print(pathlib.Path(av.__file__).parent.with_name('av.libs'))"
    result = subprocess.run(
        [lerobot_python, "-c", code], capture_output=True, text=True, check=True
    )
    libraries = Path(result.stdout.strip())
    link_folder.mkdir()
    for path in libraries.glob("lib*.so.*"):
        if name := re.fullmatch(r"(lib(?:av|sw)\w+)-[0-9a-f]+\.so\.(\d+)\..*", path.name):
            (link_folder / f"{name[1]}.so.{name[2]}").symlink_to(path)
    return f"{link_folder}{os.pathsep}{libraries}"


@pytest.fixture
def lerobot_python(tmp_path: Path) -> str:
    """Return the path of the Python interpreter of an environment with LeRobot, handctl and the plug-in."""
    if LEROBOT_PYTHON_PATH:
        return LEROBOT_PYTHON_PATH
    folder = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python_path = str(folder / "bin" / "python")
    run_pip(python_path, "--requirement", str(Path(__file__).parent / "requirements.txt"))
    run_pip(python_path, "--no-deps", LEROBOT_REQUIREMENT)
    run_pip(python_path, "--editable", f"{REPOSITORY_ROOT}[sim,export]")
    run_pip(
        python_path,
        "--no-deps",
        "--no-build-isolation",
        "--editable",
        str(REPOSITORY_ROOT / "lerobot_robot_handctl"),
    )
    return python_path


@pytest.mark.nightly
@pytest.mark.timeout(INSTALL_TIMEOUT_S + TESTS_TIMEOUT_S)
def test_everything_passes_with_the_real_lerobot(lerobot_python: str, tmp_path: Path) -> None:
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "HANDCTL_NIGHTLY")
    }
    environment["LD_LIBRARY_PATH"] = link_ffmpeg(lerobot_python, tmp_path / "ffmpeg")
    command = [lerobot_python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/lerobot"]
    result = subprocess.run(
        command,
        cwd=REPOSITORY_ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TESTS_TIMEOUT_S,
        check=False,
    )
    assert result.returncode == 0, result.stdout[-3000:]
    passed_match = re.search(r"(\d+) passed", result.stdout)
    assert passed_match is not None
    assert int(passed_match[1]) >= MIN_PASSED_TESTS, result.stdout[-500:]
