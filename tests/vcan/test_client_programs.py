"""Run motor clients of other authors, each in an environment of its own, with simulated drives on real SocketCAN.

The clients open a SocketCAN interface themselves, so the tests run them in a virtual machine that
has a SocketCAN interface.

The virtual machine has no network, so the tests make the Python environments of the clients before
the virtual machine starts. The tests with motor clients run only in nightly test runs. If pip
cannot install a client, its test is skipped with pip's reason. ``HANDCTL_CLIENT_ENVIRONMENTS``
names a folder that keeps the Python environments for the next test run.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.vcan import uml_guest
from tests.vcan.clients.check_list import FAILED_WORD, PASSED_WORD

INSTALL_TIMEOUT_S = 900.0
RUN_TIMEOUT_S = 400.0
READY_FILE = "handctl-requirements.txt"
"""File that lists the requirements of a Python environment. Only a complete environment contains this file."""

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.realtime,
    pytest.mark.timeout(INSTALL_TIMEOUT_S + RUN_TIMEOUT_S),
]


class ClientProgram(NamedTuple):
    """Program that uses a client of another author.

    Attributes:
        module: module of the program in ``tests.vcan.clients``.
        expected_check_count: number of checks that the program must make.
        drive_arguments: protocol and options of the simulated drives.
        package: pip requirement of the client, which is installed without its own requirements.
        requirements: pip requirements that the used part of the client imports.
    """

    module: str
    expected_check_count: int
    drive_arguments: tuple[str, ...]
    package: str
    requirements: tuple[str, ...] = ()


CLIENT_PROGRAMS = {
    "openarm_can": ClientProgram(
        "openarm_client", 13, ("mit", "--ids", "1,2,3", "--fd"), "openarm_can==1.4.1"
    ),
    "can-motor-control": ClientProgram(
        "rust_client",
        14,
        ("mit", "--ids", "1,2,3", "--fd", "--motor-type", "dm4340"),
        "can-motor-control==0.0.8",
        ("numpy>=1.26,<3",),
    ),
    "i2rt": ClientProgram(
        "i2rt_client",
        16,
        ("mit", "--ids", "1,2,3,4"),
        "dreamscale-i2rt==1.3.6.post1",
        (
            "python-can==4.6.1",
            "numpy>=1.26,<3",
            "tyro>=1,<2",
            "pydantic>=2,<3",
            "crcmod-plus>=2.3.1,<3",
            "packaging",
            "pyyaml>=6,<7",
        ),
    ),
    "odrive": ClientProgram(
        "odrive_package",
        4,
        ("odrive", "--ids", "0,1"),
        "odrive==0.6.11.post1",
        ("aiohttp>=3,<4", "ipython>=8,<10", "setuptools<81", "libusb-package==1.0.30.0"),
    ),
}


def _install_client(environment: Path, program: ClientProgram) -> None:
    """Make a Python environment with a client. If pip cannot install the client, skip the test."""
    requirements = "\n".join((program.package, *program.requirements))
    ready = environment / READY_FILE
    if ready.exists() and ready.read_text(encoding="utf-8") == requirements:
        return
    subprocess.run([sys.executable, "-m", "venv", "--clear", str(environment)], check=True)
    pip = [str(environment / "bin" / "python"), "-m", "pip", "--disable-pip-version-check"]
    for words in (program.requirements, ("--no-deps", program.package)):
        if not words:
            continue
        result = subprocess.run(
            [*pip, "install", "--quiet", *words],
            capture_output=True,
            text=True,
            timeout=INSTALL_TIMEOUT_S,
            check=False,
        )
        if result.returncode:
            pytest.skip(
                f"pip cannot install {program.package}: {_pip_failure_reason(result.stderr)}"
            )
    ready.write_text(requirements, encoding="utf-8")


def _pip_failure_reason(text: str) -> str:
    """Return the most specific line of an error message of pip."""
    lines = [line.strip() for line in text.splitlines()]
    for word in ("fatal:", "ERROR:", "error:"):  # a line of git begins with "fatal:"
        if reasons := [line for line in lines if line.startswith(word)]:
            return reasons[0]
    return text[-300:]


@pytest.fixture
def client_python_path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return the path of the Python interpreter in an environment with a client."""
    name = str(request.node.callspec.params["name"])
    folder = Path(os.environ.get("HANDCTL_CLIENT_ENVIRONMENTS") or tmp_path) / name
    _install_client(folder, CLIENT_PROGRAMS[name])
    return folder / "bin" / "python"


def _client_variables(client_python_path: Path) -> dict[str, str]:
    """Return the environment variables that a client needs.

    The package odrive loads the library libusb by the file name of the library.
    """
    code = "import libusb_package; print(libusb_package.get_library_path())"
    result = subprocess.run(
        [str(client_python_path), "-c", code], capture_output=True, text=True, check=False
    )
    if result.returncode:
        return {}
    link = client_python_path.parent / "libusb-1.0.so.0"
    link.unlink(missing_ok=True)
    link.symlink_to(result.stdout.strip())
    return {"LD_LIBRARY_PATH": str(link.parent)}


@pytest.mark.parametrize("name", CLIENT_PROGRAMS)
def test_a_client_of_another_author_passes_all_its_checks(
    name: str, client_python_path: Path
) -> None:
    kind, reason = uml_guest.vcan_access()
    if not kind:
        pytest.skip(reason)
    program = CLIENT_PROGRAMS[name]
    output: list[str] = []
    status = uml_guest.run_with_vcan(
        [
            sys.executable,
            "-m",
            "tests.vcan.clients.client_runner",
            str(client_python_path),
            f"tests.vcan.clients.{program.module}",
            *program.drive_arguments,
        ],
        _client_variables(client_python_path),
        RUN_TIMEOUT_S,
        output.append,
    )
    passed_check_lines = [line for line in output if line.startswith(PASSED_WORD)]
    failed_checks = [line for line in output if line.startswith(FAILED_WORD)]
    print(f"{name}: {len(passed_check_lines)} of {program.expected_check_count} checks passed")
    text = "\n".join(output[-40:])
    assert failed_checks == []
    assert status == 0, text
    assert len(passed_check_lines) == program.expected_check_count, text
