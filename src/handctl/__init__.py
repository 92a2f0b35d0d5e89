"""Controller and data logger for tendon-driven robot hands, with hardware in the loop."""

from typing import TYPE_CHECKING, Any

from handctl.errors import (
    BusError,
    ConfigError,
    DriveError,
    HandctlError,
    LogError,
    PowerError,
    UnconfirmedError,
)

if TYPE_CHECKING:
    from handctl.client import AsyncHandClient as AsyncHandClient
    from handctl.client import AsyncTargetStream as AsyncTargetStream
    from handctl.client import HandClient as HandClient
    from handctl.client import Observation as Observation
    from handctl.client import TargetStream as TargetStream
    from handctl.client import connect as connect
    from handctl.client import connect_async as connect_async

__all__ = [
    "AsyncHandClient",
    "AsyncTargetStream",
    "BusError",
    "ConfigError",
    "DriveError",
    "HandClient",
    "HandctlError",
    "LogError",
    "Observation",
    "PowerError",
    "TargetStream",
    "UnconfirmedError",
    "connect",
    "connect_async",
]


def __getattr__(name: str) -> Any:
    """Import the client only when a program first uses the client, so that ``import handctl`` is fast."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from handctl import client

    return getattr(client, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
