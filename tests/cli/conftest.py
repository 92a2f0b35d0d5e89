"""Working folder for every test: an empty folder, and short socket paths."""

import shutil
import tempfile
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """Work in an empty folder, with sockets in a folder that has a short path."""
    sockets = Path(tempfile.mkdtemp(prefix="h-"))
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(sockets))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    shutil.rmtree(sockets, ignore_errors=True)
