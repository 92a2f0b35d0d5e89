"""Test the lines that the display process shows to an operator during a run."""

from handctl.campaign.run_stages import homed_run
from handctl.cli.console import display
from handctl.cli.console.display import DisplayProcess
from handctl.core.tick_types import HandMode, TickEvent
from handctl.hand.hand_loading import load_hand
from handctl.safety.faults.table import FAULT_BY_ID, remedy_for

RATE_HZ = 500.0


def test_the_first_line_of_a_fault_is_followed_by_its_remedy(capfd) -> None:
    """When a drive loses its power during a motion, the controller latches several faults.

    The terminal shows the remedy for each latched fault once.
    """
    hand = load_hand("jamia")
    with homed_run(hand, RATE_HZ, 1) as simulation:
        assert simulation.run_until(lambda out: out.mode == HandMode.ACTIVE, 3.0), (
            simulation.state.failure
        )
        display = DisplayProcess.start_display(hand, RATE_HZ, 0.5)
        simulation.simulated_hand.inject("off node=index_motor")
        for _ in range(round(0.5 * RATE_HZ)):
            simulation.run_tick()
            display.show_tick(*simulation.recorded_ticks[-1])
        display.close()
    faults = [
        event
        for _, out in simulation.recorded_ticks
        for event in out.events
        if event.name == "fault"
    ]
    errors = {event.text for event in faults if event.level == "error"}
    assert errors, "the fault was not detected"
    lines = capfd.readouterr().err.splitlines()
    for text in errors:
        assert remedy_for(text) == FAULT_BY_ID[text.split()[0]].remedy
        fault_line_index = next(
            i for i, line in enumerate(lines) if line.endswith(f"error  {text}")
        )
        assert lines[fault_line_index + 1].strip() == f"what to do: {remedy_for(text)}"
    for advice in {remedy_for(event.text) for event in faults}:
        assert sum(line.endswith(f"what to do: {advice}") for line in lines) <= 1


def test_only_a_fault_has_a_remedy(capfd) -> None:
    """An event that is no fault has no remedy, even if the text of the event starts with the identifier of a fault."""
    display = DisplayProcess(("index_tendon",), (80.0,), RATE_HZ, 0.5)
    try:
        fault = next(fault for fault in FAULT_BY_ID.values() if fault.remedy)
        text = f"{fault.id} {fault.title}"
        assert display._event_text(TickEvent("info", "mode", "", text)) == text
        assert display._event_text(TickEvent("error", "fault", "", text)).endswith(
            f"what to do: {fault.remedy}"
        )
        assert display._event_text(TickEvent("error", "fault", "", text)) == text
        assert (
            display._event_text(TickEvent("info", "gain", "motion.force_N", "26.0"))
            == "motion.force_N = 26.0"
        )
    finally:
        display.close()


def test_the_tensions_of_many_tendons_fit_into_the_width_of_a_terminal():
    """Reproduce a defect: the line with the tensions of 17 tendons had 300 characters."""
    names = [f"finger_{number}_flexor_tendon" for number in range(17)]
    line = {
        "t": 1.0,
        "mode": "ACTIVE",
        "phase": "hold",
        "tension": [1.5 * number for number in range(17)],
    }
    rows = display._tension_lines(names, line).splitlines()
    assert len(rows) > 2
    assert max(map(len, rows)) <= 120
    pairs = " ".join(
        row[len("   1.000 s  ACTIVE    hold       tension [N]  ") :] for row in rows
    ).split()
    assert pairs[::2] == [name.removesuffix("_tendon") for name in names]
    assert [float(value) for value in pairs[1::2]] == line["tension"]
