"""Firmware does not wait for a desktop: real-time priority for the simulator, where the system grants it."""

import os
import sys

LEVEL = 50
"""Below a controller's 60, so that the simulated side never keeps the host from its deadline."""


def take_priority() -> bool:
    """Ask for SCHED_FIFO; whether it was granted."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LEVEL))
    except OSError:
        return False
    return True
