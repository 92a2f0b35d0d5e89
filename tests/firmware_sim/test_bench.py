"""Drives with free shafts: their settings as delivered, and the motion of their shafts."""

import math
import struct

import pytest

from firmware_sim.__main__ import main
from firmware_sim.bus.frame import BRS, FDF, Frame
from firmware_sim.nodes import PROTOCOLS
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.programs.drive import Bench
from firmware_sim.programs.drive_types import drive_spec

MS = 1_000_000
ENABLE = b"\xff" * 7 + b"\xfc"


def register(bench: Bench, node: int, number: int) -> bytes:
    (reply,) = bench.receive(Frame(0x7FF, bytes((node, 0, 0x33, number, 0, 0, 0, 0))))
    assert reply.can_id == node + 0x10
    return reply.data[4:]


@pytest.mark.parametrize("kind", mit_bench.TYPES)
def test_an_mit_motor_has_the_manufacturers_ranges_and_no_watchdog(kind: str) -> None:
    bench = Bench([drive_spec("mit", 2, kind), drive_spec("mit", 5, kind)])
    for node in (2, 5):
        ranges = [struct.unpack("<f", register(bench, node, number))[0] for number in (21, 22, 23)]
        assert ranges == pytest.approx(mit_bench.TYPES[kind])
        assert register(bench, node, 9) == bytes(4)
        assert register(bench, node, 35) == b"\4\0\0\0"


def test_a_motor_set_to_fd_reports_it_and_answers_in_fd() -> None:
    bench = Bench([drive_spec("mit", 1, fd=True)])
    assert register(bench, 1, 35)[0] == 9
    (reply,) = bench.receive(Frame(1, ENABLE, FDF | BRS))
    assert reply.flags == FDF | BRS


def test_a_free_shaft_turns_by_its_inertia() -> None:
    bench = Bench([drive_spec("odrive", 0, inertia=1e-3)])
    for command, data in ((0x0B, struct.pack("<II", 1, 1)), (0x07, struct.pack("<I", 8))):
        bench.receive(Frame(command, data))
    bench.receive(Frame(0x0E, struct.pack("<f", 0.1)))
    bench.advance(200 * MS)
    spec = drive_spec("odrive", 0, inertia=1e-3)
    expected = (0.1 - spec.coulomb) / spec.viscous * (1.0 - math.exp(-0.2 * spec.viscous / spec.inertia))
    assert bench.motors[0].omega == pytest.approx(expected, rel=0.03)
    bench.receive(Frame(0x07, struct.pack("<I", 1)))
    bench.advance(20_000 * MS)
    assert abs(bench.motors[0].omega) < 0.01, "it coasts to a stop"


def test_an_odrive_follows_positions_and_velocities() -> None:
    bench = Bench([drive_spec("odrive", 3)])
    bench.receive(Frame(3 << 5 | 0x07, struct.pack("<I", 8)))
    bench.receive(Frame(3 << 5 | 0x0C, struct.pack("<fhh", 1.5, 0, 0)))
    bench.advance(2000 * MS)
    assert bench.motors[0].theta == pytest.approx(1.5 * math.tau, abs=0.1)
    bench.receive(Frame(3 << 5 | 0x07, struct.pack("<I", 1)))
    bench.receive(Frame(3 << 5 | 0x0B, struct.pack("<II", 2, 1)))
    bench.receive(Frame(3 << 5 | 0x07, struct.pack("<I", 8)))
    bench.receive(Frame(3 << 5 | 0x0D, struct.pack("<ff", -2.0, 0.0)))
    bench.advance(3000 * MS)
    assert bench.motors[0].omega == pytest.approx(-2.0 * math.tau, rel=0.05)
    bench.receive(Frame(3 << 5 | 0x0C, struct.pack("<fhh", math.nan, 0, 0)))
    assert bench.motors[0].servo.kd == 0.0


def test_frames_for_no_node_are_counted() -> None:
    bench = Bench([drive_spec("cia402", 32), drive_spec("mit", 1)])
    assert bench.receive(Frame(0x123, b"")) == []
    assert bench.foreign == 1
    bench.advance(5 * MS)
    assert [frame.can_id for frame in bench.take_unsolicited()] == [0x720]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("mit --ids 1,1 --bus local:x", "each number once"),
        ("mit --ids one --bus local:x", "expected numbers"),
        ("mit --ids 0 --bus local:x", f"expected 1 to {PROTOCOLS['mit'].numbers.stop - 1}"),
        ("odrive --ids 63 --bus local:x", "expected 0 to 62"),
        ("cia402 --ids 1 --fd --bus local:x", "only for drive mit"),
        ("mit --ids 1 --motor-type ak80-9 --fd --bus local:x", "Damiao"),
        ("odrive --ids 1 --motor-type dm4310 --bus local:x", "only for drive mit"),
        ("cubemars --ids 1 --motor-type dm4310 --bus local:x", "no such motor"),
        ("mit --ids 1 --motor-type dm1 --bus local:x", "dm4310"),
        ("mit --ids 1 --inertia nan --bus local:x", "more than 0"),
        ("can --ids 1 --bus local:x", "invalid choice"),
        ("mit --ids 1 --bus nothing", "local:NAME"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(words: str, expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", *words.split()]) == 2
    text = capsys.readouterr().err
    assert expected in text
    assert text.count("\n") == 1
