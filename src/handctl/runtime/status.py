"""One tick in a line, for people and programs that watch a running hand."""

from typing import Any

from handctl.core.types import TickIn, TickOut


def status(entry: TickIn, out: TickOut) -> dict[str, Any]:
    """What is worth watching, as plain values; None where nothing is known.

    Args:
        entry: what came into the tick.
        out: what it decided.
    """
    numbers = out.telemetry
    return {
        "k": entry.k,
        "t_s": entry.t_ns / 1e9,
        "mode": out.mode.name,
        "phase": out.phase,
        "late_us": entry.late_ns / 1e3,
        "q_rad": _plain(numbers.q.tolist()),
        "q_sigma_rad": _plain(numbers.q_sigma.tolist()),
        "tension_N": _plain(numbers.tension.tolist()),
        "tension_goal_N": _plain(numbers.tension_goal.tolist()),
        "tip_force_N": _plain(numbers.tip_force.tolist()),
        "tip_force_sigma_N": _plain(numbers.tip_force_sigma.tolist()),
        "events": [{"name": event.name, "where": event.where, "text": event.text} for event in out.events],
        "contact": [touches > 0.5 for touches in numbers.contact.tolist()],
    }


def _plain(values: list[float]) -> list[float | None]:
    return [round(value, 4) if value == value else None for value in values]
