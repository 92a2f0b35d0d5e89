"""Status line of one tick, for programs that show the state of a running hand."""

from typing import Any

from handctl.core.tick_types import TickIn, TickOut


def status_of_tick(
    tick_input: TickIn, tick_output: TickOut, commander_name: str | None
) -> dict[str, Any]:
    """Return the content of a tick's status line as plain values. A NaN becomes None.

    Args:
        tick_input: inputs of the tick.
        tick_output: output of the tick.
        commander_name: client that commands the hand, or None if every client is allowed to start
            to command the hand.
    """
    numbers = tick_output.telemetry
    return {
        "k": tick_input.k,
        "t_s": tick_input.t_ns / 1e9,
        "mode": tick_output.mode.name,
        "phase": tick_output.phase,
        "commander": commander_name,
        "late_us": tick_input.late_ns / 1e3,
        "q_rad": _json_values(numbers.q.tolist()),
        "q_sigma_rad": _json_values(numbers.q_sigma.tolist()),
        "tension_N": _json_values(numbers.tension.tolist()),
        "tension_goal_N": _json_values(numbers.tension_goal.tolist()),
        "tip_force_N": _json_values(numbers.tip_force.tolist()),
        "tip_force_sigma_N": _json_values(numbers.tip_force_sigma.tolist()),
        "events": [
            {"name": event.name, "where": event.where, "text": event.text}
            for event in tick_output.events
        ],
        "contact": [contact_value > 0.5 for contact_value in numbers.contact.tolist()],
    }


def _json_values(values: list[float]) -> list[float | None]:
    """Round values to four digits for JSON. A NaN becomes None, because JSON cannot contain NaN."""
    return [round(value, 4) if value == value else None for value in values]
