"""Lease of the client that commands the hand: the time for which its last goal is valid without a sign of life."""

from typing import NamedTuple


class Lease(NamedTuple):
    """Lease of a client.

    Attributes:
        client: client that commands the hand.
        duration_ns: longest silence before moving digits come to rest [ns]. After twice this time the
            hand relaxes.
        renewed_ns: time of the last command or sign of life [ns].
        resting: True if the digits have come to rest since then.
    """

    client: str
    duration_ns: int
    renewed_ns: int
    resting: bool = False
