"""What the frames of a tick amount to."""

from typing import NamedTuple

from handctl.controller.monitor.motors import Motors
from handctl.core.estimation.estimator import Estimate, Measured
from handctl.drives.frame import Frame
from handctl.safety.signals import Named


class Received(NamedTuple):
    """One tick's news.

    Attributes:
        motors: what the drives say. counts_before: feedback frames of each up to the last tick.
        measured: new measurements. estimate: of this instant.
        foreign: identifiers that only this host may send. strange: frames that are nobody's.
        jumped: positions that cannot be, and were dropped.
    """

    motors: Motors
    counts_before: tuple[int, ...]
    measured: Measured
    estimate: Estimate
    foreign: tuple[str, ...]
    strange: tuple[Frame, ...]
    jumped: Named
