"""Test the choice of the BLAS kernels.

The last bits of the results of a run depend on the BLAS kernels.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from handctl import blas_kernels
from handctl.blas_kernels import (
    OPENBLAS_CORE_VARIABLE,
    OPENBLAS_THREADS_VARIABLE,
    PORTABLE_MATRIX_KERNELS,
    cpu_features,
)
from handctl.log.read.reader import RunLog

PROJECT_FOLDER = Path(__file__).resolve().parent.parent.parent
CPUINFO_WITH_AVX2 = "processor : 0\nflags\t\t: fpu fma avx avx2\nprocessor : 1\n"
PROGRAM_THAT_PRINTS_KERNELS = (
    "import os, sys; import handctl.cli.main as cli; print('numpy' in sys.modules); "
    f"cli.configure_openblas(); print(os.environ.get('{OPENBLAS_CORE_VARIABLE}'))"
)


def test_features_are_those_of_the_first_processor() -> None:
    assert cpu_features(CPUINFO_WITH_AVX2.splitlines(keepends=True)) == {
        "fpu",
        "fma",
        "avx",
        "avx2",
    }
    assert cpu_features(["processor : 0\n", "Features : fp asimd\n"]) == set()


@pytest.mark.parametrize(
    ("description", "preset_kernels", "kernels"),
    [
        (CPUINFO_WITH_AVX2, None, PORTABLE_MATRIX_KERNELS),
        (CPUINFO_WITH_AVX2, "Zen", "Zen"),
        ("flags : fpu avx\n", None, None),
        ("Features : fp asimd\n", None, None),
        (None, None, None),
    ],
)
def test_kernels_are_chosen_where_the_processor_can_execute_them(
    description: str | None,
    preset_kernels: str | None,
    kernels: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last test case is a system without the file ``/proc/cpuinfo``."""
    path = tmp_path / "cpuinfo"
    if description is not None:
        path.write_text(description)
    monkeypatch.setattr(blas_kernels, "CPU_INFO_PATH", path)
    if preset_kernels is None:
        monkeypatch.delenv(OPENBLAS_CORE_VARIABLE, raising=False)
    else:
        monkeypatch.setenv(OPENBLAS_CORE_VARIABLE, preset_kernels)
    blas_kernels.configure_openblas()
    assert os.environ.get(OPENBLAS_CORE_VARIABLE) == kernels


@pytest.mark.parametrize(("preset_count", "count"), [(None, "1"), ("2", "2")])
def test_openblas_has_a_single_thread_unless_the_user_has_chosen_more(
    preset_count: str | None, count: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect: idle threads of OpenBLAS took most of the processor time of `config check`."""
    if preset_count is None:
        monkeypatch.delenv(OPENBLAS_THREADS_VARIABLE, raising=False)
    else:
        monkeypatch.setenv(OPENBLAS_THREADS_VARIABLE, preset_count)
    blas_kernels.configure_openblas()
    assert os.environ[OPENBLAS_THREADS_VARIABLE] == count


def test_command_line_chooses_the_kernels_before_numpy_is_imported() -> None:
    environment = {
        name: value for name, value in os.environ.items() if name != OPENBLAS_CORE_VARIABLE
    }
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM_THAT_PRINTS_KERNELS],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    numpy_imported, kernels = result.stdout.split()
    assert numpy_imported == "False"
    assert kernels == (os.environ.get(OPENBLAS_CORE_VARIABLE) or "None")


@pytest.mark.skipif(
    not blas_kernels.can_run_portable_kernels(), reason="this processor cannot execute the kernels"
)
@pytest.mark.parametrize("log_name", ["jamia-grasp", "jamia11-grasp"])
def test_golden_log_repeats_to_the_bit_in_a_new_process(log_name: str) -> None:
    """A new process does not inherit the BLAS kernels of the test process, but chooses the same kernels."""
    environment = {
        name: value for name, value in os.environ.items() if name != OPENBLAS_CORE_VARIABLE
    }
    log = Path(__file__).parents[2] / "logs" / "golden" / f"{log_name}.mcap"
    result = subprocess.run(
        [sys.executable, "-m", "handctl", "replay", "execute", str(log)],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_new_golden_logs_equal_the_golden_logs(tmp_path: Path) -> None:
    """`make golden` chooses the same matrix kernels as handctl.

    Otherwise the last bits of new golden logs would differ from their re-execution.
    """
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS_")
    }
    subprocess.run(
        [sys.executable, "-m", "tests.replay.golden_logs", str(tmp_path)],
        env=environment, cwd=PROJECT_FOLDER, check=True,
    )  # fmt: skip
    for golden_log in sorted((PROJECT_FOLDER / "logs" / "golden").glob("*.mcap")):
        with RunLog(golden_log) as log, RunLog(tmp_path / golden_log.name) as new_log:
            assert new_log.state_hash.tolist() == log.state_hash.tolist(), golden_log.name
