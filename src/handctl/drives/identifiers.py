"""No identifier on a bus may come from two nodes, or be an order to one motor and an answer of another.

Checked on what the drives themselves say, so that a new protocol needs no rule of its own.
"""

from collections.abc import Iterable
from typing import Protocol

from handctl.errors import ConfigError


class Owner(Protocol):
    """A drive, or the sensor node."""

    @property
    def bus(self) -> int: ...
    @property
    def host_ids(self) -> frozenset[int]: ...
    @property
    def node_ids(self) -> frozenset[int]: ...


def check_identifiers(owners: Iterable[tuple[str, Owner]]) -> None:
    """Compare every node with every other.

    Args:
        owners: key path in the hand file, and the node.

    Raises:
        ConfigError: two of them share an identifier.
    """
    known: list[tuple[str, Owner]] = []
    for where, owner in owners:
        for other_where, other in known:
            if owner.bus == other.bus:
                both = owner.node_ids & (other.node_ids | other.host_ids) | owner.host_ids & other.node_ids
                if both:
                    right = f"another number; {other_where} uses it"
                    raise ConfigError(f"identifier {min(both):#x} has two meanings", where, right)
        known.append((where, owner))
