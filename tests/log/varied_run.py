"""A short generated run with every kind of content that a log can have."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import synthetic_run

from handctl.core.tick_types import (
    TELEMETRY_AXES,
    HandMode,
    IoEvent,
    StreamTarget,
    Telemetry,
    TickEvent,
    TickIn,
    TickOut,
)
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import BRS, ERROR_FLAG, ESI, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.log.header import RunHeader
from handctl.programs.requests import target_request_text
from handctl.safety.safety_action import SafetyAction

BUS_NAMES = ("main", "a_second_bus")
OPEN_STREAM_REQUEST = (
    '{"do": "stream", "stream": "s", "space": "digit", "names": ["index", "thumb"], "rate_Hz": 100}'
)


def varied_header(**other_fields: object) -> RunHeader:
    """Create a header with two buses whose names differ in length."""
    return replace(synthetic_run.synthetic_header(rate_hz=100), buses=BUS_NAMES, **other_fields)


def varied_ticks(run_header: RunHeader, tick_count: int = 120) -> Iterator[tuple[TickIn, TickOut]]:
    """Yield ticks with every kind of content.

    The run has gaps of missed ticks. The yielded ticks contain frames of all kinds on all buses,
    NaN, infinities, unusual texts, all modes and all actions.
    """
    random, k = np.random.default_rng(1), 0
    for index in range(tick_count):
        k += 1 + (index % 17 == 16) * 3
        yield _tick_input(run_header, k, index, random), _tick_output(run_header, index, random)


def _random_frames(
    tick_index: int, t_ns: int, random_source: np.random.Generator
) -> tuple[Frame, ...]:
    frames = []
    for n in range(tick_index % 7):
        flag = (0, EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG, EXTENDED_FLAG | REMOTE_FLAG)[
            (tick_index + n) % 5
        ]
        can_id = (0x12345678 if flag & EXTENDED_FLAG else 0x123 + n) | flag
        is_fd_frame = (tick_index + n) % 4 == 0
        data = (
            random_source.bytes((12, 64, 3, 8)[n % 4])
            if is_fd_frame
            else random_source.bytes((tick_index + n) % 9)
        )
        flags = FDF | (BRS, ESI, 0)[n % 3] if is_fd_frame else 0
        frames.append(Frame(can_id, data, flags, (0, 1, 1, 0, 9)[n % 5], t_ns and t_ns - 1000 * n))
    return tuple(frames)


def _tick_input(
    run_header: RunHeader, k: int, tick_index: int, random: np.random.Generator
) -> TickIn:
    t_ns = k * run_header.period_ns
    io_events = (
        (IoEvent("enobufs", "main", 4), IoEvent("signal", "", 15)) if tick_index % 23 == 5 else ()
    )
    requests = ('{"do": "gain", "text": "\u00e4\u03b1\u4e2d"}', "") if tick_index % 19 == 3 else ()
    if tick_index == 50:
        requests += (OPEN_STREAM_REQUEST,)
    if tick_index > 50:
        requests += (
            target_request_text(
                StreamTarget("s", tick_index, t_ns - 10**6, (10.0, tick_index / 7))
            ),
        )
    return TickIn(
        k,
        t_ns,
        int(random.integers(0, 10**7)),
        _random_frames(tick_index, t_ns, random),
        io_events,
        requests,
    )


def _tick_output(run_header: RunHeader, tick_index: int, random: np.random.Generator) -> TickOut:
    telemetry = _random_telemetry(run_header, tick_index, random)
    events: tuple[TickEvent, ...] = ()
    if tick_index % 13 == 2:
        events = (
            TickEvent("error", "fault", "index_motor", "torque\nlimit"),
            TickEvent("info", "gain", "motion.x", "0.5"),
        )
    if tick_index % 29 == 4:
        events += (TickEvent("weird", "gain", "filter.mode", "a word"),)
    mode, action = HandMode(tick_index // 12 % 9), SafetyAction(tick_index // 20 % 5)
    phase = ("idle", "close", "h\u00e4lt", "")[tick_index // 30 % 4]
    frames = _random_frames(tick_index + 2, 0, random)
    return TickOut(frames, mode, phase, action, telemetry, events, random.bytes(8))


def _random_telemetry(
    run_header: RunHeader, tick_index: int, random: np.random.Generator
) -> Telemetry:
    values = {
        name: random.standard_normal(len(run_header.axis_names(axis)))
        for name, axis in TELEMETRY_AXES.items()
    }
    if tick_index % 5 == 0:
        values["joint_encoder"][:] = np.nan
    if tick_index % 11 == 0:
        values["tension"][0], values["q"][1], values["drive_phase"][0] = np.inf, np.nan, np.nan
    values["drive_phase"][1:] = float(DrivePhase(tick_index // 15 % 5))
    return Telemetry(**values)
