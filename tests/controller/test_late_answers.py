"""Test replies of a node that arrive together in one tick, after a pause of the host or the simulator.

The controller must not regard late replies of a node as replies of a second node with the same
identifier.
"""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickOut
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from handctl.safety.faults.bus import LOSS_WINDOW_TICKS
from tests.controller.controller_bench import ControllerBench, make_controller_bench


def test_replies_that_a_busy_host_reads_late_are_no_second_node() -> None:
    """In this test, the host reads some replies of drives one tick late.

    In the last tick, the host reads late replies of drives together with replies that are in time.
    """
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 500.0), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.5)
    held_frames: list[list[Frame]] = []

    def hold_back_frames(frames: list[Frame]) -> list[Frame]:
        held_frames.append(list(frames))
        return []

    def frames_sent_before(frames: list[Frame]) -> list[Frame]:
        held_frames.append(list(frames))
        return [
            frame._replace(t_ns=frame.t_ns + int(1.85 * run.period_ns)) for frame in held_frames[0]
        ]

    fault_texts = []
    for run.modify_frames_to_host in (
        hold_back_frames,
        frames_sent_before,
        lambda frames: [*held_frames[1], *frames],
    ):
        out = run.tick()
        fault_texts += [event.text for event in out.events if event.name == "fault"]
    assert any("B01" in text for text in fault_texts)
    assert not [text for text in fault_texts if "B05" in text or "B06" in text]
    assert out.mode == HandMode.ACTIVE


def test_late_replies_without_time_stamps_are_no_second_node() -> None:
    """On the bus of this test, the time stamp of a frame is the time at which the host reads the frame.

    After a pause, the replies to the commands of two ticks arrive in the same tick.
    """
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 500.0), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    waiting: list[Frame] = []

    def remove_time_stamps(frames: list[Frame]) -> list[Frame]:
        now_ns = run.k * run.period_ns + 30_000
        return [frame._replace(t_ns=now_ns) for frame in frames]

    run.modify_frames_to_host = remove_time_stamps
    run.run(0.5)
    run.modify_frames_to_host = lambda frames: waiting.extend(frames) or []
    run.tick()
    run.modify_frames_to_host = lambda frames: remove_time_stamps([*waiting, *frames])
    out = run.tick()
    assert not [
        event.text
        for event in out.events
        if event.name == "fault" and ("B05" in event.text or "B06" in event.text)
    ]
    assert out.mode == HandMode.ACTIVE
    run.modify_frames_to_host = lambda frames: remove_time_stamps(
        [*frames, *[f for f in frames if f.can_id == 0x11]]
    )
    out = run.tick()
    assert any("B05" in event.text for event in out.events), "positive control: one answer too many"


@pytest.mark.parametrize("paused_ticks", range(4))
def test_replies_after_a_pause_longer_than_the_reply_limit_are_no_second_node(
    paused_ticks: int,
) -> None:
    """The replies to the commands of three ticks arrive in one tick.

    At about the time at which the replies arrive, the controller forgets the requests of the
    earlier ticks.
    """
    run = bench_without_time_stamps()
    waiting: list[Frame] = []
    while (run.k + paused_ticks) % LOSS_WINDOW_TICKS:
        run.tick()
    run.modify_frames_to_host = lambda frames: waiting.extend(frames) or []
    run.run(2 * run.period_ns * 1e-9)
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, [*waiting, *frames])
    assert not second_node_reports(run.tick())
    assert run.state.mode == HandMode.ACTIVE


def bench_without_time_stamps(rate_hz: float = 500.0) -> ControllerBench:
    """Return a test bench whose hand is active.

    On the bus of this test bench, the time stamp of a frame is the time at which the host reads the
    frame.
    """
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), rate_hz), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, frames)
    run.run(0.5)
    return run


def with_time_stamps(bench: ControllerBench, frames: list[Frame]) -> list[Frame]:
    return [frame._replace(t_ns=bench.k * bench.period_ns + 30_000) for frame in frames]


def second_node_reports(tick_output: TickOut) -> list[str]:
    return [
        event.text
        for event in tick_output.events
        if event.name == "fault" and event.text[:3] in ("B05", "B06", "N13")
    ]


def test_replies_may_be_in_time_again_after_many_late_ones() -> None:
    """At the start of this test, the drives reply just after the deadline of each tick.

    Later, the drives reply before the deadline. In the tick of this change, a late reply and a
    reply in time arrive together.
    """
    run = bench_without_time_stamps()
    held_frames: list[list[Frame]] = [[]]

    def delay_by_one_tick(frames: list[Frame]) -> list[Frame]:
        motors = [frame for frame in frames if frame.can_id in range(0x11, 0x15)]
        held_frames.append(motors)
        return with_time_stamps(
            run, [*held_frames[-2], *[frame for frame in frames if frame not in motors]]
        )

    run.modify_frames_to_host = delay_by_one_tick
    reported = [text for _ in range(50) for text in second_node_reports(run.tick())]
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, [*held_frames[-1], *frames])
    reported += second_node_reports(run.tick())
    assert not reported
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, [*frames, *frames])
    assert second_node_reports(run.tick()), "positive control"


def test_a_lost_answer_excuses_one_duplicate_and_no_second_node() -> None:
    run = bench_without_time_stamps()
    run.modify_frames_to_host = lambda frames: with_time_stamps(
        run, [frame for frame in frames if frame.can_id != 0x11]
    )
    run.tick()
    run.modify_frames_to_host = lambda frames: with_time_stamps(
        run, [*frames, *[frame for frame in frames if frame.can_id == 0x11]]
    )
    assert not second_node_reports(run.tick())
    assert [text[:3] for text in second_node_reports(run.tick())] == ["B05"]
    run.tick()
    assert "N13" in [text[:3] for text in second_node_reports(run.tick())]


def test_missing_replies_excuse_one_duplicate_over_a_long_time() -> None:
    run = bench_without_time_stamps()
    run.modify_frames_to_host = lambda frames: with_time_stamps(
        run, [frame for frame in frames if frame.can_id != 0x11]
    )
    run.run(3 * run.period_ns * 1e-9)
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, frames)
    run.run(2 * LOSS_WINDOW_TICKS * run.period_ns * 1e-9)
    run.modify_frames_to_host = lambda frames: with_time_stamps(
        run, [*frames, *[frame for frame in frames if frame.can_id == 0x11]]
    )
    assert not second_node_reports(run.tick())
    assert [text[:3] for text in second_node_reports(run.tick())] == ["B05"]


@pytest.mark.parametrize(
    ("rate_hz", "missing_ticks"), [(500.0, 9), (500.0, 14), (1000.0, 8), (1000.0, 9), (1000.0, 29)]
)
def test_replies_after_a_pause_shorter_than_silence_are_no_second_node(
    rate_hz: float, missing_ticks: int
) -> None:
    """The replies of several ticks arrive together, as after a pause of a bus adapter.

    The pause is shorter than the time after which silent motors are a fault.
    """
    run = bench_without_time_stamps(rate_hz)
    waiting: list[Frame] = []
    run.modify_frames_to_host = lambda frames: waiting.extend(frames) or []
    reports = [text for _ in range(missing_ticks) for text in second_node_reports(run.tick())]
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, [*waiting, *frames])
    reports += second_node_reports(run.tick())
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, frames)
    reports += [text for _ in range(50) for text in second_node_reports(run.tick())]
    assert not reports
    assert run.state.mode == HandMode.ACTIVE
    run.modify_frames_to_host = lambda frames: with_time_stamps(run, [*frames, *frames])
    assert second_node_reports(run.tick()), "positive control"
