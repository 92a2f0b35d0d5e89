"""Search for the damage in a log that the log reader refuses to read.

The search finds the first tick of the log in which a byte was changed.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from handctl.errors import LogError
from handctl.log.read.chunk_reader import iter_messages, schemas_and_channels
from handctl.log.read.logfile import ChunkLocation, LogErrorContext, LogFile
from handctl.log.read.reader import VALUES_END_OFFSET, VALUES_START_OFFSET
from handctl.log.read.record_scan import RecordScan
from handctl.log.read.recover import scan_damaged
from handctl.log.topics.hash_chain import HASH_CHAIN_TOPIC, HASH_SIZE, tick_hash
from handctl.log.topics.topic_set import TICK_TOPIC, VALUES_TOPIC

MISSING_CHANNEL_ID = -1
"""Channel number of a topic that the log lacks.

Logs of earlier versions of handctl, for example, lack the topic of the hash chain.
"""


class _StoredTick(NamedTuple):
    """Tick as it is stored in a log: number, Tick message, packed telemetry, and hash in the hash chain."""

    k: int
    message: bytes
    telemetry: bytes
    chain_hash: bytes


def describe_damaged_log(path: Path) -> str:
    """Return a text that describes the first damage of a log, and names the first wrong tick.

    If the log has no damage, the returned text is empty.

    Even if somebody has changed a tick and adjusted the checksums of the file, the hash chain shows
    the change. If all hashes of the chain are right, the damage lies in topics that are computed
    from the ticks. For damage in these topics, the returned text names the ticks in the damaged
    chunk of the file.

    Raises:
        LogError: the file is not a log of handctl.
    """
    file = LogFile(path)
    scan = RecordScan()
    try:
        scan_damaged(file, scan)
        channels: tuple[int, ...] = ()
        previous_bytes = b""
        for chunk in scan.chunks:
            content, defect_text = _intact_content(file, chunk)
            try:
                with LogErrorContext(file.position_text(chunk.offset)):
                    channels = channels or _channel_ids(content)
                    ticks = list(_chunk_ticks(content, chunk, channels))
            except LogError as error:
                return f"{error}; its chunk begins {_last_intact_tick_text(previous_bytes)}"
            for tick in ticks:
                if (
                    previous_bytes
                    and tick.chain_hash
                    and tick_hash(previous_bytes[-HASH_SIZE:], tick.message, tick.telemetry)
                    != tick.chain_hash
                ):
                    return f"tick {tick.k} was changed after it was written" + (
                        f": {defect_text}" if defect_text else ""
                    )
                previous_bytes = tick.k.to_bytes(8, "little") + tick.chain_hash
            if defect_text:
                location = _tick_range_text(ticks)
                return f"{defect_text}; its ticks are intact, the topics derived from them are damaged: {location}"
        return ""
    finally:
        file.close()


def _intact_content(file: LogFile, chunk: ChunkLocation) -> tuple[bytes, str]:
    """Return the part of a chunk that can be decompressed, and a text that describes the defect of the chunk."""
    try:
        return file.chunk_content(chunk), ""
    except LogError as error:
        defect_text = str(error)
    try:
        return file.chunk_content(chunk, is_checked=False), defect_text
    except LogError:
        return b"", defect_text


def _channel_ids(content: bytes) -> tuple[int, ...]:
    """Return the channel numbers of the tick messages, the telemetry and the chain hashes in a chunk."""
    channels = {topic: number for number, _, topic, _, _ in schemas_and_channels(content).channels}
    return tuple(
        channels.get(topic, MISSING_CHANNEL_ID)
        for topic in (TICK_TOPIC, VALUES_TOPIC, HASH_CHAIN_TOPIC)
    )


def _chunk_ticks(
    content: bytes, chunk: ChunkLocation, channels: tuple[int, ...]
) -> Iterator[_StoredTick]:
    """Yield the ticks that a chunk contains.

    Raises:
        ValueError: the chunk is empty, or the numbers of ticks, telemetry messages and hashes in
            the chunk differ.
    """
    if not content:
        raise ValueError("a chunk that cannot be unpacked")
    rows_by_channel: dict[int, list[bytes]] = {channel: [] for channel in channels}
    for rows_of_channel in iter_messages(
        content, chunk.end - chunk.data_offset, frozenset(channels)
    ):
        rows_by_channel[rows_of_channel.channel] += [
            row.tobytes() for row in rows_of_channel.data()
        ]
    messages, values_of, digests = (rows_by_channel[channel] for channel in channels)
    if channels[2] == MISSING_CHANNEL_ID:
        digests = [b""] * len(messages)
    for message, values, digest in zip(messages, values_of, digests, strict=True):
        # In the Tick message, the tick number comes after the four bytes that CDR puts before all
        # data.
        k = int.from_bytes(message[4:12], "little", signed=True)
        yield _StoredTick(
            k, message, values[VALUES_START_OFFSET:VALUES_END_OFFSET], digest[-HASH_SIZE:]
        )


def _last_intact_tick_text(intact_content: bytes) -> str:
    """Return a text that names the last intact tick before the damage."""
    return (
        f"after tick {int.from_bytes(intact_content[:8], 'little', signed=True)}"
        if intact_content
        else "before the first tick"
    )


def _tick_range_text(stored_ticks: list[_StoredTick]) -> str:
    """Return a text with the first and the last tick of a chunk."""
    return (
        f"ticks {stored_ticks[0].k} to {stored_ticks[-1].k}"
        if stored_ticks
        else "before the first tick"
    )
