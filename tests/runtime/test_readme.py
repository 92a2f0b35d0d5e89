"""Test that the Python program in the README works without changes.

The program uses the simulated hand that the README starts.
"""

import re
import select
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.runtime.processes import READY_TIMEOUT_S, modes_of_complete_log, start_handctl

README_TEXT = (Path(__file__).parents[2] / "README.md").read_text()
CPU_LOAD_PROGRAM = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"


def readme_blocks(language: str, *required_texts: str) -> list[str]:
    """Return the README's code blocks in a given language that contain all given texts."""
    texts = re.findall(rf"^```{language}\n(.*?)^```$", README_TEXT, re.MULTILINE | re.DOTALL)
    return [block for block in texts if all(text in block for text in required_texts)]


@pytest.mark.realtime
@pytest.mark.alone
@pytest.mark.parametrize("busy_processes", [2])
def test_the_program_in_the_readme_runs_beside_busy_ones(
    work_folder, started_processes, busy_processes
):
    (program,) = readme_blocks("python", "handctl.connect")
    (commands,) = readme_blocks("", "handctl sim", "--bus local:lab")
    (line,) = [line for line in commands.splitlines() if line.startswith("handctl sim")]
    simulator = start_handctl(*shlex.split(line.split("#")[0])[1:])
    started_processes.append(simulator)
    started_processes.extend(
        subprocess.Popen(
            [sys.executable, "-c", CPU_LOAD_PROGRAM], stdout=subprocess.PIPE, text=True
        )
        for _ in range(busy_processes)
    )
    (work_folder / "example.py").write_text(program)
    wait_until_ready(simulator)
    result = subprocess.run(
        [sys.executable, "example.py"], capture_output=True, text=True, timeout=300.0
    )
    assert result.returncode == 0, result.stderr[-2000:]
    forces, log = result.stdout.splitlines()
    assert len(forces.strip("[]").split(",")) == 4
    modes_of_complete_log(work_folder / log)


def wait_until_ready(simulator: "subprocess.Popen[str]") -> None:
    """Wait until a simulator serves its bus."""
    assert simulator.stdout
    assert select.select([simulator.stdout], [], [], READY_TIMEOUT_S)[0], "no ready line"
    simulator.stdout.readline()
