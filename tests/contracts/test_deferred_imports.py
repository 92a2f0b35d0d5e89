"""Test deferred imports: handctl imports a library module only when it first uses a function of the module."""

import subprocess
import sys
from pathlib import Path

import pytest

from handctl.core.deferred_imports import import_without_package_init


@pytest.mark.parametrize("first_statement", ["", "import control\n"])
def test_a_user_s_own_control_py_does_not_hide_the_package(
    tmp_path: Path, first_statement: str
) -> None:
    (tmp_path / "control.py").write_text("MINE = True\n")
    program = tmp_path / "program.py"
    program.write_text(
        f"{first_statement}import handctl.core.gains.riccati\nimport control\n"
        "assert control.MINE\nprint(handctl.core.gains.riccati.solve_covariance.__module__)\n"
    )
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, check=False
    )
    assert done.stdout == "handctl.core.gains.riccati\n", done.stderr


def test_a_package_that_is_not_installed_is_named() -> None:
    with pytest.raises(ModuleNotFoundError, match="'no_such_package'"):
        import_without_package_init("no_such_package.part")
