"""Write the golden logs anew, after an intended change of the controller.

``python -m tests.replay.golden_logs logs/golden``
"""

import sys
from pathlib import Path

from handctl.blas_kernels import configure_openblas


def main(log_folder: Path) -> None:
    """Write new golden logs into a folder, with the matrix kernels that handctl uses."""
    # The matrix kernels must be chosen before numpy is imported. With other matrix kernels, the last
    # bits of the logs differ from a re-execution.
    configure_openblas()
    from tests.replay.short_runs import write_golden_logs

    write_golden_logs(log_folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
