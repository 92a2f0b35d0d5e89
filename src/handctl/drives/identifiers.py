"""Check that each identifier on a bus has one sender and one meaning.

The check uses the identifiers that each drive object lists, so a new protocol needs no new code
here.
"""

from collections.abc import Iterable
from typing import Protocol

from handctl.errors import ConfigError


class Owner(Protocol):
    """Node that owns identifiers: a drive, or the sensor node."""

    @property
    def bus(self) -> int:
        """Return the index of the bus."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers sent only by the host."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers sent by the node."""
        ...


def check_identifiers(owners: Iterable[tuple[str, Owner]]) -> None:
    """Check that no two nodes on a bus share an identifier.

    Args:
        owners: pairs of the key path in the hand file and the node.

    Raises:
        ConfigError: two nodes share an identifier.
    """
    checked: list[tuple[str, Owner]] = []
    for where, owner in owners:
        for other_where, other in checked:
            if owner.bus == other.bus:
                # Two nodes may listen to one host identifier (NMT, SYNC). An answer identifier must be unique.
                both = owner.node_ids & (other.node_ids | other.host_ids) | owner.host_ids & other.node_ids
                if both:
                    hint = f"another number; {other_where} uses it"
                    raise ConfigError(f"identifier {min(both):#x} has two meanings", where, hint)
        checked.append((where, owner))
