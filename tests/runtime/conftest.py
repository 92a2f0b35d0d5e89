"""Where the processes of these tests work."""

import tempfile

import pytest

from tests.runtime.processes import LONG, SHORT


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder to work in, a short one for sockets."""
    with tempfile.TemporaryDirectory(prefix="h-") as short:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short)
        monkeypatch.chdir(tmp_path)
        (tmp_path / "short.toml").write_text(SHORT)
        (tmp_path / "long.toml").write_text(LONG)
        yield tmp_path
