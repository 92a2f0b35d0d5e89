"""Test Eq. 10 exactly as the paper prints it: with this form, tests of the dynamic model must fail."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY_ROOT = Path(__file__).parents[2]
TEST_SELECTION = "(pinocchio_built_by_hand and gravity_m_s23) or mass_matrix_is or coriolis or energy_is or sums_are"
TESTS_OF_EQUATION_10 = {
    "test_agrees_with_pinocchio_built_by_hand",
    "test_coriolis_forces_do_no_work_of_their_own",
    "test_energy_is_conserved",
    "test_sums_are_sums_of_their_parts",
}


def run_with_equation(equation_form: str) -> tuple[set[str], str]:
    """Run the tests of the dynamic model with the printed or with the corrected Eq. 10.

    Return the names of the failed tests, and the last line of the output of pytest.
    """
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "equation_10_plugin",
        "-p",
        "no:xdist",
        "-q",
        "-rf",
        "--tb=no",
    ]
    run = subprocess.run(
        [
            *command,
            "-k",
            f"jamia and not jamia_bench and not jamia11 and ({TEST_SELECTION})",
            "tests/hand/test_dynamics.py",
        ],
        cwd=REPOSITORY_ROOT,
        env={**os.environ, "HANDCTL_EQ10": equation_form, "PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return set(
        re.findall(r"^FAILED \S+::(\w+)", run.stdout, re.MULTILINE)
    ), run.stdout.strip().splitlines()[-1]


@pytest.fixture(scope="module")
def outcomes_of_both_equations() -> dict[str, tuple[set[str], str]]:
    return {
        equation_form: run_with_equation(equation_form)
        for equation_form in ("printed", "corrected")
    }


def test_the_printed_equation_fails_the_model_s_tests(
    outcomes_of_both_equations: dict[str, tuple[set[str], str]],
) -> None:
    failed_tests, last_line = outcomes_of_both_equations["printed"]
    assert failed_tests >= TESTS_OF_EQUATION_10, last_line


def test_the_corrected_equation_passes_them(
    outcomes_of_both_equations: dict[str, tuple[set[str], str]],
) -> None:
    failed_tests, last_line = outcomes_of_both_equations["corrected"]
    assert not failed_tests
    assert "passed" in last_line
