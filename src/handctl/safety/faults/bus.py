"""Rows B01 to B18 of the fault catalogue: faults of the bus."""

from handctl.safety.faults.fault import (
    CHECKED_BEFORE_ARMING,
    CHECKED_BY_FAULT_TABLE,
    CLEARED_BY_ITSELF,
    CLEARED_BY_OPERATOR,
    FAULT_PLACE_HAND,
    FAULT_PLACE_MOTOR,
    FAULT_PLACE_NODE,
    INDIRECTLY_VISIBLE,
    INVISIBLE_FAULT,
    declare_catalogue_row,
    declare_fault,
)
from handctl.safety.safety_action import RelaxMethod, SafetyAction
from handctl.safety.safety_limits import LOAD_CELL_NODE_NAME, MAX_SILENCE_S, MIN_SILENT_TICKS

LOSS_WINDOW_TICKS = 100
MALFORMED_WINDOW_TICKS = 20
"""Lengths of the windows in which lost frames, and malformed frames, are counted [ticks]."""
LOST_FRAMES_FOR_HOLD = 20
LOST_FRAMES_FOR_RELAX = 40
"""Limits for the number of lost frames of a node, within ``LOSS_WINDOW_TICKS`` ticks.

The reaction is HOLD above the first limit, and RELAX above the second limit.
"""
MALFORMED_FRAMES_LIMIT = 3
"""Smallest number of malformed frames from a node, within ``MALFORMED_WINDOW_TICKS`` ticks, that is a fault."""
MAX_UNKNOWN_FRAMES_PER_S = 50.0
"""Number of frames with unknown identifiers per second above which there is a fault."""
MISSING_ACKNOWLEDGE_TEXTS = ("no acknowledge", "bus error", "protocol")
"""Texts of the error frames that an interface reports if no node on the bus acknowledges."""

# Texts of the fault catalogue for faults that the messages of a drive protocol do not report.
_MISSING_COUNTER_TEXT = (
    f"{INDIRECTLY_VISIBLE}: load cells by their counter (CiA 404 amplifiers: only by the time of arrival), drives "
    "by N14, because their replies have no counter"
)
_WRONG_ORDER_TEXT = (
    f"{INDIRECTLY_VISIBLE}: load cells by their counter (CiA 404 amplifiers have none), drives "
    "have no counter"
)
_MISSING_CHECKSUM_TEXT = (
    f"{INDIRECTLY_VISIBLE}: by wrong length, NaN and jumps (N05), because payloads have no checksum"
)
_EXCESS_REPLIES_TEXT = f"{INVISIBLE_FAULT}: excess replies look like cyclic messages, which come in addition to replies"
SILENCE_TIME_REASON = (
    "30 ms of silence, because a busy host is sometimes "
    "late. While other motors reply, 4 ticks are enough (B17)"
)
"""Reason for the reaction times of the faults B02 and N02."""
_SILENCE_CONDITION_TEXT = (
    f"for {MAX_SILENCE_S * 1e3:g} ms, at least {MIN_SILENT_TICKS} ticks in a row"
)

declare_catalogue_row("B01", "one frame lost", ticks=2, required_ticks=2)
B01_MISSING_REPLY = declare_fault(
    "B01", "a reply is missing", "The latest feedback of a motor is older than one tick", SafetyAction.WARN,
    CLEARED_BY_ITSELF, FAULT_PLACE_MOTOR,
    cause="A frame was lost, or the motor or this host was late once. The filter bridges single losses.",
    remedy="Ignore single cases. If it repeats, run handctl bus doctor and check cable, termination and bus load.",
)  # fmt: skip

declare_catalogue_row(
    "B02", "several frames in a row lost", ticks=1, ms=30, required_ticks=5, why=SILENCE_TIME_REASON
)
B02_SILENT_MOTOR = declare_fault(
    "B02", "a motor has gone silent", f"A motor sends no reply {_SILENCE_CONDITION_TEXT}", SafetyAction.RELAX,
    CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    caused_by_lateness=True,
    cause="The motor has lost power or its cable, or its drive has crashed.",
    remedy="Check supply and CAN cable of the motor, find it with handctl scan, then start a new run.",
)  # fmt: skip

declare_catalogue_row("B03", "intermittent loss", ticks=102, required_ticks=102)
B03A_LOST_REPLIES = declare_fault(
    "B03a", "replies are being lost",
    f"More than {LOST_FRAMES_FOR_HOLD} of the last {LOSS_WINDOW_TICKS} replies of a node are missing",
    SafetyAction.HOLD, CLEARED_BY_ITSELF, FAULT_PLACE_NODE,
    cause="The bus is disturbed or overloaded, or the host is too slow.",
    remedy="Check termination, shielding and bus load (handctl bus doctor, handctl bus plan), or lower the rate.",
)  # fmt: skip
B03B_MANY_LOST_REPLIES = declare_fault(
    "B03b", "many replies are being lost",
    f"More than {LOST_FRAMES_FOR_RELAX} of the last {LOSS_WINDOW_TICKS} replies of a node are missing",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_NODE,
    caused_by_lateness=True,
    cause="The bus is disturbed or overloaded, or the host is too slow.",
    remedy="Check termination, shielding and bus load (handctl bus doctor, handctl bus plan) before the next run.",
)  # fmt: skip

