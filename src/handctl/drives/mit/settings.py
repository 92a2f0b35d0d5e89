"""Register values required before arming: read each register, write a wrong value, read it again."""

from handctl.drives import readback
from handctl.drives.mit import codec
from handctl.drives.readback import Walk

SERIAL_TRIES = 3
"""Requests for the serial number, an optional register."""
WRITES = 1
"""Writes per register. A register that differs after one write refuses the value."""

Wanted = tuple[tuple[int, float], ...]
"""(register, value) in the order of the requests."""


def take(walk: Walk, wanted: Wanted, reply: codec.RegisterReply) -> tuple[Walk, str]:
    """Apply a register reply. Replies to any but the open request, such as late ones, have no effect.

    Args:
        walk: cursor, not beyond the last register.
        wanted: registers with their required values.
        reply: reply of this motor.

    Returns:
        the new cursor, and the problem in words, empty without a problem.
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
    """Return the next register request, if one is due.

    Args:
        walk: cursor, not beyond the last register.
        wanted: registers with their required values.
        node_id: ESC_ID.
        t_ns: time of the tick [ns].

    Returns:
        the new cursor, the payload on BROADCAST_ID, and the problem in words. The payload is empty
        while an answer is awaited, the problem is empty without a problem.
    """
    register, value = wanted[walk.step]
    walk, send, problem = readback.ask(walk, name(register), t_ns)
    operation = codec.WRITE if walk.writing else codec.READ
    return walk, codec.register_request(node_id, operation, register, value) if send else b"", problem


def ask_serial(walk: Walk, node_id: int, t_ns: int) -> tuple[Walk, bytes, bool]:
    """Return the request for the serial number, after all registers are right.

    Returns:
        the new cursor, the payload on BROADCAST_ID (empty while an answer is awaited), and True if the
        motor does not answer.
    """
    walk, send, untold = readback.ask(walk, "serial number", t_ns, SERIAL_TRIES)
    return walk, codec.register_request(node_id, codec.READ, codec.SERIAL) if send else b"", bool(untold)


def name(register: int) -> str:
    """Return the name of a register for messages."""
    return f"register {register} {codec.REGISTER_NAMES[register]}"
