"""Test the reference firmware of the load-cell node.

It is compiled for the host and runs with a model of its ADC. Its frames are compared with the DBC
file.
"""

import ctypes
import random
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cantools.database
import pytest

from firmware_sim.nodes.sensor_node import pack, tension_code
from handctl.drives.sensors import sensor_node as host

SOURCES = Path(__file__).parents[2] / "firmware" / "load_cell_node"
DBC = Path(host.__file__).with_name("sensor_node.dbc")
COMPILER = shutil.which("cc")
CHANNELS_MAX = 15
SYNC_ID = 0x080
BASE_ID = 0x1A0
NN_PER_COUNT = 42_000
"""Tension of one ADC count [nN], for a 250 N load cell with 2 mV/V at 3.3 V and gain 128."""
BROKEN = 0
MODE, CLOCK, GAIN = 0x02, 0x03, 0x04
RESET_VALUES = {MODE: 0x0510, CLOCK: 0x0F0E, GAIN: 0x0000}
"""Values of the ADC's registers after a reset. Source: data sheet SBAS890."""
RESET_FLAG = 0x0400

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


class Settings(ctypes.Structure):
    """The C structure ``struct node_settings``."""

    _fields_ = [
        ("sync_id", ctypes.c_uint16),
        ("base_id", ctypes.c_uint16),
        ("channels", ctypes.c_uint8),
        ("zero", ctypes.c_int32 * CHANNELS_MAX),
        ("nN_per_count", ctypes.c_int32 * CHANNELS_MAX),
    ]


SEND = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_uint16, ctypes.POINTER(ctypes.c_uint8), ctypes.c_uint8
)
TRANSFER = ctypes.CFUNCTYPE(
    None,
    ctypes.c_void_p,
    ctypes.c_uint8,
    ctypes.POINTER(ctypes.c_uint8),
    ctypes.POINTER(ctypes.c_uint8),
)


class Board(ctypes.Structure):
    """The C structure ``struct node_board``."""

    _fields_ = [("read", ctypes.c_void_p), ("send", SEND), ("context", ctypes.c_void_p)]


class Adc(ctypes.Structure):
    """The C structure ``struct ads131m04``."""

    _fields_ = [
        ("transfer", TRANSFER),
        ("context", ctypes.c_void_p),
        ("chips", ctypes.c_uint8),
        ("ready", ctypes.c_bool * 4),
    ]


class Node(ctypes.Structure):
    """The C structure ``struct node``."""

    _fields_ = [
        ("settings", Settings),
        ("board", Board),
        ("stale", ctypes.c_uint8 * CHANNELS_MAX),
        ("malformed", ctypes.c_uint32),
    ]


def crc16(data: bytes) -> int:
    """Compute the CRC-16-CCITT that the data sheet defines, bit by bit over the whole message."""
    remainder = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (remainder >> 15) ^ (byte >> bit & 1)
            remainder = (remainder << 1 & 0xFFFF) ^ (0x1021 if carry else 0)
    return remainder


@dataclass
class Chip:
    """Model of an ADS131M04 chip: its registers, its reply to the last command, its channels and its checksum."""

    counts: list[int] = field(default_factory=lambda: [0, 0, 0, 0])
    registers: dict[int, int] = field(default_factory=lambda: dict(RESET_VALUES))
    answer: int | None = None
    fresh: int = 0xF
    damage: Callable[[bytes], bytes] = bytes
    """Function that changes the reply on its way, to simulate faults of transmission."""
    kept: frozenset[int] = frozenset((MODE, CLOCK, GAIN))
    """Registers that take the values that are written to them."""

    def transfer(self, out: bytes) -> bytes:
        """Take one frame of 18 bytes and return another, as in a transfer by SPI."""
        status = (self.registers[MODE] & RESET_FLAG) | 0x0100 | self.fresh
        words = [self.answer if self.answer is not None else status]
        data = words[0].to_bytes(2) + b"\0"
        data += b"".join((count & 0xFFFFFF).to_bytes(3) for count in self.counts)
        data += crc16(data).to_bytes(2) + b"\0"
        command, address = int.from_bytes(out[:2]), int.from_bytes(out[:2]) >> 7 & 0x3F
        self.answer = None
        if command >> 13 == 0b011:
            self.answer = 0x4000 | address << 7
            if address in self.kept:
                self.registers[address] = int.from_bytes(out[3:5])
        elif command >> 13 == 0b101:
            self.answer = self.registers[address]
        return self.damage(data)


