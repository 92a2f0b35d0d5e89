"""Re-execute all golden logs.

A golden log is a recorded run. When the run is executed again, the telemetry must equal the log to
the last bit. A code change for another hand must not change the telemetry of the hand in a golden
log.

Earlier defect: with the matrix kernels for AVX-512, the last bits of the telemetry differed from
those of other processors. Earlier defect: products were added in another order, which changed the
last bits of ``q_sigma`` in the golden log jamia11-grasp.
"""

from pathlib import Path

import pytest

from handctl.blas_kernels import can_run_portable_kernels
from handctl.cli.main import main

GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"
GOLDEN_LOG_NAMES = ("jamia-fault", "jamia-grasp", "jamia-lost", "jamia11-grasp")
"""Names of the golden logs."""


def test_the_folder_has_the_golden_logs_and_no_others() -> None:
    assert sorted(log.stem for log in GOLDEN_FOLDER.glob("*.mcap")) == sorted(GOLDEN_LOG_NAMES)


@pytest.mark.skipif(
    not can_run_portable_kernels(),
    reason="this processor cannot execute the matrix kernels of the golden logs",
)
@pytest.mark.parametrize("log_name", GOLDEN_LOG_NAMES)
def test_a_golden_log_is_re_executed_without_a_difference(log_name: str) -> None:
    assert main(["replay", "execute", str(GOLDEN_FOLDER / f"{log_name}.mcap")]) == 0
