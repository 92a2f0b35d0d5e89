"""Test that ``handctl demo`` runs after a wheel of handctl was installed into a new Python environment.

The new Python environment is outside of the repository.

Each test installs further extras in the same environment, so the tests run in the order of this
file. A test cannot use the packages of extras that a later test installs.
"""

import os
import re
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
SIZE_WITHOUT_EXTRAS_MB = 300
"""Largest size of the packages that are installed without extras [MB]."""
CONTROLLER_SIZE_MB = 620
"""Largest size of the packages that a controller needs [MB].

numba with LLVM takes 210 MB, scipy 145 MB, numpy 75 MB, and the dependencies of the package control
take 105 MB.
"""
GOLDEN_LOG = REPOSITORY / "logs" / "golden" / "jamia-grasp.mcap"

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1800)]


class WheelEnvironment:
    """A Python environment that has the wheel of handctl, but no access to the repository.

    Args:
        environment_folder: folder that contains the environment, and in which its programs run.
    """

    def __init__(self, environment_folder: Path) -> None:
        self.folder = environment_folder
        self.wheel = self._build_wheel()
        venv.create(environment_folder / "env", with_pip=True)
        self._constraints = environment_folder / "constraints.txt"
        pinned_requirements = re.findall(
            r"^[a-z0-9][^\n]*==[^\n\\]*",
            (REPOSITORY / "requirements-dev.lock").read_text(),
            re.MULTILINE,
        )
        self._constraints.write_text("\n".join(pinned_requirements))

    def _build_wheel(self) -> Path:
        wheel_folder = self.folder / "dist"
        command = [
            sys.executable,
            "-m",
            "hatchling",
            "build",
            "--target",
            "wheel",
            "--directory",
            str(wheel_folder),
        ]
        subprocess.run(command, cwd=REPOSITORY, check=True, capture_output=True)
        (wheel,) = wheel_folder.glob("*.whl")
        return wheel

    def run(self, *program_arguments: str, exit_code: int = 0) -> subprocess.CompletedProcess[str]:
        """Run a program of the Python environment, and check the exit code of the program."""
        variables = {
            name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
        }
        program = str(self.folder / "env" / "bin" / program_arguments[0])
        command: Sequence[str] = (program, *program_arguments[1:])
        result = subprocess.run(
            command, cwd=self.folder, env=variables, capture_output=True, text=True, check=False
        )
        assert result.returncode == exit_code, (
            f"{program_arguments}: {result.returncode}\n{result.stdout}\n{result.stderr}"
        )
        return result

    def install_wheel(self, extra_names: str = "") -> None:
        """Install the wheel with extras. Each package gets the version that the lock file states."""
        self.run(
            "python",
            "-m",
            "pip",
            "install",
            "--quiet",
            "-c",
            str(self._constraints),
            f"{self.wheel}{extra_names}",
        )

    def installed_megabytes(self) -> float:
        """Return the total size [MB] of all packages in the environment, except pip and setuptools."""
        where = self.run("python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
        packages = Path(where.stdout.strip())
        packaging_tools = {"pip", "setuptools", "pkg_resources"}
        files = (
            path
            for top in packages.iterdir()
            if top.name not in packaging_tools
            for path in [top, *top.rglob("*")]
        )
        return sum(path.lstat().st_blocks * 512 for path in files if path.is_file()) / 2**20


@pytest.fixture(scope="module")
def environment_without_extras(tmp_path_factory: pytest.TempPathFactory) -> WheelEnvironment:
    fresh_wheel_environment = WheelEnvironment(tmp_path_factory.mktemp("wheel"))
    fresh_wheel_environment.install_wheel()
    return fresh_wheel_environment


@pytest.fixture(scope="module")
def controller_environment(environment_without_extras: WheelEnvironment) -> WheelEnvironment:
    environment_without_extras.install_wheel("[controller]")
    return environment_without_extras


@pytest.fixture(scope="module")
def simulator_environment(controller_environment: WheelEnvironment) -> WheelEnvironment:
    controller_environment.install_wheel("[sim,view]")
    return controller_environment


def test_logs_and_clients_need_no_extra(environment_without_extras: WheelEnvironment) -> None:
    run = environment_without_extras.run
    where = run("python", "-c", "import handctl; print(handctl.__file__, handctl.connect)").stdout
    assert where.startswith(str(environment_without_extras.folder))
    assert run("handctl", "--version").stdout.strip() in environment_without_extras.wheel.name
    run("handctl", "log", "info", str(GOLDEN_LOG))
    run("handctl", "log", "export", str(GOLDEN_LOG), "--csv", "--output", "rows.csv")
    error_text = run("handctl", "run", "--hand", "jamia", "--bus", "local:x", exit_code=2).stderr
    assert error_text == "handctl: run needs numba: pip install 'handctl[controller]'\n"
    assert environment_without_extras.installed_megabytes() <= SIZE_WITHOUT_EXTRAS_MB


def test_a_controller_needs_one_extra(controller_environment: WheelEnvironment) -> None:
    replay_output = controller_environment.run(
        "handctl", "replay", "execute", str(GOLDEN_LOG)
    ).stdout
    assert "0 differ" in replay_output
    controller_environment.run("handctl", "report", str(GOLDEN_LOG), "--output", "report.html")
    controller_environment.run("handctl", "config", "check", "--hand", "jamia")
    expected = controller_environment.run("handctl", "demo", "--lockstep", exit_code=2).stderr
    assert expected == "handctl: demo needs mujoco: pip install 'handctl[sim]'\n"
    assert controller_environment.installed_megabytes() <= CONTROLLER_SIZE_MB


def test_the_demo_runs_and_its_log_becomes_a_recording(
    simulator_environment: WheelEnvironment,
) -> None:
    simulator_environment.run("handctl", "demo", "--lockstep", "--log", "run.mcap")
    simulator_environment.run("handctl", "view", "run.mcap", "--save", "run.rrd")
    assert (simulator_environment.folder / "run.rrd").stat().st_size > 100_000
