"""Check that each CAN identifier on a bus has only one meaning.

The check uses the lists of identifiers in the drive objects, so that a new drive protocol needs no
new code in this module.
"""

from collections.abc import Iterable
from typing import Protocol

from handctl.errors import ConfigError


class IdentifierOwner(Protocol):
    """Node that has identifiers on a bus: a drive, or the sensor node."""

    @property
    def bus(self) -> int:
        """Return the index of the bus of the node."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from a host to the node."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from the node."""
        ...


def check_identifiers(identifier_owners: Iterable[tuple[str, IdentifierOwner]]) -> None:
    """Check that no two nodes on a bus use the same identifier for different frames.

    Args:
        identifier_owners: a pair for each node: key path of the node's section in the hand file,
            and the node itself.

    Raises:
        ConfigError: two nodes use the same identifier.
    """
    checked_owners: list[tuple[str, IdentifierOwner]] = []
    for location, owner in identifier_owners:
        for other_where, other_owner in checked_owners:
            if owner.bus == other_owner.bus:
                # Two nodes may receive the same frame of the host (NMT, SYNC). The identifier of a
                # frame from a node must be unique on its bus.
                shared_identifiers = (
                    owner.node_ids & (other_owner.node_ids | other_owner.host_ids)
                    | owner.host_ids & other_owner.node_ids
                )
                if shared_identifiers:
                    hint = f"another number; {other_where} uses it"
                    raise ConfigError(
                        f"identifier {min(shared_identifiers):#x} has two meanings", location, hint
                    )
        checked_owners.append((location, owner))
