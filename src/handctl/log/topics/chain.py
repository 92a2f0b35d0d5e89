"""A hash over each tick and the one before it: one changed byte breaks the chain at its tick.

It shows damage and mix-ups; it is no signature, as whoever changes a tick may forge all hashes after it. The last one
is in the log's end record: keep it elsewhere, and the whole log is fixed.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from handctl.log.batch import Batch
from handctl.log.cdr import Template, TemplateWriter
from handctl.log.container import Run
from handctl.log.header import RunHeader
from handctl.log.topics.streams import Registry, Stamps, Stream

TOPIC = "/tick/chain"
SIZE = 8


def seed(metadata: Mapping[str, str], gains: Mapping[str, str], attachments: Mapping[str, bytes]) -> bytes:
    """Hash before the first tick: of all that is known of a run by then, but for the facts of one machine or day."""
    whole = hashlib.blake2b(digest_size=SIZE)
    texts = {
        f"{group}.{name}": text.encode("utf-8", "backslashreplace")
        for group, table in (("m", metadata), ("g", gains))
        for name, text in table.items()
    }
    for name, data in sorted((texts | {f"a.{name}": data for name, data in attachments.items()}).items()):
        whole.update(f"{name}:{len(data)}:".encode("utf-8", "backslashreplace"))
        whole.update(data)
    return whole.digest()


def seed_of(header: RunHeader) -> bytes:
    """The seed of a run."""
    return seed(header.metadata, header.gains, {**header.attachments, "hand.toml": header.hand_toml.encode()})


def link(before: bytes, message: bytes, numbers: bytes) -> bytes:
    """Hash of a tick.

    Args:
        before: hash of the tick before it, or the seed.
        message: the Tick message.
        numbers: telemetry of the tick, as packed.
    """
    return hashlib.blake2b(before + message + numbers, digest_size=SIZE).digest()


def links(before: bytes, ticks: Iterable[tuple[bytes, bytes]]) -> Iterator[bytes]:
    """Hashes of consecutive ticks, each given as its message and its telemetry."""
    for message, numbers in ticks:
        before = link(before, message, numbers)
        yield before


def chain_message() -> Template:
    """A handctl_msgs/Chain."""
    out = TemplateWriter()
    out.header()
    out.place("digest", "|u1", SIZE)
    return out.template()


class ChainTopic:
    """The hash of every tick."""

    def __init__(self, header: RunHeader, registry: Registry) -> None:
        self._stream = Stream(registry.add(TOPIC, "handctl_msgs/Chain"), chain_message())
        self.last = seed_of(header)

    def runs(self, batch: Batch, stamps: Stamps) -> list[Run]:
        """Messages of all ticks of a batch."""
        numbers = (row.tobytes() for row in batch.numbers)
        found = list(links(self.last, zip(batch.messages, numbers, strict=True)))
        self.last = found[-1]
        digests: NDArray[np.uint8] = np.frombuffer(b"".join(found), np.uint8).reshape(-1, SIZE)
        return [self._stream.run(stamps, {"digest": digests})]
