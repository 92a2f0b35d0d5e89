"""A developer who adds a fault writes only a declaration and a detector.

The test adds an example fault to a copy of the package handctl.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent, indent

import pytest

REPOSITORY = Path(__file__).parents[2]
ADDING_A_FAULT_PAGE = (REPOSITORY / "docs" / "how-to" / "adding-a-fault.md").read_text(
    encoding="utf-8"
)
ADDED_FAULT_SCRIPT = """
import json
from handctl.controller.tick import _fault_event
from handctl.safety.faults.markdown import catalogue_markdown, fault_table_markdown
from tests.safety.synthetic_monitor import SyntheticMonitor, synthetic_limits

monitor = SyntheticMonitor(synthetic_limits(2))
verdicts = [monitor.judge({"measured_tension": {1: tension}}) for tension in (100.0, 100.5, 100.5)]
print(json.dumps({
    "table": [line for line in fault_table_markdown().splitlines() if line.startswith("| T10 ")],
    "page": [line for line in catalogue_markdown().splitlines() if line.startswith("| T10 ")],
    "actions": [int(verdict.action) for verdict in verdicts],
    "events": [[list(_fault_event(one)) for one in verdict.findings if one.fault.id == "T10"] for verdict in verdicts],
}))
"""


def add_example_fault(package_folder: Path) -> None:
    """Copy the package handctl, and add the example fault of the how-to page to the copy."""
    declaration, detector = re.findall(r"```python\n(.*?) *```", ADDING_A_FAULT_PAGE, re.DOTALL)
    kind = package_folder / "safety" / "faults" / "tendon.py"
    with kind.open("a", encoding="utf-8") as file:
        file.write("\n" + dedent(" " * 4 + declaration.lstrip()))
    path = package_folder / "core" / "detectors" / "tendon_faults.py"
    source = path.read_text(encoding="utf-8")
    preceding_line = "        tension = monitored_tension(x, c, n, True)\n"
    assert preceding_line in source
    lines = indent(dedent(" " * 4 + detector.lstrip()), " " * 8)
    source = source.replace(preceding_line, preceding_line + lines, 1)
    source = source.replace(
        "from handctl.safety.faults.tendon import (\n",
        "from handctl.safety.faults.tendon import (\n    HEAVY_N,\n    T10_HEAVY_LOAD,\n",
    )
    path.write_text(source, encoding="utf-8")


@pytest.mark.parametrize("numba_disabled", ["1", pytest.param("0", marks=pytest.mark.nightly)])
def test_a_fault_is_declared_once_and_found_by_one_detector(
    tmp_path: Path, numba_disabled: str
) -> None:
    package = tmp_path / "handctl"
    shutil.copytree(
        REPOSITORY / "src" / "handctl", package, ignore=shutil.ignore_patterns("__pycache__")
    )
    add_example_fault(package)
    path = os.pathsep.join(map(str, (tmp_path, REPOSITORY)))
    added_variables = {
        "PYTHONPATH": path,
        "NUMBA_DISABLE_JIT": numba_disabled,
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }
    words = [sys.executable, "-W", "ignore", "-c", ADDED_FAULT_SCRIPT]
    done = subprocess.run(
        words,
        env=os.environ | added_variables,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    result = json.loads(done.stdout)
    assert result["table"] == [
        "| T10 | a heavy load | The tension is above 100 N | WARN | by itself |"
    ]
    protocols = " | ".join(["detected"] * 5)
    assert result["page"] == [
        f"| T10 | heavy load | T10 WARN | {protocols} | 4 ms, 2 ticks | campaign |"
    ]
    assert result["actions"] == [0, 1, 1]
    text = "T10 a heavy load: t1 (100.5): WARN"
    assert result["events"] == [[], [["warn", "fault", "t1", text]], []]
