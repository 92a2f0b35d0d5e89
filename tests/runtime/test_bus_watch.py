"""``handctl bus watch`` reads every drive and every load cell of a hand.

While ``handctl bus watch`` runs, no motor makes torque.
"""

import json
import math

import pytest

from firmware_sim.lockstep_hand import LockstepHand
from handctl.cli.main import main
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import Frame
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.hand.hand_loading import load_hand
from handctl.runtime.diagnostics.bus_watch import BusWatch, SensorReading, is_saturated
from handctl.runtime.mailbox import Mailbox
from tests.drives.bench_process import run_simulated_drives
from tests.drives.protocol_bench import hand_file, move_to_second_bus
from tests.drives.test_cia404 import hand_with_amplifiers

PERIOD_NS = 10_000_000
TURNED_ANGLE_RAD = -0.5
"""Angle to which an operator turns the first spool [rad].

A negative angle makes the tendon of the first spool slack.
"""


class SimulatedBuses:
    """The buses and the clock of a simulated hand in virtual time."""

    def __init__(self, hand_path):
        self.hand = load_hand(str(hand_path))
        self.rig = LockstepHand(str(hand_path), seed=3, period_ns=PERIOD_NS, homed=True)
        self.motors = list(self.rig.world.plant.motors.values())
        self.t_ns = 0
        self.pending_host_frames, self.incoming = [], []
        self.max_torque_N_m = 0.0

    def wait(self, tick_index):
        """Advance the virtual time to the tick ``tick_index``, and let the drives reply to the frames of the last tick.

        Return 0, because the simulated clock misses no ticks.
        """
        self.t_ns = tick_index * PERIOD_NS
        self.incoming = [
            Frame(*frame)
            for frame in self.rig.step(max(0, tick_index - 1) * PERIOD_NS, self.pending_host_frames)
        ]
        self.pending_host_frames = []
        self.max_torque_N_m = max(
            self.max_torque_N_m, *(abs(motor.servo.torque) for motor in self.motors)
        )
        return 0

    def now_ns(self):
        return self.t_ns

    def buses(self):
        return [SimulatedBus(self, index) for index in range(len(self.hand.bus))]


class SimulatedBus:
    """One bus of the simulated hand."""

    def __init__(self, buses, bus_index):
        self.buses, self.index = buses, bus_index

    def drain(self):
        return [frame for frame in self.buses.incoming if frame.bus == self.index]

    def send(self, frames):
        self.buses.pending_host_frames += frames

    def take_events(self):
        return []


def make_bus_watch(hand_path):
    simulated_buses = SimulatedBuses(hand_path)
    watch = BusWatch(
        make_drives(simulated_buses.hand),
        make_sensors(simulated_buses.hand),
        simulated_buses.buses(),
        simulated_buses,
        PERIOD_NS,
    )
    return simulated_buses, watch


@pytest.mark.parametrize("protocol", PROTOCOL_TRAITS)
def test_every_protocol_is_read_without_torque(protocol, tmp_path):
    simulated_buses, watch = make_bus_watch(hand_file(tmp_path, [protocol]))
    for _ in range(120):
        watch.run_tick()
    simulated_buses.motors[0].theta = TURNED_ANGLE_RAD
    for _ in range(30):
        watch.run_tick()
    assert watch.silent_motors() == []
    assert {state.phase for state in watch.states} == {DrivePhase.READY}
    assert [state.position for state in watch.states] == pytest.approx(
        [m.theta for m in simulated_buses.motors], abs=0.01
    )
    assert watch.states[0].position == pytest.approx(TURNED_ANGLE_RAD, abs=0.01)
    assert (
        all(not math.isnan(state.temperature) for state in watch.states) or protocol == "cia402"
    )  # CiA 402 has no object for a temperature
    tensions = [reading.value_at(simulated_buses.t_ns) for reading in watch.tensions.values()]
    assert len(tensions) == len(simulated_buses.motors)
    assert all(abs(tension) < 8.0 for tension in tensions)
    assert simulated_buses.max_torque_N_m == 0.0, "no motor ever made torque"
    watch.send_release()


def test_two_buses_and_joint_encoders_are_read(tmp_path):
    _, watch = make_bus_watch(move_to_second_bus(hand_file(tmp_path, ["mit"])))
    for _ in range(120):
        watch.run_tick()
    assert watch.silent_motors() == []
    _, watch = make_bus_watch("jamia11")
    for _ in range(120):
        watch.run_tick()
    assert watch.angles
    assert all(abs(reading.value) < 0.1 for reading in watch.angles.values())


