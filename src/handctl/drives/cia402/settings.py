"""What a CiA 402 drive must hold before it is armed, written and read back object by object, by SDO.

RPDO1 is of type 255: torque acts when it arrives, in the tick that computed it, as with the other protocols; TPDO1 is
of type 1: sampled at SYNC. Loss of the master's heartbeat is a fault of the drive (0x1016, 0x6007).
"""

import enum
from typing import NamedTuple

from handctl.drives.cia402 import codec

REQUEST_TIMEOUT_NS = 20_000_000
REQUEST_TRIES = 10
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


class Walk(NamedTuple):
    """How far a drive's objects are known.

    Attributes:
        step: index of the object.
        written: whether it has been written.
        sent_ns: when the open request was sent [ns]; -1 if none is.
        tries: how often.
        serial: the drive's serial number; 0 if it has not told one.
    """

    step: int = 0
    written: bool = False
    sent_ns: int = -1
    tries: int = 0
    serial: int = 0


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


def take(walk: Walk, wanted: tuple[Step, ...], reply: codec.SdoReply) -> tuple[Walk, str]:
    """Take in a reply; one that was not asked for changes nothing.

    Returns:
        the walk from here, and what is wrong, empty if nothing is.
    """
    step = wanted[walk.step]
    if walk.sent_ns < 0 or reply[:2] != (step.number, step.sub):
        return walk, ""
    done = Walk(walk.step + 1, serial=walk.serial)
    if reply.abort:
        if reply.abort in (codec.ABSENT, 0x06090011) and step.check >= Check.WRITE_IF_THERE:
            return done, ""
        return walk, f"{step.name}: {codec.abort_text(reply.abort)}"
    if step.writes and not walk.written:
        return (walk, "") if reply.raw else (Walk(walk.step, written=True, serial=walk.serial), "")
    if not reply.raw:
        return walk, ""
    value = int.from_bytes(reply.raw, "little")
    if step.check == Check.TELL_IF_THERE:
        return done._replace(serial=value), ""
    good = value & step.value == step.value if step.check == Check.HAS_BITS else value == step.value
    return (done, "") if good else (walk, f"{step.name} reads {value:#x}, expected {step.value:#x}")


def ask(walk: Walk, wanted: tuple[Step, ...], t_ns: int) -> tuple[Walk, bytes, str]:
    """The request that is due: its payload, empty if an answer is awaited; what is wrong, empty if nothing is."""
    if walk.sent_ns >= 0 and t_ns - walk.sent_ns < REQUEST_TIMEOUT_NS:
        return walk, b"", ""
    step = wanted[walk.step]
    if walk.step and walk.tries >= REQUEST_TRIES:
        return walk, b"", f"{step.name} is not answered"
    writes = step.writes and not walk.written
    data = codec.download(step.number, step.sub, step.raw) if writes else codec.upload(step.number, step.sub)
    return walk._replace(sent_ns=t_ns, tries=walk.tries + 1), data, ""
