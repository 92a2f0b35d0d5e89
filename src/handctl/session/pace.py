"""Time scale at which a machine keeps up with a simulated hand."""

import math
from contextlib import suppress

from handctl.errors import HandctlError
from handctl.processes import cores
from handctl.runtime.simulator import ask_simulator, find_simulator
from handctl.session.plan import Plan
from handctl.session.run import Outcome

LOAD = 0.7
"""Maximum load of a core at which a machine keeps up, as a fraction."""
NOT_KEPT = 0.7
"""Maximum advised time scale as a fraction of a time scale that failed."""


def remedy(plan: Plan, outcome: Outcome) -> str:
    """Return advice for a simulated run that failed because ticks or answers came too late, or an empty text."""
    if not (plan.simulated and outcome.late):
        return ""
    return f"a machine that keeps up with a simulated hand, or --time-scale {slower(plan, outcome):g} on both sides"


def slower(plan: Plan, outcome: Outcome) -> float:
    """Compute the time scale that this machine can hold, from the computing times of a run that was late.

    Simulator and controller have a core each, or share the only core. The simulator reports its own measurement.

    Args:
        plan: plan of the run.
        outcome: outcome of the run. The simulator must still be running.
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
    """Round a positive number down to one significant digit: 0.37 becomes 0.3."""
    step = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.floor(value / step + 1e-9) * step:.6g}")
