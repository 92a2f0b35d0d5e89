"""Check of the user at the other end of a Unix socket. Only the user of this process and root are trusted.

The folder of the sockets already excludes other users (see ``socket_paths``). As a second
protection, this module checks which user has sent a message. On Linux, the kernel reports which
user has sent a message to a socket. On other systems, this module trusts every sender of a message.
"""

import os
import socket
import struct
import sys

CREDENTIALS_STRUCT = struct.Struct("3i")
"""``struct ucred`` of Linux: process, user, group. Source: man 7 unix."""
IS_LINUX = sys.platform.startswith("linux")
CONTROL_BUFFER_BYTES = socket.CMSG_SPACE(CREDENTIALS_STRUCT.size)
"""Size of a buffer for one control message with credentials [bytes]."""
SO_PASSCRED, SCM_CREDENTIALS, SO_PEERCRED = (getattr(socket, name, 0) for name in
                                             ("SO_PASSCRED", "SCM_CREDENTIALS", "SO_PEERCRED"))  # fmt: skip


def request_sender_credentials(link: socket.socket) -> None:
    """Make the kernel add the user of the sender to every datagram that a socket receives.

    Call this function before the socket is bound.
    """
    if IS_LINUX:
        link.setsockopt(socket.SOL_SOCKET, SO_PASSCRED, 1)


def receive_datagram(link: socket.socket, max_bytes: int) -> tuple[bytes, str, bool]:
    """Receive one datagram from a socket that was prepared with ``request_sender_credentials``.

    Args:
        link: socket to read from.
        max_bytes: size of the buffer [bytes]. A longer datagram is truncated.

    Returns:
        the data, the path of the sender's socket (empty for a socket without a path), and True if
        the sender is trusted.
    """
    if not IS_LINUX:
        data, sender = link.recvfrom(max_bytes)
        return data, sender if isinstance(sender, str) else "", True
    data, ancillary, _, sender = link.recvmsg(max_bytes, CONTROL_BUFFER_BYTES)
    sender_user_ids = [
        CREDENTIALS_STRUCT.unpack(raw_bytes)[1]
        for level, kind, raw_bytes in ancillary
        if (level, kind) == (socket.SOL_SOCKET, SCM_CREDENTIALS)
        and len(raw_bytes) == CREDENTIALS_STRUCT.size
    ]
    return (
        data,
        sender if isinstance(sender, str) else "",
        bool(sender_user_ids) and all(map(is_trusted_user, sender_user_ids)),
    )


def is_served_by_same_user(link: socket.socket) -> bool:
    """Return True if the process that serves a connected stream socket belongs to this user or to root."""
    if not IS_LINUX:
        return True
    raw_bytes = link.getsockopt(socket.SOL_SOCKET, SO_PEERCRED, CREDENTIALS_STRUCT.size)
    return is_trusted_user(CREDENTIALS_STRUCT.unpack(raw_bytes)[1])


def is_trusted_user(user_id: int) -> bool:
    """Return True if a user is root or the user of this process. No other user is allowed to command the hand."""
    return user_id in (0, os.geteuid())
