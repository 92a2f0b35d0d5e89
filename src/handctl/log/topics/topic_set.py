"""Set of all topics in a log."""

import numpy as np
from mcap.records import Channel, Schema

from handctl.log.cdr import CdrWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.tick_batch import TickBatch
from handctl.log.topics.can_frame_topics import CanTopics
from handctl.log.topics.clock_pair_topic import ClockTopic
from handctl.log.topics.event_topics import EventTopics
from handctl.log.topics.hash_chain import HashChainTopic
from handctl.log.topics.health_topics import HealthTopics
from handctl.log.topics.message_streams import (
    MessageStamps,
    TopicRegistry,
    single_message_stamps,
    variable_length_block,
)
from handctl.log.topics.snapshot_topic import ControllerSnapshot, SnapshotTopic
from handctl.log.topics.state_topics import StateTopics, encode_statistics_names
from handctl.log.topics.target_topic import TargetTopic
from handctl.log.topics.transform_topics import TfTopics

TICK_TOPIC = "/tick"
VALUES_TOPIC = "/controller/values"
"""Names of the two topics that the log reader needs: ticks and telemetry.

Nearly all other topics can be computed from the ticks, the telemetry and the header of the log.
"""


class TopicSet:
    """Converter from ticks to the messages of all topics.

    The messages do not depend on how the ticks are divided into batches.
    """

    def __init__(self, header: RunHeader) -> None:
        """Register all topics of a run."""
        self._header = header
        self._registry = TopicRegistry()
        self._description = self._registry.register_topic(
            "/robot_description", "std_msgs/String", latched=True
        )
        self._names = self._registry.register_topic(
            "/controller/names", "pal_statistics_msgs/StatisticsNames", latched=True
        )
        self._tick = self._registry.register_topic(TICK_TOPIC, "handctl_msgs/Tick")
        self._tf = TfTopics(header, self._registry)
        self._events = EventTopics(header, self._registry)
        self._parts = (
            StateTopics(header, self._registry), CanTopics(header, self._registry), self._tf, self._events,
            HealthTopics(header, self._registry), TargetTopic(header, self._registry),
        )  # fmt: skip
        self._chain = HashChainTopic(header, self._registry)
        self._clocks = ClockTopic(self._registry)
        self._snapshots = SnapshotTopic(self._registry)

    @property
    def schemas(self) -> list[Schema]:
        """Return the schemas of all topics."""
        return list(self._registry.schemas.values())

    @property
    def channels(self) -> list[Channel]:
        """Return the channels of all topics."""
        return list(self._registry.channels.values())

    def latched_messages(self) -> list[MessageBlock]:
        """Return the messages that are written only once, at the start of the run (time 0)."""
        stamps = MessageStamps(
            np.array([self._header.offset_ns], np.uint64), np.zeros(1, np.uint32)
        )
        names = encode_statistics_names(self._header, *divmod(self._header.offset_ns, 10**9))
        blocks = [
            variable_length_block(self._names, stamps, [names]),
            self._tf.latched_messages(stamps),
            *self._events.latched_messages(stamps),
        ]
        urdf = self._header.attachments.get("hand.urdf")
        if urdf is not None:
            text = CdrWriter()
            text.put_string(urdf.decode())
            blocks.append(
                variable_length_block(self._description, stamps, [text.finished_message()])
            )
        return blocks

    @property
    def last_digest(self) -> bytes:
        """Return the hash of the latest tick in the hash chain."""
        return self._chain.last_hash

    def clock_pair(self, t_ns: int, k: int, wall_ns: int, monotonic_ns: int) -> MessageBlock:
        """Return a message with the readings of the wall clock and the monotonic clock.

        Args:
            t_ns: time of the tick since the start of the run [ns].
            k: number of the tick.
            wall_ns: reading of the wall clock [ns].
            monotonic_ns: reading of the monotonic clock [ns].
        """
        return self._clocks.block(
            single_message_stamps(self._log_ns(t_ns), k), wall_ns, monotonic_ns
        )

    def snapshot(self, t_ns: int, snapshot: ControllerSnapshot) -> MessageBlock:
        """Return a message with the controller's state after the tick at time `t_ns`."""
        return self._snapshots.block(self._log_ns(t_ns), snapshot)

    def _log_ns(self, t_ns: int) -> int:
        """Convert a time since the start of the run to a log time [ns]."""
        return max(t_ns + self._header.offset_ns, 0)

    def blocks(self, batch: TickBatch) -> list[MessageBlock]:
        """Return the messages of all topics for a batch of ticks."""
        log = np.maximum(batch.t_ns + self._header.offset_ns, 0).astype(np.uint64)
        stamps = MessageStamps(log, (batch.k & 0xFFFF_FFFF).astype(np.uint32))
        blocks = [
            variable_length_block(self._tick, stamps, batch.messages),
            *self._chain.blocks(batch, stamps),
        ]
        # If the controller has failed, its numbers can overflow in the calculations of the
        # messages. The log contains the results nevertheless.
        with np.errstate(all="ignore"):
            for topic_writer in self._parts:
                blocks += topic_writer.blocks(batch, stamps)
        return blocks
