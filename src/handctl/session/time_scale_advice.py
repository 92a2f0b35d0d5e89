"""Advice about the time scale at which this machine is fast enough for a simulated hand."""

import math
from contextlib import suppress

from handctl.errors import HandctlError
from handctl.processes import usable_cores
from handctl.runtime.simulator_requests import ask_simulator, find_simulator
from handctl.session.run import RunOutcome
from handctl.session.run_plan import RunPlan

MAX_CORE_LOAD = 0.7
"""Largest load of a processor core at which the machine counts as fast enough, as a fraction of full load."""
ADVISED_TIME_SCALE_FRACTION = 0.7
"""Largest time scale that is advised, as a fraction of the time scale that was too fast."""


def late_run_advice(plan: RunPlan, outcome: RunOutcome) -> str:
    """Return advice for a simulated run that failed because ticks or answers were late.

    For a run that did not fail because of lateness, the result is an empty text.
    """
    if not (plan.is_simulated and outcome.was_too_slow):
        return ""
    scale = slower_time_scale(plan, outcome)
    return f"a machine fast enough for a simulated hand, or handctl sim with --time-scale {scale:g}"


def slower_time_scale(plan: RunPlan, outcome: RunOutcome) -> float:
    """Return a time scale at which this machine is fast enough.

    The function computes the time scale from the computing times of a run that was too slow.
    Simulator and controller use one core each. On a machine with a single core, simulator and
    controller share this core. The simulator reports its own computing time.

    Args:
        plan: plan of the run.
        outcome: outcome of the run. The simulator must still be running.
    """
    run_duration_s = outcome.state.k * plan.period_ns / 1e9
    controller_load = outcome.loop_stats.cpu_s / run_duration_s if outcome.state.k > 0 else 0.0
    simulator_pace: dict[str, float | None] = {}
    with suppress(HandctlError):
        simulator_pace = ask_simulator(find_simulator(plan.buses[0]), {"pace": True}).get(
            "pace", {}
        )
    max_time_scale = simulator_pace.get("plant_s_per_cpu_s") or math.inf
    core_loads = (controller_load, 1.0 / max_time_scale)
    load = sum(core_loads) if usable_cores() == 1 else max(core_loads)
    scale_below_failed = ADVISED_TIME_SCALE_FRACTION * plan.time_scale
    simulator_advice = simulator_pace.get("advice") or math.inf
    max_scale_for_load = MAX_CORE_LOAD / load if load > 0.0 else math.inf
    return round_down_to_one_digit(
        max(0.001, min(scale_below_failed, simulator_advice, max_scale_for_load))
    )


def round_down_to_one_digit(value: float) -> float:
    """Round a positive number down to one significant digit, such as 0.37 to 0.3."""
    step = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.floor(value / step + 1e-9) * step:.6g}")