declare_catalogue_row(
    "B04",
    "delay",
    CHECKED_BY_FAULT_TABLE,
    _MISSING_COUNTER_TEXT,
    _MISSING_COUNTER_TEXT,
    _MISSING_COUNTER_TEXT,
    ticks=4,
    required_ticks=4,
)
B04_DELAYED_FRAME = declare_fault(
    "B04", "a delayed frame", "A load-cell frame replies to an older SYNC",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_HAND, name=LOAD_CELL_NODE_NAME,
    cause="The sensor node or a gateway on the bus holds frames back.",
    remedy="Look for gateways, full queues and a busy sensor node between the load cells and the host.",
)  # fmt: skip

declare_catalogue_row(
    "B05", "duplicate, equal bytes", odrive=_EXCESS_REPLIES_TEXT, ticks=2, required_ticks=2
)
B05_DUPLICATE_FRAME = declare_fault(
    "B05", "a duplicate frame", "A node sends more replies than requests, and the replies have equal bytes",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_NODE,
    cause="An adapter or gateway repeats frames, or two nodes share an identifier.",
    remedy="Check the adapter's driver and settings, and the identifiers of all nodes with handctl scan.",
)  # fmt: skip

declare_catalogue_row(
    "B06", "duplicate, different bytes", odrive=_EXCESS_REPLIES_TEXT, ticks=2, required_ticks=2
)
B06_CONFLICTING_FRAMES = declare_fault(
    "B06", "a conflicting duplicate frame",
    "A node sends more replies than requests, and the replies have different bytes",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_NODE, relax_method=RelaxMethod.OPEN_LOOP,
    cause="Two nodes reply with one identifier, or a second program sends on the bus (masquerade).",
    remedy="Disconnect other programs and nodes, check all identifiers with handctl scan, then start a new run.",
)  # fmt: skip

declare_catalogue_row(
    "B07",
    "reordering",
    CHECKED_BY_FAULT_TABLE,
    _WRONG_ORDER_TEXT,
    _WRONG_ORDER_TEXT,
    _WRONG_ORDER_TEXT,
    ticks=2,
    required_ticks=2,
)
B07_WRONG_FRAME_ORDER = declare_fault(
    "B07", "frames arrive out of order", "An old load-cell frame arrives after a newer one",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_HAND, name=LOAD_CELL_NODE_NAME,
    cause="The adapter or a gateway reorders frames.",
    remedy="Use an adapter and driver that keep the order. Remove gateways between host and hand.",
)  # fmt: skip

declare_catalogue_row(
    "B08",
    "corruption above the CAN CRC",
    CHECKED_BY_FAULT_TABLE,
    _MISSING_CHECKSUM_TEXT,
    _MISSING_CHECKSUM_TEXT,
    _MISSING_CHECKSUM_TEXT,
    ticks=4,
    required_ticks=4,
)
B08_CORRUPT_PAYLOADS = declare_fault(
    "B08", "corrupt payloads",
    f"In {MALFORMED_WINDOW_TICKS} ticks, {MALFORMED_FRAMES_LIMIT} frames of a node cannot be decoded",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_NODE,
    cause="The node's firmware, or a gateway, sends wrong bytes. The CAN checksum is correct.",
    remedy="Check protocol option and firmware of the node in the hand file. Replace the node if it continues.",
)  # fmt: skip

declare_catalogue_row("B09", "wrong length, RTR, 29 bit, FD", ticks=2, required_ticks=2)
B09_MALFORMED_FRAME = declare_fault(
    "B09", "a malformed frame", "A frame has a wrong length, is a remote frame, has 29 bits, or contains no number",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_NODE,
    cause="A node sends another protocol or another message length than the hand file says.",
    remedy="Check the motor's protocol and options in the hand file against handctl scan.",
)  # fmt: skip

declare_catalogue_row("B10", "unknown identifiers", ticks=2, ms=51, required_ticks=2,
    why="51 unknown frames within a second are the limit. With one frame per millisecond this takes 51 ms")  # fmt: skip
B10_UNKNOWN_IDENTIFIERS = declare_fault(
    "B10", "unknown identifiers on the bus",
    f"More than {MAX_UNKNOWN_FRAMES_PER_S:g} frames per second have an unassigned identifier",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_HAND, name="bus",
    cause="Other devices share the bus, or a motor has another identifier than the hand file says.",
    remedy="Compare handctl scan with the hand file. Move other devices to a bus of their own.",
)  # fmt: skip

