"""The sensor node on a bus: it answers a SYNC with frames that carry the low four bits of the SYNC's counter.

SYNC is no order to a motor of its own, but it lets CANopen drives act on PDOs that they hold: where one is found, and
beside an ODrive with node number 4, it is not sent (``orders`` of theirs name it). Source: ``node``.
"""

from handctl.drives.discovery import Discovery, Found, Seen
from handctl.drives.frame import Frame

SYNC = 0x080
COUNTERS = (0x35, 0x3A)
"""Two counters, so that four bits cannot agree by chance."""
BITS_HEAD, BITS_CHANNEL = 4, 12
LONGEST = 8


def questions(turn: int, seen: Seen) -> tuple[Frame, ...]:
    """Round 3: two SYNCs."""
    return tuple(ping_with(counter) for counter in COUNTERS) if turn == 3 else ()


def found(seen: Seen) -> tuple[Found, ...]:
    """Identifiers that answered both, the first of a run as one node."""
    ids = sorted({frame.can_id for frame in seen if _answered(seen, frame.can_id)})
    first = [can_id for can_id in ids if can_id - 1 not in ids]
    return tuple(_node(can_id, seen) for can_id in first)


def _answered(seen: Seen, can_id: int) -> bool:
    """Whether an identifier carries just the counters, in their order."""
    told = [frame.data[0] & 0xF for frame in seen if frame.can_id == can_id and 2 <= len(frame.data) <= LONGEST]
    return can_id < SYNC << 3 and told == [counter & 0xF for counter in COUNTERS]


def _node(can_id: int, seen: Seen) -> Found:
    size = next(len(frame.data) for frame in seen if frame.can_id == can_id)
    channels = (8 * size - BITS_HEAD) // BITS_CHANNEL
    note = f"answers SYNC 0x{SYNC:03x}: a sensor node with base_id = 0x{can_id:x} and {channels} channels in a frame?"
    return Found("sensor", can_id, state="answers SYNC", notes=(note,))


def orders(node: Found) -> frozenset[int]:
    """SYNC makes it sample, nothing else."""
    return frozenset()


def foreign(seen: Seen) -> tuple[Frame, ...]:
    """A SYNC of somebody else is CANopen's to tell."""
    return ()


def ping_with(counter: int) -> Frame:
    """SYNC with a counter."""
    return Frame(SYNC, bytes((counter,)))


def ping(node: Found) -> Frame:
    """SYNC."""
    return ping_with(COUNTERS[0])


def pong(node: Found, frame: Frame) -> bool:
    """Whether this is its answer."""
    return frame.can_id == node.node_id and len(frame.data) >= 2 and frame.data[0] & 0xF == COUNTERS[0] & 0xF


DISCOVERY = Discovery(questions, found, orders, foreign, ping, pong)
