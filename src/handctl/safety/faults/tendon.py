"""Rows T01 to T09: what goes wrong with ropes and their load cells. T07 is judged by commissioning."""

from collections.abc import Sequence

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import ITSELF, NOTHING, PERSON, Fault, Reading, above
from handctl.safety.signals import Limits, Signals

SLACK_WARN_S, SLACK_TRIP_S = 0.05, 0.5
RESIDUAL_WARN_N, RESIDUAL_TRIP_N, FRICTION_WARN_N = 5.0, 10.0, 3.0
DERAILED_DEG = 15.0
"""Joint against spool, unfiltered: beyond any stretch of a rope."""


def _snapped(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.snapped


def _slack(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, since) for name, since in s.slack if since > SLACK_WARN_S] if s.slack else NOTHING


def _slack_long(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, since) for name, since in s.slack if since > SLACK_TRIP_S] if s.slack else NOTHING


def _over_tension(limits: Limits, s: Signals) -> Sequence[Reading]:
    if max(s.tension, default=0.0) <= limits.trip_least:
        return NOTHING
    rows = zip(limits.tendons, s.tension, limits.tension_trip, strict=False)
    return [(name, f) for name, f, trip in rows if trip < f < limits.tension_rail]


def _beyond_drive(limits: Limits, s: Signals) -> Sequence[Reading]:
    if max(s.tension, default=0.0) <= limits.trip_least:
        return NOTHING
    rows = zip(limits.tendons, s.tension, limits.drive_limit, strict=False)
    return [(name, f) for name, f, most in rows if most < f < limits.tension_rail]


def _stays(limits: Limits, s: Signals) -> Sequence[Reading]:
    """Above the trip, or at the rail that hides how far above, of a motor that was to relax: it does not obey."""
    if not s.relaxed:
        return NOTHING
    rows = zip(limits.tendons, s.tension, limits.tension_trip, strict=False)
    return [(name, f) for name, f, trip in rows if f > trip]


def _within(limits: Limits, tension: tuple[float, ...]) -> bool:
    return not tension or (max(tension) < limits.tension_rail and min(tension) > limits.tension_low)


def _saturated(limits: Limits, s: Signals) -> Sequence[Reading]:
    """At an end of the range, or tared and beyond what a rope can make: a tare may hide the one or the other."""
    if not s.armed or (not s.railed and _within(limits, s.tension)):
        return NOTHING
    rows = zip(limits.tendons, s.tension, strict=False)
    beyond = [(name, f) for name, f in rows if (f >= limits.tension_rail or f <= limits.tension_low)]
    return list(dict((*beyond, *s.railed)).items())


def _drifts(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.residual, RESIDUAL_WARN_N)


def _drifted(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.residual, RESIDUAL_TRIP_N)


def _stuck(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.stuck_cell


def _replayed(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.replayed


def _derailed(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.derailed, DERAILED_DEG)


def _rubs(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.friction, FRICTION_WARN_N)


TENDON_FAULTS: tuple[Fault, ...] = (
    Fault("T01", "a rope snapped", "no tension where there was some, and the spool runs", 2, Action.RELAX, PERSON,
          _snapped),
    Fault("T02a", "a rope is slack", "below 2 N for 50 ms where tension is wanted", 1, Action.WARN, ITSELF, _slack),
    Fault("T02b", "a rope stays slack", "the same for 500 ms", 1, Action.RELAX, PERSON, _slack_long),
    Fault("T03", "over-tension", "one load-cell sample above tension_trip_N", 1, Action.RELAX, PERSON, _over_tension,
          Release.FAST),
    Fault("T03b", "beyond the drive", "one load-cell sample above drive_limit_N", 1, Action.CUT, PERSON, _beyond_drive),
    Fault("T03c", "over-tension stays", "still above tension_trip_N, or at the rail, 100 ms after relaxing began", 1,
          Action.CUT, PERSON, _stays),
    Fault("T04a", "a load cell drifts", "5 N that torque, inertia and friction do not explain", 1, Action.WARN, ITSELF,
          _drifts),
    Fault("T04b", "a load cell is wrong", "10 N that torque, inertia and friction do not explain", 1, Action.RELAX,
          PERSON, _drifted, Release.OPEN),
    Fault("T05", "a load cell is stuck", "the same count 40 times while the motor's torque moves", 1, Action.RELAX,
          PERSON, _stuck),
    Fault("T05b", "load-cell readings are old", "8 to 16 in a row as so many ticks before", 1, Action.RELAX,
          PERSON, _replayed, Release.OPEN),
    Fault("T06", "load cell saturated", "a rail, or a broken wire, three ticks", 3, Action.RELAX, PERSON, _saturated,
          Release.FAST),
    Fault("T08", "a rope left its pulley", "joint and spool differ by more than any stretch, three readings", 1,
          Action.RELAX, PERSON, _derailed),
    Fault("T09", "friction has grown", "3 N above the hand file's, averaged over 5 s of motion", 1, Action.WARN, ITSELF,
          _rubs),
)  # fmt: skip
