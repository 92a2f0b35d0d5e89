"""A host or a simulator that paused gets, or gives, several answers at once: that is no masquerade."""

from handctl.controller.gains import Gains
from handctl.controller.live import LiveProgram
from handctl.controller.model import HandModel
from handctl.controller.types import Mode
from handctl.drives.frame import Frame
from handctl.hand.description import load_hand
from tests.controller.bench import bench


def test_answers_that_a_busy_host_gets_late_are_no_masquerade() -> None:
    """One tick's answers come nearly two ticks later, and the next ones together with those after them."""
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 500.0), LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(0.5)
    held: list[list[Frame]] = []

    def nothing(frames: list[Frame]) -> list[Frame]:
        held.append(list(frames))
        return []

    def those_before(frames: list[Frame]) -> list[Frame]:
        held.append(list(frames))
        return [frame._replace(t_ns=frame.t_ns + int(1.85 * run.period_ns)) for frame in held[0]]

    told = []
    for run.to_host in (nothing, those_before, lambda frames: [*held[1], *frames]):
        out = run.tick()
        told += [event.text for event in out.events if event.name == "fault"]
    assert any("B01" in text for text in told)
    assert not [text for text in told if "B05" in text or "B06" in text]
    assert out.mode == Mode.ACTIVE


def test_late_answers_of_a_bus_without_stamps_are_no_masquerade() -> None:
    """A frame has the time at which it was taken off; a simulator that paused answers two ticks at once."""
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 500.0), LiveProgram())
    run.until(Mode.ACTIVE)
    waiting: list[Frame] = []

    def taken_off(frames: list[Frame]) -> list[Frame]:
        now_ns = run.k * run.period_ns + 30_000
        return [frame._replace(t_ns=now_ns) for frame in frames]

    run.to_host = taken_off
    run.run(0.5)
    run.to_host = lambda frames: waiting.extend(frames) or []
    run.tick()
    run.to_host = lambda frames: taken_off([*waiting, *frames])
    out = run.tick()
    assert not [
        event.text for event in out.events if event.name == "fault" and ("B05" in event.text or "B06" in event.text)
    ]
    assert out.mode == Mode.ACTIVE
    run.to_host = lambda frames: taken_off([*frames, *2 * [f for f in frames if f.can_id == 0x11]])
    out = run.tick()
    assert any("B05" in event.text for event in out.events), "positive control: two answers too many"
