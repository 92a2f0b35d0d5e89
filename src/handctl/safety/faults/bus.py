"""Rows B01 to B18: faults of the bus."""

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import (
    ARMING,
    HAND,
    ITSELF,
    LOST,
    MOTOR,
    NODE,
    OPERATOR,
    REPLACED,
    TICK,
    fault,
    row,
)
from handctl.safety.limits import LOAD_CELLS, MIN_SILENT_TICKS, SILENT_S

WINDOW = 100
SHORT = 20
"""Windows in which lost frames and malformed frames are counted [ticks]."""
HOLD_LOSSES = 20
RELAX_LOSSES = 40
"""Lost frames within ``WINDOW`` ticks above which the reaction is HOLD, and above which RELAX."""
MALFORMED_LIMIT = 3
"""Number of malformed frames from a node within ``SHORT`` ticks for a fault."""
UNKNOWN_LIMIT = 50.0
"""Number of frames with unknown identifiers per second for a fault."""
UNANSWERED = ("no acknowledge", "bus error", "protocol")
"""Texts of the error frames sent when no node on the bus acknowledges."""

# Texts of the catalogue's columns for protocols without a direct sign.
_COUNTER = f"{REPLACED}: load cells by their counter, drives by N14, because their replies have no counter"
_ORDER = f"{REPLACED}: load cells by their counter, drives have no counter"
_CRC = f"{REPLACED}: no checksum in the payload, but wrong length, NaN and jumps (N05) are detected"
_BESIDE = f"{LOST}: cyclic messages come in addition to replies"
SILENT_WHY = "30 ms of silence, because a busy host is late now and then. While other motors reply it is 4 ticks (B17)"
_SILENCE = f"for {SILENT_S * 1e3:g} ms, at least {MIN_SILENT_TICKS} ticks in a row"

row("B01", "one frame lost", ticks=2, required=2)
B01 = fault(
    "B01", "a reply is missing", "feedback older than one tick", Action.WARN, ITSELF, MOTOR,
    cause="A frame was lost, or the motor or this host was late once. Single losses do no harm: the filter predicts.",
    remedy="Ignore single cases. If it repeats, run handctl bus doctor and check cable, termination and bus load.",
)  # fmt: skip

row("B02", "several frames in a row lost", ticks=1, ms=30, required=5, why=SILENT_WHY)
B02 = fault(
    "B02", "a motor has gone silent", f"no reply {_SILENCE}", Action.RELAX, OPERATOR, MOTOR,
    cause="The motor has lost power or its cable, or its drive has crashed.",
    remedy="Check supply and CAN cable of the motor, find it with handctl scan, then start a new run.",
)  # fmt: skip

row("B03", "intermittent loss", ticks=102, required=102)
B03A = fault(
    "B03a", "replies are being lost", f"more than {HOLD_LOSSES} of the last {WINDOW} missing",
    Action.HOLD, ITSELF, NODE,
    cause="The bus is disturbed or overloaded, or the host is too slow.",
    remedy="Check termination, shielding and bus load (handctl bus doctor, handctl bus plan), or lower the rate.",
)  # fmt: skip
B03B = fault(
    "B03b", "many replies are being lost", f"more than {RELAX_LOSSES} of the last {WINDOW} missing",
    Action.RELAX, OPERATOR, NODE,
    cause="The bus is disturbed or overloaded, or the host is too slow.",
    remedy="Check termination, shielding and bus load (handctl bus doctor, handctl bus plan) before the next run.",
)  # fmt: skip

row("B04", "delay", TICK, _COUNTER, _COUNTER, _COUNTER, ticks=4, required=4)
B04 = fault(
    "B04", "a delayed frame", "a load-cell reply to an older SYNC",
    Action.WARN, ITSELF, HAND, name=LOAD_CELLS,
    cause="The sensor node or a gateway on the bus holds frames back.",
    remedy="Look for gateways, full queues and a busy sensor node. Shorten the way of the frames.",
)  # fmt: skip

row("B05", "duplicate, equal bytes", odrive=_BESIDE, ticks=2, required=2)
B05 = fault(
    "B05", "a duplicate frame", "more replies than requests, with equal bytes",
    Action.WARN, ITSELF, NODE,
    cause="An adapter or gateway repeats frames, or two nodes share an identifier.",
    remedy="Check the adapter's driver and settings, and the identifiers of all nodes with handctl scan.",
)  # fmt: skip

row("B06", "duplicate, different bytes", odrive=_BESIDE, ticks=2, required=2)
B06 = fault(
    "B06", "a conflicting duplicate frame", "more replies than requests, with different bytes",
    Action.RELAX, OPERATOR, NODE, release=Release.OPEN,
    cause="Two nodes reply with one identifier, or a second program sends on the bus (masquerade).",
    remedy="Disconnect other programs and nodes, check all identifiers with handctl scan, then start a new run.",
)  # fmt: skip

row("B07", "reordering", TICK, _ORDER, _ORDER, _ORDER, ticks=2, required=2)
B07 = fault(
    "B07", "frames arrive out of order", "a stale load-cell frame arrives after the fresh one",
    Action.WARN, ITSELF, HAND, name=LOAD_CELLS,
    cause="The adapter or a gateway reorders frames.",
    remedy="Use an adapter and driver that keep the order. Remove gateways between host and hand.",
)  # fmt: skip

row("B08", "corruption above the CAN CRC", TICK, _CRC, _CRC, _CRC, ticks=4, required=4)
B08 = fault(
    "B08", "corrupt payloads", f"{MALFORMED_LIMIT} frames of a node in {SHORT} ticks cannot be decoded",
    Action.RELAX, OPERATOR, NODE,
    cause="The node's firmware, or a gateway, sends wrong bytes. The CAN checksum is correct.",
    remedy="Check protocol option and firmware of the node in the hand file. Replace the node if it continues.",
)  # fmt: skip

