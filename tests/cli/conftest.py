"""Fixture with the working folder of every test: an empty folder. Sockets have short paths."""

import shutil
import tempfile
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def work_folder(tmp_path, monkeypatch):
    """Change to an empty folder. Sockets are in another folder with a short path."""
    sockets = Path(tempfile.mkdtemp(prefix="h-"))
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(sockets))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    shutil.rmtree(sockets, ignore_errors=True)
