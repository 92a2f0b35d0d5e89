"""Check that each identifier on a bus has one sender and one meaning.

The check uses the identifiers that the drives report. A new protocol needs no rule of its own.
"""

from collections.abc import Iterable
from typing import Protocol

from handctl.errors import ConfigError


class Owner(Protocol):
    """Owner of identifiers: a drive, or the sensor node."""

    @property
    def bus(self) -> int:
        """Return the index of the bus."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers sent by the host alone."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers sent by the node."""
        ...


def check_identifiers(owners: Iterable[tuple[str, Owner]]) -> None:
    """Compare the identifiers of every node with those of every other node on its bus.

    Args:
        owners: (key path in the hand file, node).

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