class Bench:
    """The compiled firmware on a board with model chips. The bench collects the frames that it sends."""

    def __init__(self, library: Any, channels: int) -> None:
        self.library = library
        self.chips = [Chip() for _ in range(4)]
        self.sent: list[tuple[int, bytes]] = []
        self.transfer, self.send = TRANSFER(self._transfer), SEND(self._send)
        self.adc = Adc(self.transfer, None, -(-channels // 4))
        read = ctypes.cast(library.ads131m04_read, ctypes.c_void_p)
        self.board = Board(read, self.send, ctypes.cast(ctypes.pointer(self.adc), ctypes.c_void_p))
        self.settings = Settings(SYNC_ID, BASE_ID, channels)
        self.settings.nN_per_count[:] = [NN_PER_COUNT] * CHANNELS_MAX
        self.node = Node()
        assert self.init()
        self.set_up = [
            bool(library.ads131m04_setup(ctypes.byref(self.adc), chip))
            for chip in range(self.adc.chips)
        ]

    def init(self) -> bool:
        """Initialize the firmware with the settings, and return whether it accepted them."""
        return bool(
            self.library.node_init(
                ctypes.byref(self.node), ctypes.byref(self.settings), ctypes.byref(self.board)
            )
        )

    def _transfer(self, context: int, chip: int, out: Any, into: Any) -> None:
        for i, byte in enumerate(self.chips[chip].transfer(bytes(out[:18]))):
            into[i] = byte

    def _send(self, context: int, can_id: int, data: Any, length: int) -> None:
        self.sent.append((can_id, bytes(data[:length])))

    def weigh(self, tensions: list[float]) -> None:
        """Set the ADC counts of the load cells to those of given tensions [N]."""
        for i, tension in enumerate(tensions):
            self.chips[i // 4].counts[i % 4] = round(tension * 1e9 / NN_PER_COUNT)

    def receive(self, can_id: int, data: bytes) -> list[tuple[int, bytes]]:
        """Deliver a CAN frame to the firmware, and return the frames that it sends."""
        self.sent.clear()
        self.library.node_receive(ctypes.byref(self.node), can_id, data, len(data))
        return list(self.sent)

    def codes(self, counter: int = 0) -> list[int]:
        """Send a SYNC, and return the tension codes of all channels in the replies."""
        words = [
            int.from_bytes(data, "little") for _, data in self.receive(SYNC_ID, bytes((counter,)))
        ]
        return [words[i // 5] >> (4 + 12 * (i % 5)) & 0xFFF for i in range(self.settings.channels)]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("node") / "node.so"
    assert COMPILER
    words = [
        COMPILER,
        "-std=c11",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O1",
        "-fPIC",
        "-shared",
        "-o",
        str(path),
    ]
    subprocess.run([*words, *map(str, sorted(SOURCES.glob("*.c")))], check=True)
    loaded = ctypes.CDLL(str(path))
    loaded.node_init.restype = loaded.ads131m04_setup.restype = ctypes.c_bool
    loaded.node_receive.argtypes = [
        ctypes.c_void_p,
        ctypes.c_uint16,
        ctypes.c_char_p,
        ctypes.c_uint8,
    ]
    return loaded


def test_the_firmware_has_at_most_300_lines() -> None:
    assert sum(len(path.read_text().splitlines()) for path in SOURCES.glob("*.[ch]")) <= 300


@pytest.mark.parametrize("seed", range(20))
def test_frames_are_those_of_the_simulated_node_and_of_the_dbc(library: Any, seed: int) -> None:
    """The firmware's frames equal those of the simulator.

    With the DBC file, cantools decodes their tensions and counter.
    """
    chance = random.Random(seed)
    database: Any = cantools.database.load_file(DBC)
    channels = chance.randint(1, CHANNELS_MAX)
    bench = Bench(library, channels)
    for _ in range(20):
        tensions = [chance.uniform(-5.5, 249.0) for _ in range(channels)]
        counter = chance.randrange(256)
        bench.weigh(tensions)
        answers = bench.receive(SYNC_ID, bytes((counter,)))
        assert [can_id for can_id, _ in answers] == [BASE_ID + g for g in range(-(-channels // 5))]
        for g, (can_id, data) in enumerate(answers):
            group = tensions[5 * g : 5 * g + 5]
            signals = database.decode_message(can_id, data, allow_truncated=True)
            assert signals.pop("counter") == counter & 0xF
            assert list(signals.values()) == pytest.approx(
                group, abs=0.0625 / 2 + NN_PER_COUNT / 1e9
            )
            ours = [
                (int.from_bytes(data, "little") >> 4 + 12 * i) & 0xFFF for i in range(len(group))
            ]
            assert len(data) == len(pack(counter, ours))
            assert data == pack(counter, ours)
            # The firmware may round a tension halfway between two codes up or down.
            assert all(
                abs(code - tension_code(tension)) <= 1
                for code, tension in zip(ours, group, strict=True)
            )


def test_a_cell_mounted_in_reverse_reads_positive(library: Any) -> None:
    bench = Bench(library, 1)
    bench.settings.nN_per_count[0] = -NN_PER_COUNT
    bench.settings.zero[0] = 1000
    assert bench.init()
    bench.chips[0].counts[0] = 1000 - round(50e9 / NN_PER_COUNT)
    assert bench.codes() == [tension_code(50.0)]


def test_only_sync_of_one_byte_is_answered(library: Any) -> None:
    bench = Bench(library, 4)
    assert bench.receive(SYNC_ID + 1, b"\1") == []
    assert bench.receive(SYNC_ID, b"") == []
    assert bench.receive(SYNC_ID, b"\1\2") == []
    assert bench.node.malformed == 2
    assert len(bench.receive(SYNC_ID, b"\1")) == 1


def test_a_tension_out_of_range_is_at_the_rail(library: Any) -> None:
    bench = Bench(library, 4)
    bench.weigh([-8.0, 300.0, -6.0, 249.0])
    low, high, zero, top = bench.codes()
    assert (low, high, zero) == (BROKEN, 4095, BROKEN)
    assert 0 < top < 4095


def test_an_open_bridge_is_at_the_rail(library: Any) -> None:
    bench = Bench(library, 2)
    for counts in (0x7FFFFF, -0x800000):
        bench.chips[0].counts[1] = counts
        assert bench.codes() == [96, BROKEN]


@pytest.mark.parametrize("silent", [b"\0" * 18, b"\xff" * 18])
def test_an_adc_without_answer_is_at_the_rail_and_comes_back(library: Any, silent: bytes) -> None:
    bench = Bench(library, 5)
    bench.chips[0].damage = lambda data: silent
    assert bench.codes() == [BROKEN] * 4 + [96]
    bench.chips[0].damage = bytes
    bench.codes()
    assert bench.codes() == [96] * 5


@pytest.mark.parametrize("seed", range(20))
def test_a_flipped_bit_is_no_tension(library: Any, seed: int) -> None:
    chance = random.Random(seed)
    bench = Bench(library, 4)
    bench.weigh([chance.uniform(0.0, 200.0) for _ in range(4)])
    at, bit = chance.randrange(17), chance.randrange(8)
    bench.chips[0].damage = lambda data: bytes(
        b ^ (1 << bit if i == at else 0) for i, b in enumerate(data)
    )
    assert bench.codes() == [BROKEN] * 4


def test_a_chip_that_was_reset_is_set_up_again(library: Any) -> None:
    """Without a new set-up, the chip's gain would be 1 instead of 128. Every tension would then read near zero."""
    bench = Bench(library, 4)
    bench.weigh([100.0] * 4)
    assert bench.chips[0].registers[GAIN] == 0x7777
    bench.chips[0].registers = dict(RESET_VALUES)
    assert bench.codes() == [BROKEN] * 4
    assert bench.chips[0].registers[GAIN] == 0x7777
    assert bench.codes() == [tension_code(100.0)] * 4


@pytest.mark.parametrize("lost", [MODE, CLOCK, GAIN])
def test_a_chip_that_keeps_other_settings_is_never_ready(library: Any, lost: int) -> None:
    bench = Bench(library, 4)
    broken = Chip(kept=frozenset((MODE, CLOCK, GAIN)) - {lost})
    broken.registers[lost] = 0x0001
    bench.chips[0] = broken
    assert not library.ads131m04_setup(ctypes.byref(bench.adc), 0)
    assert bench.codes() == [BROKEN] * 4


def test_a_conversion_that_does_not_end_is_at_the_rail_from_the_third_sync(library: Any) -> None:
    bench = Bench(library, 4)
    bench.weigh([20.0] * 4)
    good = tension_code(20.0)
    bench.chips[0].fresh = 0b1101
    assert [bench.codes()[1] for _ in range(4)] == [good, good, BROKEN, BROKEN]
    bench.chips[0].fresh = 0xF
    assert bench.codes() == [good] * 4


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("channels", 0),
        ("channels", 16),
        ("sync_id", 0x800),
        ("base_id", 0x7FE),
        ("sync_id", BASE_ID + 2),
    ],
)
def test_settings_that_cannot_work_are_refused(library: Any, name: str, value: int) -> None:
    bench = Bench(library, CHANNELS_MAX)
    setattr(bench.settings, name, value)
    assert not bench.init()


def test_a_cell_without_scale_is_refused(library: Any) -> None:
    bench = Bench(library, 3)
    bench.settings.nN_per_count[2] = 0
    assert not bench.init()
