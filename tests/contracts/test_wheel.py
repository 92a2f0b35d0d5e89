"""The wheel, installed into a fresh environment outside the repository, runs the demo.

The packages of the controller are installed before the extras. The test of the controller therefore
cannot use a package of an extra.
"""

import os
import re
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CONTROLLER_MB = 620
"""Largest size of the packages that a controller needs [MB].

numba with LLVM has 210, scipy 145, numpy 75, and the dependencies of the package control have 105.
"""

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1800)]


class Fresh:
    """A Python environment with the wheel, without access to the repository.

    Args:
        folder: folder in which the environment is made and its programs run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.wheel = self._build()
        venv.create(folder / "env", with_pip=True)
        self._constraints = folder / "constraints.txt"
        pins = re.findall(
            r"^[a-z0-9][^\n]*==[^\n\\]*", (ROOT / "requirements-dev.lock").read_text(), re.MULTILINE
        )
        self._constraints.write_text("\n".join(pins))

    def _build(self) -> Path:
        dist = self.folder / "dist"
        command = [
            sys.executable,
            "-m",
            "hatchling",
            "build",
            "--target",
            "wheel",
            "--directory",
            str(dist),
        ]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
        (wheel,) = dist.glob("*.whl")
        return wheel

    def run(self, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment and check its exit code."""
        variables = {
            name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
        }
        program = str(self.folder / "env" / "bin" / words[0])
        command: Sequence[str] = (program, *words[1:])
        ran = subprocess.run(
            command, cwd=self.folder, env=variables, capture_output=True, text=True, check=False
        )
        assert ran.returncode == code, f"{words}: {ran.returncode}\n{ran.stdout}\n{ran.stderr}"
        return ran

    def install(self, extras: str = "") -> None:
        """Install the wheel with extras, in the versions of the lock file."""
        self.run(
            "python",
            "-m",
            "pip",
            "install",
            "--quiet",
            "-c",
            str(self._constraints),
            f"{self.wheel}{extras}",
        )

    def megabytes(self) -> float:
        """Return the size of the installed packages without pip and setuptools [MB]."""
        where = self.run("python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
        packages = Path(where.stdout.strip())
        tools = {"pip", "setuptools", "pkg_resources"}
        files = (
            path
            for top in packages.iterdir()
            if top.name not in tools
            for path in [top, *top.rglob("*")]
        )
        return sum(path.lstat().st_blocks * 512 for path in files if path.is_file()) / 2**20


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Fresh:
    fresh = Fresh(tmp_path_factory.mktemp("wheel"))
    fresh.install()
    return fresh


@pytest.fixture(scope="module")
def simulator(controller: Fresh) -> Fresh:
    controller.install("[sim,view]")
    return controller


def test_a_controller_needs_no_extra(controller: Fresh) -> None:
    where = controller.run("python", "-c", "import handctl; print(handctl.__file__)").stdout
    assert where.startswith(str(controller.folder))
    assert controller.run("handctl", "--version").stdout.strip() in controller.wheel.name
    log = ROOT / "logs" / "golden" / "jamia-grasp.mcap"
    assert "0 differ" in controller.run("handctl", "replay", "execute", str(log)).stdout
    controller.run("handctl", "report", str(log), "--output", "report.html")
    controller.run("handctl", "config", "check", "--hand", "jamia")
    wanted = controller.run("handctl", "demo", "--lockstep", code=2).stderr
    assert wanted == "handctl: demo needs mujoco: pip install 'handctl[sim]'\n"
    assert controller.megabytes() <= CONTROLLER_MB


def test_the_demo_runs_and_its_log_becomes_a_recording(simulator: Fresh) -> None:
    simulator.run("handctl", "demo", "--lockstep", "--log", "run.mcap")
    simulator.run("handctl", "view", "run.mcap", "--save", "run.rrd")
    assert (simulator.folder / "run.rrd").stat().st_size > 100_000
