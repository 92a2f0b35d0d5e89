"""Registers that a motor must have before it is armed: read one after the other, write what is wrong, read it again."""

from handctl.drives import readback
from handctl.drives.mit import codec
from handctl.drives.readback import Walk

SERIAL_TRIES = 3
"""Of a register that a motor need not have."""
WRITES = 1
"""A register that differs again after it was written will not take the value."""

Wanted = tuple[tuple[int, float], ...]
"""(register, value) in the order of asking."""


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
    if not walk.waiting or reply[:2] != (codec.WRITE if walk.writing else codec.READ, register):
        return walk, ""
    if walk.writing:
        return walk.wrote(), ""
    if reply.raw == codec.register_bytes(register, value):
        return walk.right(), ""
    return readback.differs(walk, name(register), f"{reply.value:g}", f"{value:g}", WRITES)


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
    register, value = wanted[walk.step]
    walk, send, problem = readback.ask(walk, name(register), t_ns)
    operation = codec.WRITE if walk.writing else codec.READ
    return walk, codec.register_request(node_id, operation, register, value) if send else b"", problem


def ask_serial(walk: Walk, node_id: int, t_ns: int) -> tuple[Walk, bytes, bool]:
    """The request for the serial number that is due, once all wanted registers are right.

    Returns:
        the walk from here; payload on BROADCAST_ID, empty if an answer is awaited; whether the motor does not tell it.
    """
    walk, send, untold = readback.ask(walk, "serial number", t_ns, SERIAL_TRIES)
    return walk, codec.register_request(node_id, codec.READ, codec.SERIAL) if send else b"", bool(untold)


def name(register: int) -> str:
    """Return a register for people."""
    return f"register {register} {codec.REGISTER_NAMES[register]}"
