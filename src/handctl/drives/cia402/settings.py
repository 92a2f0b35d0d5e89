"""What a CiA 402 drive must hold before it is armed, written and read back object by object, by SDO.

RPDO1 is of type 255: torque acts when it arrives, in the tick that computed it, as with the other protocols; TPDO1 is
of type 1: sampled at SYNC. Loss of the master's heartbeat is a fault of the drive (0x1016, 0x6007).
"""

import enum
from typing import NamedTuple

from handctl.drives import readback
from handctl.drives.cia402 import codec
from handctl.drives.readback import Walk

FOREVER = 1 << 62
"""Requests that never come together."""
TORQUE_MODE = 10
PDO_OFF = 1 << 31
MASTER = 0x7F
"""Node number of this host, whose heartbeat the drives watch."""
UNSUPERVISED = 0x1016, 1, (MASTER << 16).to_bytes(4, "little")
"""Number, subindex and bytes of an object: a heartbeat that may be 0 ms apart is not waited for."""


SERIAL = 0x1018, 4
"""Number and subindex of the serial number."""


class Check(enum.IntEnum):
    """What is done with an object."""

    SAME = 0
    """Read; must be this value."""
    HAS_BITS = 1
    """Read; must have these bits."""
    WRITE = 2
    """Write, read, must be this value."""
    WRITE_IF_THERE = 3
    """The same, and a drive without this object is well."""
    TELL_IF_THERE = 4
    """Read, whatever it is; a drive without this object is well."""


class Step(NamedTuple):
    """An object and its value."""

    check: Check
    number: int
    sub: int
    value: int
    size: int

    @property
    def raw(self) -> bytes:
        """The value as bytes."""
        return self.value.to_bytes(self.size, "little")

    @property
    def writes(self) -> bool:
        """Whether it is written, and read back then."""
        return self.check in (Check.WRITE, Check.WRITE_IF_THERE)

    @property
    def name(self) -> str:
        """The object for people."""
        return f"object {self.number:#06x}:{self.sub}"


GUARDS = ((0x1016, 1), (0x6072, 0))
"""Objects that make an enabled drive the first guard: loss of this host's heartbeat, and the largest torque."""


def steps(node_id: int, rated: int, most: int, watchdog_ms: int, heartbeat_ms: int) -> tuple[Step, ...]:
    """All objects in order.

    Args:
        node_id: of the drive.
        rated: rated torque as object 0x6076 has it.
        most: largest torque [1/1000 of rated].
        watchdog_ms: longest time without this host's heartbeat [ms].
        heartbeat_ms: period of the drive's own [ms].
    """
    same, bits, write, maybe, tell = Check
    others = [Step(maybe, base + i, 1, PDO_OFF | cob + 0x100 * i + node_id, 4) for base, cob in ((0x1400, codec.RPDO),
              (0x1800, codec.TPDO)) for i in (1, 2, 3)]  # fmt: skip
    return (
        Step(bits, 0x1000, 0, 0x0192, 4),
        Step(tell, *SERIAL, 0, 4),
        Step(write, 0x6040, 0, codec.DISABLE_VOLTAGE, 2),
        Step(bits, 0x6502, 0, 1 << TORQUE_MODE - 1, 4),
        Step(same, 0x6076, 0, rated, 4),
        Step(write, 0x6072, 0, most, 2),
        Step(write, 0x6071, 0, 0, 2),
        Step(write, 0x6007, 0, 1, 2),
        Step(write, 0x1016, 1, MASTER << 16 | watchdog_ms, 4),
        Step(write, 0x1017, 0, heartbeat_ms, 2),
        Step(write, 0x6060, 0, TORQUE_MODE, 1),
        Step(same, 0x6061, 0, TORQUE_MODE, 1),
        *others,
        *_pdo(0x1400, 0x1600, codec.RPDO + node_id, 255, (0x6040_00_10, 0x6071_00_10)),
        *_pdo(0x1800, 0x1A00, codec.TPDO + node_id, 1, (0x6041_00_10, 0x6064_00_20, 0x6077_00_10)),
    )


def _pdo(communication: int, mapping: int, cob: int, kind: int, objects: tuple[int, ...]) -> tuple[Step, ...]:
    """A PDO switched off, mapped, and switched on."""
    write = Check.WRITE
    return (
        Step(write, communication, 1, PDO_OFF | cob, 4),
        Step(write, mapping, 0, 0, 1),
        *(Step(write, mapping, i + 1, entry, 4) for i, entry in enumerate(objects)),
        Step(write, mapping, 0, len(objects), 1),
        Step(write, communication, 2, kind, 1),
        Step(write, communication, 1, cob, 4),
    )


def writes(walk: Walk, step: Step) -> bool:
    """Return whether the open or the next request writes; an object is written before it is read."""
    return step.writes and not walk.written


def take(walk: Walk, wanted: tuple[Step, ...], reply: codec.SdoReply) -> tuple[Walk, int, str]:
    """Take in a reply; one that was not asked for changes nothing.

    Returns:
        the walk from here; the value of an object that is only told, 0 if it is none; what is wrong, empty if nothing
        is.
    """
    step = wanted[walk.step]
    if not walk.waiting or reply[:2] != (step.number, step.sub):
        return walk, 0, ""
    if reply.abort:
        if reply.abort in (codec.ABSENT, 0x06090011) and step.check >= Check.WRITE_IF_THERE:
            return walk.right(), 0, ""
        return walk, 0, f"{step.name}: {codec.abort_text(reply.abort)}"
    if writes(walk, step):
        return walk if reply.raw else walk.wrote(), 0, ""
    if not reply.raw:
        return walk, 0, ""
    value = int.from_bytes(reply.raw, "little")
    if step.check == Check.TELL_IF_THERE:
        return walk.right(), value, ""
    if (value & step.value == step.value) if step.check == Check.HAS_BITS else value == step.value:
        return walk.right(), 0, ""
    walk, problem = readback.differs(walk, step.name, f"{value:#x}", f"{step.value:#x}", 0)
    return walk, 0, problem


def ask(walk: Walk, wanted: tuple[Step, ...], t_ns: int) -> tuple[Walk, bytes, str]:
    """The request that is due: its payload, empty if an answer is awaited; what is wrong, empty if nothing is.

    The first object is asked for until the drive is there.
    """
    step = wanted[walk.step]
    walk, send, problem = readback.ask(walk, step.name, t_ns, readback.REQUEST_TRIES if walk.step else FOREVER)
    if not send:
        return walk, b"", problem
    download = codec.download(step.number, step.sub, step.raw)
    return walk, download if writes(walk, step) else codec.upload(step.number, step.sub), ""
