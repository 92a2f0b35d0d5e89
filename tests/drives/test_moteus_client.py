"""The Python client of the vendor commands the simulated moteus on a local bus.

The test needs the dependency group ``extra``.
"""

import pytest

from tests.drives.bench_process import run_simulated_drives

pytest.importorskip("moteus", reason="the group extra has it: make bench")
pytestmark = pytest.mark.realtime
LOCAL_BUS_NAME = "moteus"


@pytest.mark.parametrize("node", [2, 17], ids=["reply of 11 bits", "reply of 29 bits"])
def test_moteus_library_controls_the_simulated_drive(node: int) -> None:
    from tests.drives.moteus_client import use_moteus

    with run_simulated_drives(f"local:{LOCAL_BUS_NAME}", "moteus", "--ids", f"{node}"):
        use_moteus("local", LOCAL_BUS_NAME, node)