row("B09", "wrong length, RTR, 29 bit, FD", ticks=2, required=2)
B09 = fault(
    "B09", "a malformed frame", "wrong length, RTR, 29 bit, or values that are not numbers",
    Action.WARN, ITSELF, NODE,
    cause="A node sends another protocol or another message length than the hand file says.",
    remedy="Check the motor's protocol and options in the hand file against handctl scan.",
)  # fmt: skip

row("B10", "unknown identifiers", ticks=2, ms=51, required=2,
    why="counted from the first unknown frame, at one per millisecond. The limit is 51 within a second")  # fmt: skip
B10 = fault(
    "B10", "unknown identifiers on the bus",
    f"more than {UNKNOWN_LIMIT:g} frames a second with unassigned identifiers",
    Action.WARN, ITSELF, HAND, name="bus",
    cause="Other devices share the bus, or a motor has another identifier than the hand file says.",
    remedy="Compare handctl scan with the hand file. Move other devices to a bus of their own.",
)  # fmt: skip

row("B11", "babbling idiot", ticks=3, required=3)
B11A = fault(
    "B11a", "the bus is flooded", "more frames than all nodes can send, in two ticks",
    Action.RELAX, OPERATOR, HAND, debounce=2, name="bus",
    cause="A node or another program sends without pause (babbling idiot).",
    remedy="Unplug nodes one after the other until the traffic stops, and replace or reconfigure that node.",
)  # fmt: skip
# Same condition as B11a. The longer debounce makes it the second stage.
B11B = fault(
    "B11b", "the bus stays flooded", "the same for ten ticks",
    Action.CUT, OPERATOR, HAND, debounce=10, name="bus",
    cause="A node or another program sends without pause (babbling idiot). Commands may not arrive.",
    remedy="Remove power, unplug nodes one after the other until the traffic stops, and replace that node.",
)  # fmt: skip

row("B12", "bus off", ticks=1, required=1)
fault(
    "B12", "bus off", "the interface reports bus-off", Action.CUT, OPERATOR, reports=("bus_off",),
    cause="Short circuit, wrong bit rate, or no other node: the interface has stopped after too many errors.",
    remedy="Check cable, termination and bit rate, then bring the interface up again (handctl bus doctor says how).",
)  # fmt: skip

row("B13", "error-warning, error-passive", ticks=21, required=21)
fault(
    "B13a", "errors on the bus", "the interface reports error-warning or error-passive",
    Action.WARN, ITSELF, reports=("error_warning", "error_passive"),
    cause="A loose plug, missing termination, or a long unshielded cable.",
    remedy="Check plugs and termination (60 ohm between CANH and CANL), and run handctl bus doctor.",
)  # fmt: skip
fault(
    "B13b", "lasting errors on the bus", "the interface is error-passive for 20 ticks",
    Action.RELAX, OPERATOR, debounce=20, reports=("error_passive",),
    cause="A loose plug, missing termination, a wrong bit rate, or a node that has lost power.",
    remedy="Check plugs, termination (60 ohm) and bit rate of all nodes, and run handctl bus doctor.",
)  # fmt: skip

row("B14", "interface down", ticks=1, required=1)
fault(
    "B14", "the CAN interface is down", "the interface is down",
    Action.CUT, OPERATOR, reports=("enetdown",),
    cause="The interface was shut down by a command or by the system.",
    remedy="Bring the interface up again (handctl bus doctor prints the command), then start a new run.",
)  # fmt: skip

row("B15", "send queue full", ticks=3, required=3)
fault(
    "B15", "the send queue is full", "the interface refuses frames in two ticks",
    Action.RELAX, OPERATOR, debounce=2, reports=("enobufs",),
    cause="The bus is overloaded, or no node acknowledges frames.",
    remedy="Check the bus load with handctl bus plan, and power and cable of the nodes.",
)  # fmt: skip

row("B16", "adapter unplugged", ticks=1, required=1)
fault(
    "B16", "the CAN adapter is unplugged", "the interface no longer exists",
    Action.CUT, OPERATOR, reports=("enodev", "ebadf"),
    cause="The USB plug or its cable is loose, or the adapter has crashed.",
    remedy="Plug the adapter in and secure the cable. Bring the interface up, then start a new run.",
)  # fmt: skip

row("B17", "some nodes do not hear", TICK, f"{REPLACED}: no reply for four ticks while others reply",
    f"{REPLACED}: its cyclic messages continue. Counted losses (B03), or its watchdog (N08) by the heartbeat",
    f"{REPLACED}: RPDOs are not confirmed. The drive's timeout of the master (N08)",
    ticks=4, odrive_ms=160, required=4)  # fmt: skip
B17 = fault(
    "B17", "some nodes do not hear", f"a motor misses {MIN_SILENT_TICKS} ticks in a row while others reply",
    Action.RELAX, OPERATOR, MOTOR,
    cause="One motor's cable, supply or drive has failed, or one branch of the bus is disturbed.",
    remedy="Check plug, cable and supply of this motor, then start a new run.",
)  # fmt: skip

row("B18", "alone on the bus", ARMING, tested="tests/safety/test_reported.py")
fault(
    "B18", "alone on the bus", "error frames and no reply, before arming",
    Action.RELAX, OPERATOR, debounce=20, reports=("error_frame",),
    cause="Wrong bit rate, missing supply of the hand, or a cable that is not connected.",
    remedy="Switch the hand on, check cable and bit rate, and run handctl bus doctor.",
)  # fmt: skip
