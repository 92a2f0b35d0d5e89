"""Detection of unsolicited and duplicate replies.

A reply is unsolicited or a duplicate if its node has sent more replies than this host has sent
requests to the node. If a motor replies before this host has sent its first request, a second
controller has sent a request to the motor (fault H13). A single reply before the first request of
this host causes the fault H13 (a second controller). If a node sends more replies than it has
received requests, the excess reply is a duplicate (fault B05). If the bytes of the excess reply
differ from the expected reply, another node could use the same identifier (fault B06). A frame
counts as a reply only if the state machine of the drive or of the sensor node accepts the frame as
a reply. Heartbeats and frames with an old counter do not count as replies. The code of the module
runs only in ticks with more replies than requests.
"""

from collections.abc import Sequence

from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.drives.contract import Drive
from handctl.drives.frame import Frame
from handctl.drives.sensors.contract import SensorInterface

LATE_ANSWER_WINDOW_TICKS = 50
"""Number of ticks for which a missing answer can still arrive.

A busy node can answer its queued requests over many ticks.
"""


def detect_unsolicited_replies(
    drives: tuple[Drive, ...],
    sensors: SensorInterface,
    last_state: ControllerState,
    state: ControllerState,
    frames: Sequence[Frame],
) -> tuple[str, ...]:
    """Detect the unsolicited and the duplicate replies of a tick.

    For each node with duplicate replies, the function writes a number into ``DUPLICATE_REPLIES``:
    the kind of the duplicates, from ``_duplicate_kind``.

    Args:
        drives: drives of the hand.
        sensors: sensor node of the hand.
        last_state: state of the controller before the tick.
        state: state of the controller with the data that were received in the tick.
        frames: frames received in the tick.

    Returns:
        One phrase for each motor that has replied without a request.
    """
    duplicates = state.view("twice")
    excess_reply_counts = state.view("surplus").tolist()
    signs = []
    for n, count in enumerate(excess_reply_counts):
        # ``EXCESS_REPLY_COUNT`` contains the number of requests without a reply, plus 1. If a reply
        # arrives while the value of ``EXCESS_REPLY_COUNT`` is 1, there was no request for the
        # reply.
        if count == 1:
            signs.append(f"{drives[n].name} answering it")
        elif count:
            duplicates[n] = _duplicate_kind(
                _accepted_payloads(drives[n], last_state, n, frames), count - 1
            )
    _detect_duplicate_answers(sensors, last_state, state, frames)
    return tuple(signs)


def _detect_duplicate_answers(
    sensors: SensorInterface,
    last_state: ControllerState,
    state: ControllerState,
    frames: Sequence[Frame],
) -> None:
    """Detect duplicate answers of the load cells, and count late answers.

    Duplicate answers are written to ``DUPLICATE_REPLIES``. Late answers are counted in
    ``STALE_FRAME_COUNT``.
    """
    duplicates = state.view("twice")
    is_extra_reply_allowed = not sensors.has_counter and (
        state.run_integers[s.MISSED_TICKS] > 0 or _has_lost_answers(last_state)
    )
    was_group_answered = last_state.view("group_answered").tolist()
    for group, count in enumerate(state.view("group_answered").tolist()):
        if count > 1 and (
            is_extra_reply_allowed or not (sensors.has_counter or was_group_answered[group])
        ):
            state.run_integers[s.STALE_FRAME_COUNT] += count - 1
            state.run_integers[s.STALE_FRAME_STATE] = max(
                state.run_integers[s.STALE_FRAME_STATE], 1
            )
        elif count > 1:
            counter = last_state.run_integers[s.SYNC_COUNTER]
            can_id = sensors.ids[group]
            fresh_payloads = [
                frame.data
                for frame in frames
                if (frame.bus, frame.can_id) == (sensors.bus, can_id)
                and sensors.answers(frame.data, counter)
            ]
            late_count = _count_late_answers(sensors, last_state, counter)
            if len(fresh_payloads) > 1 + late_count:
                duplicates[-1] = max(duplicates[-1], _duplicate_kind(fresh_payloads, 1))


def _count_late_answers(sensors: SensorInterface, last_state: ControllerState, counter: int) -> int:
    """Return how many missing answers would contain the same counter as the answer to the last SYNC.

    After a pause of the bus, missing answers can arrive together with the answer to the last SYNC.
    The counter in an answer has only four bits, so an old answer can contain the same counter.
    """
    lost_bits = _lost_answer_bits(last_state)
    # An answer is counted as missing one or two ticks after its SYNC.
    return sum(
        bool((lost_bits | lost_bits << 1) >> age & 1)
        and sensors.answers(bytes((sensors.counter(last_state.k - age - 1),)), counter)
        for age in range(LATE_ANSWER_WINDOW_TICKS)
    )


def _has_lost_answers(last_state: ControllerState) -> bool:
    """Return True if an answer of the load cells was missing in the last ``LATE_ANSWER_WINDOW_TICKS`` ticks.

    Answers without a counter do not show whether an additional answer is late or a duplicate. If an
    answer was missing before, the controller regards an additional answer as late. The result is
    also True after a tick without an answer of the load cells, and after a tick that this host has
    missed.
    """
    return bool(_lost_answer_bits(last_state) & (1 << LATE_ANSWER_WINDOW_TICKS) - 1)


def _lost_answer_bits(last_state: ControllerState) -> int:
    """Return one bit for each recent tick, which is 1 if an answer of the load cells was missing."""
    return int(last_state.layout.table(last_state.block, "node_int")[s.LOST_REPLY_BITS, -1])


def _duplicate_kind(payloads: list[bytes], expected_count: int) -> int:
    """Return 1 if every excess reply equals the last expected reply, and 2 if any excess reply differs."""
    return 2 if len(set(payloads[expected_count - 1 :])) > 1 else 1


def _accepted_payloads(
    drive: Drive, last_state: ControllerState, n: int, frames: Sequence[Frame]
) -> list[bytes]:
    """Return the payloads that the state machine of a drive accepts as replies, in the order of reception."""
    drive_state = last_state.drive(n)
    payloads = []
    for frame in frames:
        state_after = drive.receive(drive_state, frame)
        payloads += [frame.data] if state_after.feedback_count > drive_state.feedback_count else []
        drive_state = state_after
    return payloads
