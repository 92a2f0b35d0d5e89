"""Test the reference firmware for a node that reads load cells.

The firmware is compiled for the host, and runs with a model of its analogue-to-digital converter
(ADC). The test compares the frames of the firmware with the DBC file.
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

FIRMWARE_FOLDER = Path(__file__).parents[2] / "firmware" / "load_cell_node"
SENSOR_NODE_DBC = Path(host.__file__).with_name("sensor_node.dbc")
C_COMPILER = shutil.which("cc")
CHANNELS_MAX = 15
SYNC_ID = 0x080
BASE_ID = 0x1A0
NANONEWTON_PER_COUNT = 42_000
"""Tension of one ADC count [nN], for a 250 N load cell with 2 mV/V at 3.3 V and gain 128."""
RAIL_CODE = 0
MODE_REGISTER, CLOCK_REGISTER, GAIN_REGISTER = 0x02, 0x03, 0x04
RESET_VALUES = {MODE_REGISTER: 0x0510, CLOCK_REGISTER: 0x0F0E, GAIN_REGISTER: 0x0000}
"""Values of the ADC's registers after a reset. Source: data sheet SBAS890."""
RESET_FLAG = 0x0400

pytestmark = pytest.mark.skipif(C_COMPILER is None, reason="no C compiler")


class NodeSettings(ctypes.Structure):
    """The C structure ``struct node_settings`` of the firmware."""

    _fields_ = [
        ("sync_id", ctypes.c_uint16),
        ("base_id", ctypes.c_uint16),
        ("channels", ctypes.c_uint8),
        ("zero", ctypes.c_int32 * CHANNELS_MAX),
        ("nN_per_count", ctypes.c_int32 * CHANNELS_MAX),
    ]


SEND_CALLBACK_TYPE = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_uint16, ctypes.POINTER(ctypes.c_uint8), ctypes.c_uint8
)
TRANSFER_CALLBACK_TYPE = ctypes.CFUNCTYPE(
    None,
    ctypes.c_void_p,
    ctypes.c_uint8,
    ctypes.POINTER(ctypes.c_uint8),
    ctypes.POINTER(ctypes.c_uint8),
)


class NodeBoard(ctypes.Structure):
    """The C structure ``struct node_board`` of the firmware."""

    _fields_ = [
        ("read", ctypes.c_void_p),
        ("send", SEND_CALLBACK_TYPE),
        ("context", ctypes.c_void_p),
    ]


class Ads131m04Struct(ctypes.Structure):
    """The C structure ``struct ads131m04`` of the firmware of the load cell node."""

    _fields_ = [
        ("transfer", TRANSFER_CALLBACK_TYPE),
        ("context", ctypes.c_void_p),
        ("chips", ctypes.c_uint8),
        ("ready", ctypes.c_bool * 4),
    ]


class LoadCellNodeStruct(ctypes.Structure):
    """The C structure ``struct node`` of the firmware of the load cell node."""

    _fields_ = [
        ("settings", NodeSettings),
        ("board", NodeBoard),
        ("stale", ctypes.c_uint8 * CHANNELS_MAX),
        ("malformed", ctypes.c_uint32),
    ]


def crc_16_ccitt(message: bytes) -> int:
    """Compute the CRC-16-CCITT that the data sheet of the ADC defines, bit by bit over the whole message."""
    remainder = 0xFFFF
    for byte in message:
        for bit in range(7, -1, -1):
            is_top_bit_set = (remainder >> 15) ^ (byte >> bit & 1)
            remainder = (remainder << 1 & 0xFFFF) ^ (0x1021 if is_top_bit_set else 0)
    return remainder


