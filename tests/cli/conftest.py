"""Give every test an empty working folder, and a second folder for Unix sockets."""

import shutil
import tempfile
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def work_folder(tmp_path, monkeypatch):
    """Change to an empty folder.

    Unix sockets are in the second folder, because the path of a Unix socket must be short.
    """
    sockets = Path(tempfile.mkdtemp(prefix="h-"))
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(sockets))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    shutil.rmtree(sockets, ignore_errors=True)
