"""Test the syncer, a process that makes Linux write a log file to the disk.

The log writer does not wait for the disk.
"""

import os
import select
from pathlib import Path

import psutil
import pytest

from handctl.log.write.disk_syncer import DiskSyncer


def test_a_separate_process_syncs_and_ends_with_its_parent(tmp_path: Path) -> None:
    children_before = set(psutil.Process().children())
    descriptor = os.open(tmp_path / "x", os.O_WRONLY | os.O_CREAT)
    disk_syncer = DiskSyncer()
    for _ in range(100):
        disk_syncer(descriptor)
    (child,) = set(psutil.Process().children()) - children_before
    assert descriptor in {open_file.fd for open_file in child.open_files()}
    assert not {0, 1, 2} & {open_file.fd for open_file in child.open_files()}
    os.close(disk_syncer._request_pipe)
    assert child.wait(10.0) is not None or not child.is_running()
    os.close(descriptor)


def test_an_error_comes_with_a_later_call() -> None:
    reading, writing = os.pipe()
    disk_syncer = DiskSyncer()
    disk_syncer(writing)
    assert select.select([disk_syncer._error_pipe], [], [], 10.0)[0]
    with pytest.raises(OSError, match="Invalid argument"):
        disk_syncer(writing)
    os.close(reading)
    os.close(writing)
