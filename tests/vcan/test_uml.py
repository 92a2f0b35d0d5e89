"""The runner itself: whatever happens to the command must come back as a status, and nothing may stay behind."""

import contextlib
import os
import tempfile
import time
from pathlib import Path

import pytest

from tests.vcan import uml


@pytest.fixture
def _possible() -> None:
    kind, why_not = uml.means()
    if not kind:
        pytest.skip(why_not)


def processes_of(folder: str) -> list[int]:
    """Processes whose command lines name a folder: those of a guest that is still alive."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if folder in path.read_bytes().decode(errors="replace"):
                found.append(int(path.parent.name))
    return found


@pytest.mark.parametrize("end", ["exit 7", "kill -SEGV $$"])
def test_a_kernel_with_vcan_needs_no_guest(monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    monkeypatch.setattr(uml, "INTERFACES", "true\n")  # as if they could be made here, and without a namespace's rights
    monkeypatch.setattr(uml, "_namespace", lambda: ["env"])
    said: list[str] = []
    status = uml.run(["bash", "-c", f"echo $WORD; pwd; {end}"], {"WORD": "a  b"}, say=said.append)
    assert uml.means() == ("native", "")
    assert said[:2] == ["a b", str(Path.cwd())]
    assert status == {"exit 7": 7, "kill -SEGV $$": 128 + 11}[end]


@pytest.mark.usefixtures("_possible")
def test_output_and_status_come_back() -> None:
    said: list[str] = []
    script = "seq 20000; echo $WORD; ip -brief link show vcan1; printf 'no line feed'; exit 7"
    status = uml.run(["bash", "-c", script], {"WORD": "a 'quoted' $word"}, say=said.append)
    assert status == 7
    assert said[:20000] == [str(n) for n in range(1, 20001)]
    assert said[20000] == "a 'quoted' $word"
    assert said[20001].startswith("vcan1")
    assert said[20002:] == ["no line feed"]


@pytest.mark.usefixtures("_possible")
def test_a_crash_is_told_from_an_exit() -> None:
    said: list[str] = []
    assert uml.run(["bash", "-c", "kill -SEGV $$"], say=said.append) == 128 + 11


@pytest.mark.usefixtures("_possible")
def test_a_command_that_hangs_is_killed_with_all_its_guest(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    cores: list[set[int]] = []

    def heard(line: str) -> None:
        said.append(line)
        cores.extend(os.sched_getaffinity(process) for process in processes_of(folder))

    begun = time.monotonic()
    assert uml.run(["true"]) == 0
    started_s = time.monotonic() - begun
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setattr(tempfile, "tempdir", folder)  # so that the processes of this run can be told from others
        status = uml.run(["bash", "-c", "echo started; sleep 1000"], timeout_s=5.0 + 4.0 * started_s, say=heard)
        assert status == uml.TIMED_OUT
        assert said == ["started"]
        if uml.means()[0] == "uml":
            assert {len(allowed) for allowed in cores} == {1}, "kernel and program of a guest on one core"
        end = time.monotonic() + 20.0
        while processes_of(folder) and time.monotonic() < end:  # the kernel takes a moment to bury the killed
            time.sleep(0.1)
        assert not processes_of(folder)
        assert not list(Path(folder).iterdir())
