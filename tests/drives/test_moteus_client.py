"""The vendor's client commands the simulated moteus on a local bus.

The test needs the dependency group ``extra``.
"""

import pytest

from tests.drives.bench_process import drives

pytest.importorskip("moteus", reason="the group extra has it: make bench")
pytestmark = pytest.mark.realtime
BUS = "moteus"


@pytest.mark.parametrize("node", [2, 17], ids=["reply of 11 bits", "reply of 29 bits"])
def test_moteus_library_controls_the_simulated_drive(node: int) -> None:
    from tests.drives.moteus_client import use_moteus

    with drives(f"local:{BUS}", "moteus", "--ids", f"{node}"):
        use_moteus("local", BUS, node)