@pytest.mark.parametrize("process_value", ["int32", "real32"])
def test_amplifiers_are_set_up_and_read(process_value, tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(hand_with_amplifiers(process_value=process_value).to_toml())
    simulated_buses, watch = make_bus_watch(path)
    for _ in range(120):
        watch.run_tick()
    tensions = [reading.value_at(simulated_buses.t_ns) for reading in watch.tensions.values()]
    assert len(tensions) == 4
    assert all(abs(tension) < 8.0 for tension in tensions)
    simulated_buses.rig.inject("saturate cell=index_tendon")
    for _ in range(3):
        watch.run_tick()
    saturated_lines = [
        is_saturated(reading.value, watch.sensors.cell_range) for reading in watch.tensions.values()
    ]
    assert saturated_lines == [True, False, False, False]


@pytest.mark.parametrize("missed_ticks", [0, 1, 50])
def test_missed_ticks_are_skipped_and_not_executed_later(missed_ticks):
    """Reproduce a defect: after a stall of the host, the host sent the requests of all missed ticks at once."""
    simulated_buses, watch = make_bus_watch("jamia")
    for _ in range(120):
        watch.run_tick()
    original_wait = simulated_buses.wait
    waited_ticks = []

    def stall_at_first_wait(k):
        waited_ticks.append(k)
        skipped_ticks = missed_ticks if len(waited_ticks) == 1 else 0
        original_wait(k + skipped_ticks)
        return skipped_ticks * PERIOD_NS + 7

    simulated_buses.wait = stall_at_first_wait
    for _ in range(3):
        watch.run_tick()
    assert waited_ticks == [120, 121 + missed_ticks, 122 + missed_ticks]
    assert watch.k == 123 + missed_ticks
    assert watch.silent_motors() == []


def test_a_drive_that_falls_silent_is_named_and_its_readings_end():
    simulated_buses, watch = make_bus_watch("jamia")
    for _ in range(120):
        watch.run_tick()
    lost_node_ids = watch.drives[1].node_ids
    simulated_buses.rig.step = lambda t_ns, frames, step=simulated_buses.rig.step: [
        f for f in step(t_ns, frames) if f[0] not in lost_node_ids
    ]
    for _ in range(80):
        watch.run_tick()
    assert watch.silent_motors() == [watch.drives[1].name]
    assert math.isnan(SensorReading(3.0, 0).value_at(10**9))
    assert math.isnan(SensorReading().value_at(0))


def test_another_host_is_noticed():
    _, watch = make_bus_watch("jamia")
    assert watch.find_other_host(0.0, lambda bus, duration_s, seen_frames: None) == ""
    foreign = Frame(min(watch.drives[0].host_ids), bytes(8))
    assert (
        watch.find_other_host(0.0, lambda bus, duration_s, seen_frames: seen_frames.append(foreign))
        == f"{foreign.can_id:#x}"
    )


def test_a_load_cell_at_an_end_of_its_range_is_marked():
    assert [
        is_saturated(tension, (-6.0, 249.9375)) for tension in (-6.0, -5.9, 249.8, 250.0, math.nan)
    ] == [
        True,
        False,
        False,
        True,
        False,
    ]


def test_lines_of_json_are_printed_and_silent_motors_named(capsys):
    with run_simulated_drives("local:d", "mit", "--ids", "1,2"):
        assert main(["bus", "watch", "--bus", "local:d", "--for", "2", "--json"]) == 1
    out, err = capsys.readouterr()
    lines = [json.loads(line) for line in out.splitlines()]
    assert len(lines) > 5
    names = {row["motor"]: row["phase"] for row in lines[-1]["drives"]}
    assert names["index_motor"] == names["middle_motor"] == "ready"
    assert names["ring_motor"] == "silent"
    assert lines[-1]["drives"][0]["angle_rad"] is not None
    assert lines[-1]["drives"][2]["angle_rad"] is None
    assert "without a reply at the end: ring_motor, thumb_motor" in err


def test_a_table_is_printed_into_a_pipe(capsys):
    with run_simulated_drives("local:d", "mit", "--ids", "1,2,3,4"):
        assert main(["bus", "watch", "--bus", "local:d", "--for", "2"]) == 0
    assert "angle [deg]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        ([], "--bus: missing"),
        (["--bus", "socketcan:can0"], "no hand is given"),
        (
            ["--bus", "main=socketcan:can0", "--time-scale", "0.5", "--hand", "jamia"],
            "may have real motors",
        ),
        (["--bus", "local:d", "--for", "-1"], "--for"),
        (["--bus", "local:d", "--for", "nan"], "--for"),
        (["--bus", "local:d", "--time-scale", "0"], "--time-scale"),
    ],
)
def test_a_bad_argument_is_one_line(command_words, expected_message, capsys):
    assert main(["bus", "watch", *command_words]) == 2
    err = capsys.readouterr().err
    assert expected_message in err
    assert err.count("\n") == 1


def test_a_running_controller_keeps_its_bus(capsys):
    box = Mailbox("local:d")
    try:
        assert main(["bus", "watch", "--bus", "local:d", "--for", "1"]) == 1
    finally:
        box.close()
    assert "a controller runs here" in capsys.readouterr().err
