"""Registers that a motor must have before it is armed: read one after the other, write what is wrong, read it again."""

from typing import NamedTuple

from handctl.drives.mit import codec

REQUEST_TIMEOUT_NS = 20_000_000
REQUEST_TRIES = 10
SERIAL_TRIES = 3
"""Of a register that a motor need not have."""

Wanted = tuple[tuple[int, float], ...]
"""(register, value) in the order of asking."""


class Walk(NamedTuple):
    """How far a motor's registers are known.

    Attributes:
        step: index into the wanted registers.
        writing: whether the value was found wrong and is being written.
        written: whether this register was written already, so that another mismatch is an error.
        sent_ns: when the open request was sent [ns]; -1 if none is.
        tries: how often.
    """

    step: int = 0
    writing: bool = False
    written: bool = False
    sent_ns: int = -1
    tries: int = 0


def take(walk: Walk, wanted: Wanted, reply: codec.RegisterReply) -> tuple[Walk, str]:
    """Take in a reply; what the open request did not ask for, a late reply for instance, changes nothing.

    Args:
        walk: so far; not beyond the last register.
        wanted: registers.
        reply: from this motor.

    Returns:
        the walk from here, and what is wrong, empty if nothing is.
    """
    register, value = wanted[walk.step]
    if walk.sent_ns < 0 or reply[:2] != (codec.WRITE if walk.writing else codec.READ, register):
        return walk, ""
    if walk.writing:
        return Walk(walk.step, written=True), ""
    if reply.raw == codec.register_bytes(register, value):
        return Walk(walk.step + 1), ""
    if not walk.written:
        return Walk(walk.step, writing=True), ""
    return walk, f"{name(register)} reads {reply.value:g} after writing, expected {value:g}"


def ask(walk: Walk, wanted: Wanted, node_id: int, t_ns: int) -> tuple[Walk, bytes, str]:
    """The request that is due, if one is.

    Args:
        walk: so far; not beyond the last register.
        wanted: registers.
        node_id: ESC_ID.
        t_ns: now [ns].

    Returns:
        the walk from here; payload on BROADCAST_ID, empty if an answer is awaited; what is wrong, empty if nothing is.
    """
    if walk.sent_ns >= 0 and t_ns - walk.sent_ns < REQUEST_TIMEOUT_NS:
        return walk, b"", ""
    register, value = wanted[walk.step]
    if walk.tries >= REQUEST_TRIES:
        return walk, b"", f"{name(register)} is not answered"
    operation = codec.WRITE if walk.writing else codec.READ
    data = codec.register_request(node_id, operation, register, value)
    return walk._replace(sent_ns=t_ns, tries=walk.tries + 1), data, ""


def ask_serial(walk: Walk, node_id: int, t_ns: int) -> tuple[Walk, bytes, bool]:
    """The request for the serial number that is due, once all wanted registers are right.

    Returns:
        the walk from here; payload on BROADCAST_ID, empty if an answer is awaited; whether the motor does not tell it.
    """
    if walk.sent_ns >= 0 and t_ns - walk.sent_ns < REQUEST_TIMEOUT_NS:
        return walk, b"", False
    if walk.tries >= SERIAL_TRIES:
        return walk, b"", True
    data = codec.register_request(node_id, codec.READ, codec.SERIAL)
    return walk._replace(sent_ns=t_ns, tries=walk.tries + 1), data, False


def name(register: int) -> str:
    """Return a register for people."""
    return f"register {register} {codec.REGISTER_NAMES[register]}"
