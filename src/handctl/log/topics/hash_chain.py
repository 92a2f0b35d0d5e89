"""Hash chain over the ticks of a log.

If any byte of a tick is changed, the stored hash of the tick is no longer correct.

The chain shows if the log was damaged, or if an attached file was replaced. The chain is not a
signature. An attacker who changes the log can compute all hashes again. The last hash is in the end
record of the log. If a copy of the last hash is kept outside the log, any change of the log can be
detected.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from handctl.log.cdr import MessageTemplate, TemplateWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.tick_batch import TickBatch
from handctl.log.topics.message_streams import MessageStamps, MessageStream, TopicRegistry

HASH_CHAIN_TOPIC = "/tick/chain"
HASH_SIZE = 8
"""Size of a chain hash [bytes]."""


def first_hash(
    metadata: Mapping[str, str], gains: Mapping[str, str], attachments: Mapping[str, bytes]
) -> bytes:
    """Compute the first hash of the hash chain.

    The hash covers all data of the header, except the entries about the machine and the date.
    """
    digest = hashlib.blake2b(digest_size=HASH_SIZE)
    texts = {
        f"{group}.{name}": text.encode("utf-8", "backslashreplace")
        for group, table in (("m", metadata), ("g", gains))
        for name, text in table.items()
    }
    # The hashed bytes contain the name and the length of each text before the text. As a result,
    # different sets of texts never give the same bytes.
    for name, data in sorted(
        (texts | {f"a.{name}": data for name, data in attachments.items()}).items()
    ):
        digest.update(f"{name}:{len(data)}:".encode("utf-8", "backslashreplace"))
        digest.update(data)
    return digest.digest()


def first_hash_of_run(header: RunHeader) -> bytes:
    """Return the first hash of a run's hash chain."""
    return first_hash(
        header.metadata,
        header.gains,
        {**header.attachments, "hand.toml": header.hand_toml.encode()},
    )


def tick_hash(previous_hash: bytes, message: bytes, telemetry_bytes: bytes) -> bytes:
    """Compute the hash of a tick in the hash chain.

    Args:
        previous_hash: hash of the previous tick. For the first tick of the run, it is the hash with which
            the chain begins.
        message: the Tick message.
        telemetry_bytes: packed telemetry of the tick.
    """
    return hashlib.blake2b(
        previous_hash + message + telemetry_bytes, digest_size=HASH_SIZE
    ).digest()


def tick_hashes(previous_hash: bytes, ticks: Iterable[tuple[bytes, bytes]]) -> Iterator[bytes]:
    """Yield the chain hashes of consecutive ticks.

    Args:
        previous_hash: hash of the tick before the first of these ticks. For the first tick, the hash with
            which the chain begins.
        ticks: the Tick message and the packed telemetry of each tick.
    """
    for message, numbers in ticks:
        previous_hash = tick_hash(previous_hash, message, numbers)
        yield previous_hash


def hash_chain_message() -> MessageTemplate:
    """Return the template of a handctl_msgs/Chain message."""
    writer = TemplateWriter()
    writer.put_header()
    writer.put_field("digest", "|u1", HASH_SIZE)
    return writer.finished_template()


class HashChainTopic:
    """Topic with the hash of every tick in the hash chain.

    Attributes:
        last_hash: hash of the latest tick in the chain.
    """

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topic, and start the chain with the hash of the header."""
        self._stream = MessageStream(
            registry.register_topic(HASH_CHAIN_TOPIC, "handctl_msgs/Chain"), hash_chain_message()
        )
        self.last_hash = first_hash_of_run(header)

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return messages with the chain hashes of all ticks of a batch."""
        numbers = (row.tobytes() for row in batch.numbers)
        hashes = list(tick_hashes(self.last_hash, zip(batch.messages, numbers, strict=True)))
        self.last_hash = hashes[-1]
        digests: NDArray[np.uint8] = np.frombuffer(b"".join(hashes), np.uint8).reshape(
            -1, HASH_SIZE
        )
        return [self._stream.block(stamps, {"digest": digests})]
