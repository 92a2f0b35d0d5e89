"""Python client that moves and observes a running hand.

The guide ``docs/how-to/python.md`` explains the Python client.
"""

from handctl.client.async_hand import AsyncHandClient, AsyncTargetStream, connect_async
from handctl.client.fingertips import Fingertips, FingertipStream
from handctl.client.hand import HandClient, connect
from handctl.client.observation import Observation
from handctl.client.stream import TargetStream

__all__ = [
    "AsyncHandClient",
    "AsyncTargetStream",
    "FingertipStream",
    "Fingertips",
    "HandClient",
    "Observation",
    "TargetStream",
    "connect",
    "connect_async",
]
