"""Which tick a changed byte belongs to, in a log that the reader refuses for it."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from handctl.errors import LogError
from handctl.log.read.logfile import ChunkPlace, LogFile, Reading
from handctl.log.read.messages_in import definitions, rows
from handctl.log.read.reader import VALUES_END, VALUES_START
from handctl.log.read.recover import scan_all
from handctl.log.read.scan import Scan
from handctl.log.topics.all import TICK_TOPIC, VALUES_TOPIC
from handctl.log.topics.chain import SIZE, TOPIC, link

ABSENT = -1
"""Channel of a topic that a log does not have: one of a version without the chain."""


class _Tick(NamedTuple):
    k: int
    message: bytes
    numbers: bytes
    digest: bytes


def first_damage(path: Path) -> str:
    """Where the first chunk of a log is damaged, with its first wrong tick; empty if all chunks are what was written.

    The hash chain tells the tick, even where the checksums were made to fit. If it holds, the damage is in what was
    made from the ticks, and the chunk is named by its ticks.

    Raises:
        LogError: it is no log at all.
    """
    file, found = LogFile(path), Scan()
    try:
        scan_all(file, found)
        channels: tuple[int, ...] = ()
        before = b""
        for place in found.chunks:
            content, told = _content(file, place)
            try:
                with Reading(file.at(place.offset)):
                    channels = channels or _channels(content)
                    ticks = list(_ticks(content, place, channels))
            except LogError as error:
                return f"{error}; its chunk begins {_after(before)}"
            for tick in ticks:
                if before and tick.digest and link(before[-SIZE:], tick.message, tick.numbers) != tick.digest:
                    return f"tick {tick.k} is not what was written" + (f": {told}" if told else "")
                before = tick.k.to_bytes(8, "little") + tick.digest
            if told:
                return f"{told}; its ticks are intact, what was made from them is not: {_span(ticks)}"
        return ""
    finally:
        file.close()


def _content(file: LogFile, place: ChunkPlace) -> tuple[bytes, str]:
    """A chunk as far as it can be unpacked, and what is wrong with it."""
    try:
        return file.content(place), ""
    except LogError as error:
        told = str(error)
    try:
        return file.content(place, checked=False), told
    except LogError:
        return b"", told


def _channels(content: bytes) -> tuple[int, ...]:
    known = {topic: number for number, _, topic, _, _ in definitions(content).channels}
    return tuple(known.get(topic, ABSENT) for topic in (TICK_TOPIC, VALUES_TOPIC, TOPIC))


def _ticks(content: bytes, place: ChunkPlace, channels: tuple[int, ...]) -> Iterator[_Tick]:
    """Ticks of a chunk.

    Raises:
        ValueError: there is nothing in it, or not the same number of each.
    """
    if not content:
        raise ValueError("a chunk that cannot be unpacked")
    parts: dict[int, list[bytes]] = {channel: [] for channel in channels}
    for one in rows(content, place.end - place.data, frozenset(channels)):
        parts[one.channel] += [row.tobytes() for row in one.data()]
    messages, values_of, digests = (parts[channel] for channel in channels)
    if channels[2] == ABSENT:
        digests = [b""] * len(messages)
    for message, values, digest in zip(messages, values_of, digests, strict=True):
        k = int.from_bytes(message[4:12], "little", signed=True)
        yield _Tick(k, message, values[VALUES_START:VALUES_END], digest[-SIZE:])


def _after(before: bytes) -> str:
    return f"after tick {int.from_bytes(before[:8], 'little', signed=True)}" if before else "before the first tick"


def _span(ticks: list[_Tick]) -> str:
    return f"ticks {ticks[0].k} to {ticks[-1].k}" if ticks else "before the first tick"
