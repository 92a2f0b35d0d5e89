"""Whether a machine keeps up with a simulated hand, and the time scale at which it would."""

import math
from contextlib import suppress

from handctl.errors import HandctlError
from handctl.processes import cores
from handctl.runtime.simulator import ask_simulator, find_simulator
from handctl.session.plan import Plan
from handctl.session.run import Outcome

LOAD = 0.7
"""Fraction of its core up to which a machine keeps up."""
NOT_KEPT = 0.7
"""Largest advised pace as a fraction of one that was not kept."""


def remedy(plan: Plan, outcome: Outcome) -> str:
    """What would be right where a simulated hand and its controller did not keep up with each other."""
    if not (plan.simulated and outcome.late):
        return ""
    return f"a machine that keeps up with a simulated hand, or --time-scale {slower(plan, outcome):g} on both sides"


def slower(plan: Plan, outcome: Outcome) -> float:
    """Return the time scale that this machine keeps, by the computing times measured in a run that came too late.

    Simulator and controller have a core each, or share the only one. The simulator is asked what it measured.

    Args:
        plan: of the run.
        outcome: of the run; its simulator still runs.
    """
    own = outcome.stats.cpu_s / (outcome.state.k * plan.period_ns / 1e9) if outcome.state.k > 0 else 0.0
    told: dict[str, float | None] = {}
    with suppress(HandctlError):
        told = ask_simulator(find_simulator(plan.buses[0]), {"pace": True}).get("pace", {})
    capacity = told.get("plant_s_per_cpu_s") or math.inf
    loads = (own, 1.0 / capacity)
    load = sum(loads) if cores() == 1 else max(loads)
    limits = [NOT_KEPT * plan.time_scale, told.get("advice") or math.inf, LOAD / load if load > 0.0 else math.inf]
    return one_digit(max(0.001, min(limits)))


def one_digit(value: float) -> float:
    """Return a positive number rounded down to one significant digit: 0.3 of 0.37."""
    step = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.floor(value / step + 1e-9) * step:.6g}")
