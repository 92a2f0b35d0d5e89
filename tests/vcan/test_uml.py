"""Test the program ``uml_guest``, which runs a command in a guest system.

The program always returns the exit status of the command. After the end of the program, none of its
processes still runs.
"""

import contextlib
import os
import tempfile
import time
from pathlib import Path

import pytest

from tests.vcan import uml_guest


@pytest.fixture
def _require_guest() -> None:
    kind, reason = uml_guest.vcan_access()
    if not kind:
        pytest.skip(reason)


def guest_processes(folder: str) -> list[int]:
    """Return the process ids of a running guest system.

    The function finds the processes by the name of the guest system's folder in their command
    lines.
    """
    pids = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if folder in path.read_bytes().decode(errors="replace"):
                pids.append(int(path.parent.name))
    return pids


@pytest.mark.parametrize("end_command", ["exit 7", "kill -SEGV $$"])
def test_a_kernel_with_vcan_needs_no_guest(
    monkeypatch: pytest.MonkeyPatch, end_command: str
) -> None:
    # with this change of the program, Linux seems to have vcan
    monkeypatch.setattr(uml_guest, "MAKE_INTERFACES_SCRIPT", "true\n")
    monkeypatch.setattr(uml_guest, "_namespace_command", lambda: ["env"])
    output: list[str] = []
    status = uml_guest.run_with_vcan(
        ["bash", "-c", f"echo $WORD; pwd; {end_command}"],
        {"WORD": "a  b"},
        print_line=output.append,
    )
    assert uml_guest.vcan_access() == ("native", "")
    assert output[:2] == ["a b", str(Path.cwd())]
    assert status == {"exit 7": 7, "kill -SEGV $$": 128 + 11}[end_command]


@pytest.mark.usefixtures("_require_guest")
def test_output_and_status_are_returned() -> None:
    output: list[str] = []
    script = "seq 20000; echo $WORD; ip -brief link show vcan1; printf 'no line feed'; exit 7"
    status = uml_guest.run_with_vcan(
        ["bash", "-c", script], {"WORD": "a 'quoted' $word"}, print_line=output.append
    )
    assert status == 7
    assert output[:20000] == [str(n) for n in range(1, 20001)]
    assert output[20000] == "a 'quoted' $word"
    assert output[20001].startswith("vcan1")
    assert output[20002:] == ["no line feed"]


@pytest.mark.usefixtures("_require_guest")
def test_a_crash_differs_from_an_exit() -> None:
    output: list[str] = []
    assert (
        uml_guest.run_with_vcan(["bash", "-c", "kill -SEGV $$"], print_line=output.append)
        == 128 + 11
    )


@pytest.mark.usefixtures("_require_guest")
def test_a_command_that_hangs_is_killed_with_all_its_guest(monkeypatch: pytest.MonkeyPatch) -> None:
    output: list[str] = []
    cores: list[set[int]] = []

    def record_line(line: str) -> None:
        output.append(line)
        for process in guest_processes(folder):
            # A process of the guest system can end between the listing of the processes and the
            # query of a process.
            with contextlib.suppress(ProcessLookupError):
                cores.append(os.sched_getaffinity(process))

    guest_start_s = time.monotonic()
    assert uml_guest.run_with_vcan(["true"]) == 0
    guest_run_duration_s = time.monotonic() - guest_start_s
    with tempfile.TemporaryDirectory() as folder:
        # the name of the folder marks the processes of the present test
        monkeypatch.setattr(tempfile, "tempdir", folder)
        script = "echo started; sleep 1000"
        status = uml_guest.run_with_vcan(
            ["bash", "-c", script],
            timeout_s=5.0 + 4.0 * guest_run_duration_s,
            print_line=record_line,
        )
        assert status == uml_guest.TIMED_OUT_STATUS
        assert output == ["started"]
        if uml_guest.vcan_access()[0] == "uml":
            assert {len(allowed) for allowed in cores} == {1}, (
                "kernel and program of a guest use one core"
            )
        deadline_s = time.monotonic() + 20.0
        while (
            guest_processes(folder) and time.monotonic() < deadline_s
        ):  # killed processes end after a delay
            time.sleep(0.1)
        assert not guest_processes(folder)
        assert not list(Path(folder).iterdir())
