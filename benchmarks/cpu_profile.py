"""Measure which fraction of a run's CPU time each part of the program takes.

The CPU time in a library counts for the part of the program that called the library.
"""

import cProfile
import pstats
from collections import defaultdict
from collections.abc import Callable, Iterator

CODE_PATTERNS_BY_PART = {
    "mj_step": ("mj_step", "firmware_sim/plant/drivetrain.py/steps"),
    "plant around its steps": ("firmware_sim/plant/plant", "firmware_sim/plant/tendon", "firmware_sim/plant/motor",
        "firmware_sim/plant/rigid_body_engine", "firmware_sim/scene/support_table", "firmware_sim/plant/drivetrain"),
    "simulated drives and sensors, their codec": ("firmware_sim/",),
    "host's codec and drive states": ("handctl/drives/",
        "tick.py/_receive_remaining_frames", "tick.py/_add_other_commands", "tick.py/store_drive_state"),
    "estimation": ("core/estimation/", "core/hand_estimate", "filterpy/", "tick.py/_process_frames"),
    "law: goals, inverse dynamics, allocation": ("core/control_law/", "handctl/hand/", "tick.py/_command_"),
    "program": ("handctl/programs/",),
    "safety": ("handctl/safety/", "controller/monitor/", "tick.py/_judge_faults"),
    "hash of the state": ("controller/controller_state", "core/identity_cache", "core/plain_data"),
    "tick and modes": ("handctl/controller/", "handctl/core/"),
    "reading a log": ("handctl/log/", "handctl/replay/"),
    "lockstep clock and bus, this script": ("handctl/runtime/", "benchmarks/"),
}  # fmt: skip
"""Parts of the program. Each part is defined by substrings that occur in the paths or in the names of its functions.

A function belongs to the first part of which a substring occurs in the path or name of the
function. The profiler does not see compiled functions, and counts their time for the Python
function that calls them. Each stage of the tick is recognised by the method that runs the stage.
The compiled function that simulates tendons and rotors calls ``mj_step``. The part ``mj_step`` of
the profile includes the time of tendons and rotors.
"""

ProfiledFunction = tuple[str, int, str]


def cpu_time_fractions(profiled_work: Callable[[], None]) -> dict[str, float]:
    """Measure the fraction of CPU time that each part of the program takes.

    The profiler slows down Python calls, but not compiled code, so that the measured fraction of
    compiled code is too small.
    """
    profile = cProfile.Profile()
    profile.runcall(profiled_work)
    stats = pstats.Stats(profile).stats
    total: dict[str, float] = defaultdict(float)
    for function, (_, _, self_s, _, _) in stats.items():
        for code_part, fraction in _parts_of_function(stats, function, 6):
            total[code_part] += self_s * fraction
    total_time = sum(total.values())
    return {
        code_part: value / total_time
        for code_part, value in sorted(total.items(), key=lambda row: -row[1])
    }


def _parts_of_function(
    profile_stats: dict, function: ProfiledFunction, depth: int
) -> Iterator[tuple[str, float]]:
    """Divide the time of a function among parts of the program. Yield each part with its fraction.

    If no part contains the function, the time of the function is divided among the parts that
    contain the callers. The weight of a caller is the time that the function takes in all calls
    from this caller.
    """
    name = f"{function[0]}/{function[2]}"
    code_part = next(
        (
            marked_part
            for marked_part, function_marks in CODE_PATTERNS_BY_PART.items()
            if any(mark in name for mark in function_marks)
        ),
        None,
    )
    callers = profile_stats[function][4]
    if code_part or not callers or not depth:
        yield code_part or "other", 1.0
        return
    callers_time = sum(times[3] for times in callers.values()) or 1.0
    for caller, times in callers.items():
        for owner, fraction in _parts_of_function(profile_stats, caller, depth - 1):
            yield owner, fraction * times[3] / callers_time