declare_catalogue_row("B11", "babbling idiot", ticks=3, required_ticks=3)
B11A_FLOODED_BUS = declare_fault(
    "B11a", "the bus is flooded", "In two ticks, more frames arrive than all nodes can send",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_HAND, debounce_ticks=2, name="bus",
    cause="A node or another program sends without pause (babbling idiot).",
    remedy="Unplug one node after the other until the traffic stops. Replace or reconfigure the last one.",
)  # fmt: skip
# B11b is the second stage of the fault B11a. The fault B11b has the same condition as the fault
# B11a, but a longer debounce.
B11B_LASTING_FLOOD = declare_fault(
    "B11b", "the bus stays flooded", "In ten ticks, more frames arrive than all nodes can send",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, FAULT_PLACE_HAND, debounce_ticks=10, name="bus",
    cause="A node or another program sends without pause (babbling idiot), so that commands may not arrive.",
    remedy="Remove the power. Unplug one node after the other until the traffic stops, and replace the last one.",
)  # fmt: skip

declare_catalogue_row("B12", "bus off", ticks=1, required_ticks=1)
declare_fault(
    "B12", "bus off", "The interface reports bus-off", SafetyAction.CUT, CLEARED_BY_OPERATOR, reports=("bus_off",),
    cause="A short circuit, a wrong bit rate or the lack of other nodes caused too many errors, and the interface "
    "stopped.",
    remedy="Check cable, termination and bit rate, then bring the interface up again (handctl bus doctor says how).",
)  # fmt: skip

declare_catalogue_row("B13", "error-warning, error-passive", ticks=21, required_ticks=21)
declare_fault(
    "B13a", "errors on the bus", "The interface reports error-warning or error-passive",
    SafetyAction.WARN, CLEARED_BY_ITSELF, reports=("error_warning", "error_passive"),
    cause="A plug is loose, a termination is missing, or a long cable has no shield.",
    remedy="Check plugs and termination (60 ohm between CANH and CANL), and run handctl bus doctor.",
)  # fmt: skip
declare_fault(
    "B13b", "lasting errors on the bus", "The interface is error-passive for 20 ticks",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, debounce_ticks=20, reports=("error_passive",),
    cause="A plug is loose, a termination is missing, a bit rate is wrong, or a node has lost power.",
    remedy="Check plugs, termination (60 ohm) and bit rate of all nodes, and run handctl bus doctor.",
)  # fmt: skip

declare_catalogue_row("B14", "interface down", ticks=1, required_ticks=1)
declare_fault(
    "B14", "the CAN interface is down", "The interface is down",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, reports=("enetdown",),
    cause="The interface was shut down by a command or by the system.",
    remedy="Bring the interface up again (handctl bus doctor prints the command), then start a new run.",
)  # fmt: skip

declare_catalogue_row("B15", "send queue full", ticks=3, required_ticks=3)
declare_fault(
    "B15", "the send queue is full", "The interface refuses frames in two ticks",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, debounce_ticks=2, reports=("enobufs",),
    cause="The bus is overloaded, or no node acknowledges frames.",
    remedy="Check the bus load with handctl bus plan, and power and cable of the nodes.",
)  # fmt: skip

declare_catalogue_row("B16", "adapter unplugged", ticks=1, required_ticks=1)
declare_fault(
    "B16", "the CAN adapter is unplugged", "The interface no longer exists",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, reports=("enodev", "ebadf"),
    cause="The USB plug or its cable is loose, or the adapter has crashed.",
    remedy="Plug the adapter in and secure the cable. Bring the interface up, then start a new run.",
)  # fmt: skip

declare_catalogue_row("B17", "some nodes do not hear", CHECKED_BY_FAULT_TABLE,
    f"{INDIRECTLY_VISIBLE}: no reply for four ticks while others reply",
    f"{INDIRECTLY_VISIBLE}: by counted losses (B03) or by its watchdog (N08), because its cyclic messages continue",
    f"{INDIRECTLY_VISIBLE}: by the drive's timeout of the master (N08), because RPDOs are not confirmed",
    ticks=4, odrive_extra_ms=160, required_ticks=4)  # fmt: skip
B17_DEAF_NODES = declare_fault(
    "B17", "some nodes do not hear",
    f"A motor sends no reply in {MIN_SILENT_TICKS} ticks in a row, while other motors reply",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    caused_by_lateness=True,
    cause="One motor's cable, supply or drive has failed, or one branch of the bus is disturbed.",
    remedy="Check plug, cable and supply of this motor, then start a new run.",
)  # fmt: skip

declare_catalogue_row(
    "B18",
    "alone on the bus",
    CHECKED_BEFORE_ARMING,
    tested_by="tests/safety/test_reported_faults.py",
)
declare_fault(
    "B18", "alone on the bus", "The interface reports error frames, and no node replies before arming",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, debounce_ticks=20, reports=("error_frame",),
    cause="The bit rate is wrong, the hand has no power, or a cable is not connected.",
    remedy="Switch the hand on, check cable and bit rate, and run handctl bus doctor.",
)  # fmt: skip
