"""What is taken for the loop is given back after it."""

import os
import sys

import pytest

from handctl.cli.main import main
from handctl.runtime.clock import give_back_priority, take_priority

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="real-time scheduling is Linux's")


def test_an_ordinary_process_again() -> None:
    granted = take_priority()
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    assert (policy == os.SCHED_FIFO) == granted.realtime
    give_back_priority()
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


def test_the_doctor_tries_and_gives_back() -> None:
    main(["doctor", "--json"])
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
