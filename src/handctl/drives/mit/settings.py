"""Read-back of the registers of a Damiao motor before arming.

The host reads each register, corrects a wrong value, and reads the register again.
"""

from handctl.drives import readback
from handctl.drives.mit import codec
from handctl.drives.readback import ReadbackCursor

SERIAL_NUMBER_TRIES = 3
"""Largest number of requests for the serial number. Some motors have no register with the serial number."""
WRITE_TRIES = 1
"""Largest number of writes per register.

If a register still has a wrong value after one write, the motor has refused the value.
"""

RequiredRegisters = tuple[tuple[int, float], ...]
"""Registers with the required values, as pairs (register, value), in the order of the requests."""


def on_reply(
    cursor: ReadbackCursor, required: RequiredRegisters, reply: codec.RegisterReply
) -> tuple[ReadbackCursor, str]:
    """Advance the read-back of a motor's registers by a register reply.

    A register reply that answers another request has no effect.

    Args:
        cursor: position in the read-back, not beyond the last register.
        required: registers with the required values.
        reply: register reply of this motor.

    Returns:
        The new position in the read-back, and the problem in words (empty if there is no problem).
    """
    register, value = required[cursor.step]
    if not cursor.is_waiting or reply[:2] != (
        codec.WRITE if cursor.must_write else codec.READ,
        register,
    ):
        return cursor, ""
    if cursor.must_write:
        return cursor.cursor_after_write(), ""
    if reply.raw == codec.register_bytes(register, value):
        return cursor.next_setting(), ""
    return readback.cursor_after_wrong_value(
        cursor, register_name(register), f"{reply.value:g}", f"{value:g}", WRITE_TRIES
    )


def next_request(
    cursor: ReadbackCursor, required: RequiredRegisters, node_id: int, t_ns: int
) -> tuple[ReadbackCursor, bytes, str]:
    """Return the next register request of the read-back, if a request is due.

    Args:
        cursor: position in the read-back, not beyond the last register.
        required: registers with the required values.
        node_id: node number of the motor, ESC_ID.
        t_ns: time of the tick [ns].

    Returns:
        the new cursor, the payload for a frame with BROADCAST_ID, and the problem in words. The
        payload is empty while the host waits for an answer of the drive. The text of the problem is
        empty if no problem has occurred.
    """
    register, value = required[cursor.step]
    cursor, must_send, problem = readback.request_setting(cursor, register_name(register), t_ns)
    operation = codec.WRITE if cursor.must_write else codec.READ
    return (
        cursor,
        codec.register_request(node_id, operation, register, value) if must_send else b"",
        problem,
    )


def next_serial_request(
    cursor: ReadbackCursor, node_id: int, t_ns: int
) -> tuple[ReadbackCursor, bytes, bool]:
    """Return the request for the serial number, which is sent after the read-back of all registers.

    Returns:
        the new cursor, the payload for a frame with BROADCAST_ID (empty while the host waits for an
        answer), and True if the motor does not answer.
    """
    cursor, must_send, unanswered = readback.request_setting(
        cursor, "serial number", t_ns, SERIAL_NUMBER_TRIES
    )
    return (
        cursor,
        codec.register_request(node_id, codec.READ, codec.SERIAL_NUMBER) if must_send else b"",
        bool(unanswered),
    )


def register_name(register: int) -> str:
    """Return the name of a register for messages to the operator."""
    return f"register {register} {codec.REGISTER_NAMES[register]}"
