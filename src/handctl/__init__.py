"""Hardware-in-the-loop controller and data logger for tendon-driven robot hands."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from handctl.client import HandClient as HandClient
    from handctl.client import connect as connect

__all__ = ["HandClient", "connect"]


def __getattr__(name: str) -> Any:
    """Import the client when it is asked for, so that ``import handctl`` costs nothing."""
    if name not in __all__:
        raise AttributeError(name)
    from handctl import client

    return getattr(client, name)
