"""Test the simulator as a separate process.

The simulator process prints a line when it is ready, serves a bus, and writes a truth file. The
simulator process closes its files and sockets when it ends.
"""

import json
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from firmware_sim.__main__ import main
from firmware_sim.description.hand_description import SimulatorError, find_hand
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.truth_file import read_truth

ENABLE_PAYLOAD = bytes.fromhex("fffffffffffffffc")
READY_TIMEOUT_S = 60.0
StartSimulator = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def start_simulator(run_folder: Path) -> Iterator[StartSimulator]:
    """Yield a function that starts ``python -m firmware_sim`` and waits until the simulator prints that it is ready."""
    processes = []

    def launch_simulator(*simulator_options: str) -> "subprocess.Popen[str]":
        process = subprocess.Popen(
            [sys.executable, "-m", "firmware_sim", *simulator_options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        assert process.stdout
        assert select.select([process.stdout], [], [], READY_TIMEOUT_S)[0], "no ready line"
        assert process.stdout.readline().startswith("firmware_sim: ready"), process.communicate()[1]
        return process

    yield launch_simulator
    for process in processes:
        process.kill()
        process.communicate()


def test_ready_is_json_for_a_program(run_folder: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "firmware_sim",
        "--hand",
        "jamia",
        "--bus",
        "local:json",
        "--json",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout
        ready = json.loads(process.stdout.readline())["ready"]
        process.terminate()
        assert process.stdout.read() == ""
    assert (ready["hand"], ready["bus"]) == ("jamia", "local:json")


def frame_record(can_id: int, data: bytes, frame_flags: int = 0) -> bytes:
    return (
        can_id.to_bytes(4, "little")
        + bytes((len(data), frame_flags, 0, 0))
        + data
        + bytes(64 - len(data))
    )


def connect_to_bus(socket_path: Path) -> socket.socket:
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    link.settimeout(20.0)
    link.connect(str(socket_path))
    return link


def reply_to(bus_socket: socket.socket, can_id: int, data: bytes, flags: int = 0) -> bytes:
    """Send one frame to the simulator, and return the record of the simulator's reply."""
    bus_socket.sendall(frame_record(can_id, data, flags))
    answer = bus_socket.recv(72, socket.MSG_WAITALL)
    assert len(answer) == 72
    return answer


@pytest.mark.parametrize("signal_number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_the_simulator_with_complete_truth(
    start_simulator: StartSimulator, run_folder: Path, signal_number: signal.Signals
) -> None:
    process = start_simulator(
        "--hand", "jamia", "--bus", "local:t", "--scene", "sphere", "--seed", "4"
    )
    link = connect_to_bus(run_folder / "t.bus")
    answer = reply_to(link, 3, ENABLE_PAYLOAD)
    assert (answer[0], answer[4], answer[5], answer[8]) == (0x13, 8, 0, 0x13)
    assert reply_to(link, 3, ENABLE_PAYLOAD, flags=5)[5] == 5, (
        "the answer to an FD frame is an FD frame"
    )
    time.sleep(0.3)
    before_ns = time.monotonic_ns()
    process.send_signal(signal_number)
    _, words = process.communicate(timeout=20.0)
    assert process.returncode == 0
    assert "firmware_sim: ended" in words
    assert not (run_folder / "t.bus").exists()
    truth = read_truth(run_folder / "local_t.truth")
    assert truth.header["clock"] == "monotonic"
    assert (truth.header["scene"], truth.header["seed"]) == ("sphere", 4)
    assert truth.header["foreign_frames"] == 0, "the summary of the run is in the header"
    assert len(truth.t_ns) > 50
    assert (
        set((truth.t_ns[1:] - truth.t_ns[:-1]).tolist()) == {1_000_000} or truth.header["slips"] > 0
    )
    assert abs(int(truth.t_ns[-1]) - before_ns) < 2e9, "the times are of the clock of the machine"


def test_slowed_time_slows_the_plant_and_its_clock(
    start_simulator: StartSimulator, run_folder: Path
) -> None:
    process = start_simulator("--hand", "jamia", "--bus", "local:slow", "--time-scale", "0.05")
    start_time_ns = time.monotonic_ns()
    time.sleep(1.0)
    process.terminate()
    process.communicate(timeout=20.0)
    wall_ns = time.monotonic_ns() - start_time_ns
    truth = read_truth(run_folder / "local_slow.truth")
    assert 20 <= len(truth.t_ns) <= 0.05 * wall_ns / 1e6 + 100
    assert abs(int(truth.t_ns[-1]) - 0.05 * time.monotonic_ns()) < 0.05 * 5e9


def test_a_hub_alone_and_a_simulator_that_joins_it(
    start_simulator: StartSimulator, run_folder: Path
) -> None:
    hub = start_simulator("bus", "shared")
    hand = start_simulator("--hand", "jamia", "--bus", "main=join:shared")
    link = connect_to_bus(run_folder / "shared.bus")
    assert reply_to(link, 1, ENABLE_PAYLOAD)[0] == 0x11
    hand.terminate()
    hand.communicate(timeout=20.0)
    hub.terminate()
    hub.communicate(timeout=20.0)
    assert (hand.returncode, hub.returncode) == (0, 0)
    assert (run_folder / "local_shared.truth").exists()
    assert not (run_folder / "shared.bus").exists()


def test_a_second_simulator_on_the_same_bus_is_refused(
    start_simulator: StartSimulator, run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start_simulator("bus", "taken")
    assert main(["--hand", "jamia", "--bus", "local:taken"]) == 2
    assert "already served" in capsys.readouterr().err
    assert not (run_folder / "local_taken.truth").exists()


HAND_OPTIONS = ["--hand", "jamia", "--bus", "local:x"]
ESCAPE_SEQUENCES = "\x1b[2J\x1b]0;mine\x07\x9b\u202e\n"
REFUSED_ARGUMENTS = {
    "end of options": ["--hand", "jamia", "--bus=--"],
    "end of options, drive": ["drive", "mit", "--ids=--", "--bus", "local:x"],
    "end of options, bus": ["bus", "--wire=--", "x"],
    "NUL": ["--hand", "a\0b", "--bus", "local:x"],
    "hand": ["--hand", ESCAPE_SEQUENCES, "--bus", "local:x"],
    "bus": ["--hand", "jamia", "--bus", f"local:a/{ESCAPE_SEQUENCES}"],
    "scene": [*HAND_OPTIONS, "--scene", ESCAPE_SEQUENCES],
    "scene file": [*HAND_OPTIONS, "--scene", "odd.toml"],
    "perturb": [*HAND_OPTIONS, "--perturb", ESCAPE_SEQUENCES],
    "wire": [*HAND_OPTIONS, "--wire", f"{ESCAPE_SEQUENCES}=3"],
    "unknown": [*HAND_OPTIONS, f"--{ESCAPE_SEQUENCES}"],
    "long": [*HAND_OPTIONS, "--scene", "x" * 5000],
    "number": [*HAND_OPTIONS, "--seed", "9" * 5000],
    "ids": ["drive", "mit", "--ids", "9" * 5000, "--bus", "local:x"],
    "hand file": ["--hand", "./odd.toml", "--bus", "local:x"],
}


@pytest.mark.parametrize("case_name", REFUSED_ARGUMENTS)
def test_wrong_arguments_give_one_printable_line(
    run_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    case_name: str,
) -> None:
    monkeypatch.chdir(run_folder)
    (run_folder / "odd.toml").write_text('name = "x"\n[object]\nshape = "\\u001b[2J\\n"\n')
    assert main(REFUSED_ARGUMENTS[case_name]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("firmware_sim: ")
    assert err.count("\n") == 1
    assert err[:-1].isprintable()
    assert len(err) < 530


INVALID_HANDS = {
    "a number without end": ("schema = 2", "schema = " + "9" * 5000),
    "no spool": ("spool_radius_m = ", "spool_radius_m = 0 # "),
    "too few masses": ("link_mass_kg = ", "link_mass_kg = [0.1] # "),
    "no such tendon": ("tendons = ", "tendons = [3] # "),
    "no number": ("stiffness_N_per_m = ", 'stiffness_N_per_m = "\\u001b" # '),
}


@pytest.mark.parametrize("case_name", INVALID_HANDS)
def test_impossible_hands_are_refused_by_both_simulators(
    run_folder: Path, capsys: pytest.CaptureFixture[str], case_name: str
) -> None:
    path = run_folder / "odd.toml"
    old_text, new_text = INVALID_HANDS[case_name]
    path.write_text(find_hand("jamia").read_text().replace(old_text, new_text))
    assert main(["--hand", str(path), "--bus", "local:x", "--dry-run"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    with pytest.raises(SimulatorError):
        LockstepHand(str(path))


def test_the_truth_file_never_overwrites_a_log(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = run_folder / "run.mcap"
    log.write_bytes(b"a run")
    assert main([*HAND_OPTIONS, "--truth", str(log), "--scene", "none"]) == 2
    assert "is a log; expected another name" in capsys.readouterr().err
    assert log.read_bytes() == b"a run"


@pytest.mark.parametrize(
    "simulator_options",
    [
        [],
        ["--hand", "nobody", "--bus", "local:x"],
        ["--hand", "jamia"],
        [*HAND_OPTIONS, "--bogus"],
        [*HAND_OPTIONS, "--scene", "volcano"],
        [*HAND_OPTIONS, "--perturb", "colour=2"],
        [*HAND_OPTIONS, "--perturb", "mass=heavy"],
        [*HAND_OPTIONS, "--time-scale", "0"],
        [*HAND_OPTIONS, "--time-scale", "1e-300"],
        [*HAND_OPTIONS, "--time-scale", "nan"],
        [*HAND_OPTIONS, "--seed", "x"],
        [*HAND_OPTIONS, "--truth", "/no/such/folder/truth"],
        ["--hand", "jamia", "--bus", "wire:x"],
        ["bus"],
        ["bus", "a/b"],
    ],
)
def test_wrong_arguments_get_one_line_and_exit_code_2(
    simulator_options: list[str], run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(simulator_options) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("firmware_sim: ")
    assert captured.err.count("\n") == 1
    assert not (run_folder / "x.bus").exists()


def test_help_names_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    for word in (
        "--hand",
        "--bus",
        "--scene",
        "--seed",
        "--homed",
        "--time-scale",
        "--truth",
        "--perturb",
        "stiffness",
        "join:",
    ):
        assert word in text


def test_the_simulator_is_one_process(start_simulator: StartSimulator) -> None:
    process = start_simulator("--hand", "jamia", "--bus", "local:alone")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    if not children.exists():
        pytest.skip("needs /proc")
    assert children.read_text() == ""