@dataclass
class Ads131m04Chip:
    """Model of an ADS131M04 chip.

    The model of the chip has registers and channels. Each frame of the chip contains the reply to
    the previous command, and a checksum.
    """

    counts: list[int] = field(default_factory=lambda: [0, 0, 0, 0])
    registers: dict[int, int] = field(default_factory=lambda: dict(RESET_VALUES))
    answer: int | None = None
    new_data_mask: int = 0xF
    corrupt_reply: Callable[[bytes], bytes] = bytes
    """Function that changes each reply of the chip on its way to the firmware, to simulate faults of transmission."""
    writable_registers: frozenset[int] = frozenset((MODE_REGISTER, CLOCK_REGISTER, GAIN_REGISTER))
    """Registers of the chip that store the value that a host writes."""

    def transfer_frame(self, sent_frame: bytes) -> bytes:
        """Receive a frame of 18 bytes and return the reply of the chip, as in an SPI transfer."""
        status = (self.registers[MODE_REGISTER] & RESET_FLAG) | 0x0100 | self.new_data_mask
        words = [self.answer if self.answer is not None else status]
        data = words[0].to_bytes(2) + b"\0"
        data += b"".join((count & 0xFFFFFF).to_bytes(3) for count in self.counts)
        data += crc_16_ccitt(data).to_bytes(2) + b"\0"
        command, address = (
            int.from_bytes(sent_frame[:2]),
            int.from_bytes(sent_frame[:2]) >> 7 & 0x3F,
        )
        self.answer = None
        if command >> 13 == 0b011:
            self.answer = 0x4000 | address << 7
            if address in self.writable_registers:
                self.registers[address] = int.from_bytes(sent_frame[3:5])
        elif command >> 13 == 0b101:
            self.answer = self.registers[address]
        return self.corrupt_reply(data)


class FirmwareBench:
    """The compiled firmware on a board with simulated chips.

    The bench collects the frames that the firmware sends.
    """

    def __init__(self, firmware_library: Any, channel_count: int) -> None:
        self.library = firmware_library
        self.chips = [Ads131m04Chip() for _ in range(4)]
        self.sent_frames: list[tuple[int, bytes]] = []
        self.transfer, self.send = (
            TRANSFER_CALLBACK_TYPE(self._transfer),
            SEND_CALLBACK_TYPE(self._send),
        )
        self.adc = Ads131m04Struct(self.transfer, None, -(-channel_count // 4))
        read = ctypes.cast(firmware_library.ads131m04_read, ctypes.c_void_p)
        self.board = NodeBoard(
            read, self.send, ctypes.cast(ctypes.pointer(self.adc), ctypes.c_void_p)
        )
        self.settings = NodeSettings(SYNC_ID, BASE_ID, channel_count)
        self.settings.nN_per_count[:] = [NANONEWTON_PER_COUNT] * CHANNELS_MAX
        self.node = LoadCellNodeStruct()
        assert self.initialize_firmware()
        self.set_up = [
            bool(firmware_library.ads131m04_setup(ctypes.byref(self.adc), chip))
            for chip in range(self.adc.chips)
        ]

    def initialize_firmware(self) -> bool:
        """Initialize the firmware with the settings of the bench.

        Return True if the firmware has accepted the settings.
        """
        return bool(
            self.library.node_init(
                ctypes.byref(self.node), ctypes.byref(self.settings), ctypes.byref(self.board)
            )
        )

    def _transfer(self, context: int, chip: int, out: Any, received: Any) -> None:
        for i, byte in enumerate(self.chips[chip].transfer_frame(bytes(out[:18]))):
            received[i] = byte

    def _send(self, context: int, can_id: int, data: Any, length: int) -> None:
        self.sent_frames.append((can_id, bytes(data[:length])))

    def set_cell_tensions(self, tensions: list[float]) -> None:
        """Set the ADC counts of the load cells so that they correspond to given tensions [N]."""
        for i, tension in enumerate(tensions):
            self.chips[i // 4].counts[i % 4] = round(tension * 1e9 / NANONEWTON_PER_COUNT)

    def receive(self, can_id: int, data: bytes) -> list[tuple[int, bytes]]:
        """Deliver a CAN frame to the firmware, and return the frames that the firmware sends."""
        self.sent_frames.clear()
        self.library.node_receive(ctypes.byref(self.node), can_id, data, len(data))
        return list(self.sent_frames)

    def tension_codes(self, counter: int = 0) -> list[int]:
        """Send a SYNC frame, and return the tension codes of all channels in the replies."""
        words = [
            int.from_bytes(data, "little") for _, data in self.receive(SYNC_ID, bytes((counter,)))
        ]
        return [words[i // 5] >> (4 + 12 * (i % 5)) & 0xFFF for i in range(self.settings.channels)]


@pytest.fixture(scope="module")
def firmware_library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("node") / "node.so"
    assert C_COMPILER
    words = [
        C_COMPILER,
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
    subprocess.run([*words, *map(str, sorted(FIRMWARE_FOLDER.glob("*.c")))], check=True)
    library = ctypes.CDLL(str(path))
    library.node_init.restype = library.ads131m04_setup.restype = ctypes.c_bool
    library.node_receive.argtypes = [
        ctypes.c_void_p,
        ctypes.c_uint16,
        ctypes.c_char_p,
        ctypes.c_uint8,
    ]
    return library


def test_the_firmware_has_at_most_300_lines() -> None:
    assert sum(len(path.read_text().splitlines()) for path in FIRMWARE_FOLDER.glob("*.[ch]")) <= 300


@pytest.mark.parametrize("seed", range(20))
def test_frames_are_those_of_the_simulated_node_and_of_the_dbc(
    firmware_library: Any, seed: int
) -> None:
    """The frames of the firmware equal those of the simulator.

    With the DBC file, cantools decodes the right tensions and the right counter from the frames of
    the firmware.
    """
    random_source = random.Random(seed)
    database: Any = cantools.database.load_file(SENSOR_NODE_DBC)
    channels = random_source.randint(1, CHANNELS_MAX)
    bench = FirmwareBench(firmware_library, channels)
    for _ in range(20):
        tensions = [random_source.uniform(-5.5, 249.0) for _ in range(channels)]
        counter = random_source.randrange(256)
        bench.set_cell_tensions(tensions)
        answers = bench.receive(SYNC_ID, bytes((counter,)))
        assert [can_id for can_id, _ in answers] == [BASE_ID + g for g in range(-(-channels // 5))]
        for g, (can_id, data) in enumerate(answers):
            group = tensions[5 * g : 5 * g + 5]
            signals = database.decode_message(can_id, data, allow_truncated=True)
            assert signals.pop("counter") == counter & 0xF
            assert list(signals.values()) == pytest.approx(
                group, abs=0.0625 / 2 + NANONEWTON_PER_COUNT / 1e9
            )
            sent_codes = [
                (int.from_bytes(data, "little") >> 4 + 12 * i) & 0xFFF for i in range(len(group))
            ]
            assert len(data) == len(pack(counter, sent_codes))
            assert data == pack(counter, sent_codes)
            # If a tension is halfway between two codes, the firmware is allowed to round it up or
            # down.
            assert all(
                abs(code - tension_code(tension)) <= 1
                for code, tension in zip(sent_codes, group, strict=True)
            )


def test_a_cell_mounted_in_reverse_reads_positive(firmware_library: Any) -> None:
    bench = FirmwareBench(firmware_library, 1)
    bench.settings.nN_per_count[0] = -NANONEWTON_PER_COUNT
    bench.settings.zero[0] = 1000
    assert bench.initialize_firmware()
    bench.chips[0].counts[0] = 1000 - round(50e9 / NANONEWTON_PER_COUNT)
    assert bench.tension_codes() == [tension_code(50.0)]


def test_only_sync_of_one_byte_is_answered(firmware_library: Any) -> None:
    bench = FirmwareBench(firmware_library, 4)
    assert bench.receive(SYNC_ID + 1, b"\1") == []
    assert bench.receive(SYNC_ID, b"") == []
    assert bench.receive(SYNC_ID, b"\1\2") == []
    assert bench.node.malformed == 2
    assert len(bench.receive(SYNC_ID, b"\1")) == 1


def test_a_tension_out_of_range_is_at_the_rail(firmware_library: Any) -> None:
    bench = FirmwareBench(firmware_library, 4)
    bench.set_cell_tensions([-8.0, 300.0, -6.0, 249.0])
    low, high, zero, top = bench.tension_codes()
    assert (low, high, zero) == (RAIL_CODE, 4095, RAIL_CODE)
    assert 0 < top < 4095


def test_an_open_bridge_is_at_the_rail(firmware_library: Any) -> None:
    bench = FirmwareBench(firmware_library, 2)
    for counts in (0x7FFFFF, -0x800000):
        bench.chips[0].counts[1] = counts
        assert bench.tension_codes() == [96, RAIL_CODE]


@pytest.mark.parametrize("reply_without_answer", [b"\0" * 18, b"\xff" * 18])
def test_an_adc_without_answer_is_at_the_rail_and_comes_back(
    firmware_library: Any, reply_without_answer: bytes
) -> None:
    bench = FirmwareBench(firmware_library, 5)
    bench.chips[0].corrupt_reply = lambda data: reply_without_answer
    assert bench.tension_codes() == [RAIL_CODE] * 4 + [96]
    bench.chips[0].corrupt_reply = bytes
    bench.tension_codes()
    assert bench.tension_codes() == [96] * 5


@pytest.mark.parametrize("seed", range(20))
def test_a_flipped_bit_is_no_tension(firmware_library: Any, seed: int) -> None:
    random_source = random.Random(seed)
    bench = FirmwareBench(firmware_library, 4)
    bench.set_cell_tensions([random_source.uniform(0.0, 200.0) for _ in range(4)])
    byte_index, bit = random_source.randrange(17), random_source.randrange(8)
    bench.chips[0].corrupt_reply = lambda data: bytes(
        b ^ (1 << bit if i == byte_index else 0) for i, b in enumerate(data)
    )
    assert bench.tension_codes() == [RAIL_CODE] * 4


def test_a_chip_that_was_reset_is_set_up_again(firmware_library: Any) -> None:
    """After a reset, the gain of the chip is 1 instead of 128.

    Without a new set-up of the chip, every measured tension would be near zero.
    """
    bench = FirmwareBench(firmware_library, 4)
    bench.set_cell_tensions([100.0] * 4)
    assert bench.chips[0].registers[GAIN_REGISTER] == 0x7777
    bench.chips[0].registers = dict(RESET_VALUES)
    assert bench.tension_codes() == [RAIL_CODE] * 4
    assert bench.chips[0].registers[GAIN_REGISTER] == 0x7777
    assert bench.tension_codes() == [tension_code(100.0)] * 4


@pytest.mark.parametrize("unwritable_register", [MODE_REGISTER, CLOCK_REGISTER, GAIN_REGISTER])
def test_a_chip_that_keeps_other_settings_is_never_ready(
    firmware_library: Any, unwritable_register: int
) -> None:
    bench = FirmwareBench(firmware_library, 4)
    broken_chip = Ads131m04Chip(
        writable_registers=frozenset((MODE_REGISTER, CLOCK_REGISTER, GAIN_REGISTER))
        - {unwritable_register}
    )
    broken_chip.registers[unwritable_register] = 0x0001
    bench.chips[0] = broken_chip
    assert not firmware_library.ads131m04_setup(ctypes.byref(bench.adc), 0)
    assert bench.tension_codes() == [RAIL_CODE] * 4


def test_a_conversion_that_does_not_end_is_at_the_rail_from_the_third_sync(
    firmware_library: Any,
) -> None:
    bench = FirmwareBench(firmware_library, 4)
    bench.set_cell_tensions([20.0] * 4)
    valid_tension_code = tension_code(20.0)
    bench.chips[0].new_data_mask = 0b1101
    assert [bench.tension_codes()[1] for _ in range(4)] == [
        valid_tension_code,
        valid_tension_code,
        RAIL_CODE,
        RAIL_CODE,
    ]
    bench.chips[0].new_data_mask = 0xF
    assert bench.tension_codes() == [valid_tension_code] * 4


@pytest.mark.parametrize(
    ("setting_name", "setting_value"),
    [
        ("channels", 0),
        ("channels", 16),
        ("sync_id", 0x800),
        ("base_id", 0x7FE),
        ("sync_id", BASE_ID + 2),
    ],
)
def test_settings_that_cannot_work_are_refused(
    firmware_library: Any, setting_name: str, setting_value: int
) -> None:
    bench = FirmwareBench(firmware_library, CHANNELS_MAX)
    setattr(bench.settings, setting_name, setting_value)
    assert not bench.initialize_firmware()


def test_a_cell_without_scale_is_refused(firmware_library: Any) -> None:
    bench = FirmwareBench(firmware_library, 3)
    bench.settings.nN_per_count[2] = 0
    assert not bench.initialize_firmware()
