"""Inject faults that are hard to detect.

For each fault, the benchmark records whether the controller reports the fault, the delay of the
reaction, and the largest true tension.

Each fault is injected into the first finger of a simulated hand, which runs in lockstep with its
controller. When the fault begins, the hand moves freely, holds an object, or raises the tendon
tensions on the object. The hand holds the object with tendon tensions of either 24 N or 90 N. If
the controller does not react within 2 s, the benchmark requests a stop, as an operator would.

    python benchmarks/hidden_faults.py --hand jamia --protocol mit --seeds 20
"""

import argparse
import copy
import json
import os
from collections import Counter
from collections.abc import Iterator
from typing import Any

from handctl.campaign.run_stages import CAMPAIGN_TASK, hand_with_protocol, homed_run
from handctl.core.tick_types import HandMode
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.safety.safety_action import SafetyAction
from handctl.session.lockstep_simulation import SimulatedRun
from handctl.session.run_plan import default_control_rate

OPERATOR_DELAY_S = 2.0
"""Time from the injection of the fault until the operator stops the run [s]."""
TIME_AFTER_STOP_S = 1.5
"""Time from the stop by the operator to the end of the run [s]."""
STOP_REQUEST = '{"do": "stop"}'
HIGH_HOLD_TENSION_N = 90.0
FAST_TENSION_RATE_N_PER_S = 60.0
FREE_MOTION_STAGE = "free"
LOW_HOLD_STAGE = "hold 24"
RISING_STAGE = "rising"
HIGH_HOLD_STAGE = "hold 90"
FAULT_STAGES = (FREE_MOTION_STAGE, LOW_HOLD_STAGE, RISING_STAGE, HIGH_HOLD_STAGE)
HOLD_STAGES = (LOW_HOLD_STAGE, HIGH_HOLD_STAGE)
HIDDEN_FAULTS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("registers lost, as saved", "forget node={motor}", FAULT_STAGES),
    ("registers lost, TMAX 10 N m", "forget node={motor} size=10", FAULT_STAGES),
    ("encoder slips by 0.5 rad/s", "drift encoder={motor} size=0.5", FAULT_STAGES),
    ("encoder slips by -0.5 rad/s", "drift encoder={motor} size=-0.5", FAULT_STAGES),
    ("encoder slips by 2 rad/s", "drift encoder={motor} size=2", FAULT_STAGES),
    ("encoder slips by -2 rad/s", "drift encoder={motor} size=-2", FAULT_STAGES),
    ("encoder scale 0.5", "scale encoder={motor} size=0.5", FAULT_STAGES),
    ("encoder scale 1.5", "scale encoder={motor} size=1.5", FAULT_STAGES),
    ("sensor frames 16 ticks old", "replay node=sensors size=16", FAULT_STAGES),
    ("sensor frames 32 ticks old", "replay node=sensors size=32", FAULT_STAGES),
    ("load cell 16 ticks old", "old cell={tendon} size=16", FAULT_STAGES),
    ("load cell 30 ticks old", "old cell={tendon} size=30", FAULT_STAGES),
    ("load cell 50 ticks old", "old cell={tendon} size=50", FAULT_STAGES),
    ("ripple 0.1 N m at 20 Hz", "ripple node={motor} size=0.1 hz=20", FAULT_STAGES),
    ("ripple 0.2 N m at 20 Hz", "ripple node={motor} size=0.2 hz=20", FAULT_STAGES),
    ("ripple 0.2 N m at 30 Hz", "ripple node={motor} size=0.2 hz=30", FAULT_STAGES),
    ("ripple 0.2 N m at 40 Hz", "ripple node={motor} size=0.2 hz=40", FAULT_STAGES),
    ("runaway at torque_max_N_m", "runaway node={motor}", FAULT_STAGES),
    ("runaway at torque_peak_N_m", "runaway node={motor} size={peak}", FAULT_STAGES),
)


def rising_hold_task() -> dict[str, Any]:
    """Return the task of ``handctl campaign`` (``CAMPAIGN_TASK``) with an additional hold phase.

    In the additional phase, the tension rises to 90 N and stays at 90 N.
    """
    other_task = copy.deepcopy(CAMPAIGN_TASK)
    hold_phase = other_task["phase"][-1]
    hold_phase["duration_s"] = 1.5
    rising_hold_phase = {
        "kind": "hold",
        "name": "rise",
        "tension_N": HIGH_HOLD_TENSION_N,
        "rate_N_per_s": FAST_TENSION_RATE_N_PER_S,
        "duration_s": 60.0,
    }
    other_task["phase"].append(rising_hold_phase)
    return other_task


def is_at_stage(stage_name: str, tick_output: Any, free_motion_ticks: int) -> bool:
    """Return True if a run has reached a stage.

    ``free_motion_ticks`` is the number of ticks in which the hand has moved freely so far.
    """
    tension = float(tick_output.telemetry.tension.max())
    if stage_name == FREE_MOTION_STAGE:
        return bool(tick_output.phase == "free" and free_motion_ticks > 100)
    if stage_name == LOW_HOLD_STAGE:
        return bool(tick_output.phase == "hold" and tension > 20.0)
    return bool(
        tick_output.phase == "rise"
        and tension > (40.0 if stage_name == RISING_STAGE else 0.95 * HIGH_HOLD_TENSION_N)
    )


def run_with_fault(simulation: SimulatedRun, fault_text: str) -> dict[str, Any]:
    """Inject a fault, and continue the run to its end.

    Return the identifiers of the reported faults, the delay of the reaction [ms], and the largest
    true tension [N].
    """
    simulation.simulated_hand.inject(fault_text)
    start = simulation.k
    detected_faults = []
    reaction_time_ms = -1.0
    max_tension = 0.0
    tension_after_stop = 0.0
    stop_tick, end_tick = (
        round(s * 1e9 / simulation.period_ns)
        for s in (OPERATOR_DELAY_S, OPERATOR_DELAY_S + TIME_AFTER_STOP_S)
    )
    for i in range(end_tick):
        must_stop = i == stop_tick and reaction_time_ms < 0
        tick_output = simulation.run_tick(requests=(STOP_REQUEST,) if must_stop else ())
        effect = simulation.simulated_hand.fault_states()[-1]
        effect_ns = effect["first_ns"] if effect["first_ns"] >= 0 else start * simulation.period_ns
        detected_faults += [
            e.text.split()[0] for e in tick_output.events if e.name == "fault" and e.level != "info"
        ]
        if (
            reaction_time_ms < 0
            and i < stop_tick
            and (
                tick_output.action >= SafetyAction.RELAX
                or tick_output.mode in (HandMode.RELAX, HandMode.CUT)
            )
        ):
            reaction_time_ms = (simulation.k * simulation.period_ns - effect_ns) * 1e-6
        tick_tension = max(simulation.simulated_hand.truth()["tension"])
        max_tension = max(max_tension, tick_tension)
        tension_after_stop = (
            max(tension_after_stop, tick_tension) if i >= stop_tick else tension_after_stop
        )
        if tick_output.mode == HandMode.DONE:
            break
    return {"found": list(dict.fromkeys(detected_faults)), "ms": reaction_time_ms, "tension": max_tension,
            "stopped": tension_after_stop,
            "felt": bool(simulation.simulated_hand.fault_states()[-1]["felt"])}  # fmt: skip


def fault_rows(
    hand_name: str, protocol: str, seed: int, selected_fault: str
) -> Iterator[dict[str, Any]]:
    """Yield a row for every fault in every stage of one run.

    Each fault is injected in a forked copy of this process, so that all faults begin from the same
    state of the hand.
    """
    hand = hand_with_protocol(hand_name, protocol)
    rate = default_control_rate(hand)
    motor = hand.motor[0]
    tendon = hand.tendon[0]
    words = {
        "motor": motor.name,
        "tendon": tendon.name,
        "peak": f"{motor.torque_peak_N_m / motor.torque_max_N_m:.6g}",
    }
    with homed_run(hand, rate, seed, task=rising_hold_task()) as simulation:
        for stage in FAULT_STAGES:
            free_motion_ticks = 0
            for _ in range(round(15.0 * rate)):
                tick_output = simulation.run_tick()
                free_motion_ticks += tick_output.phase == "free"
                if is_at_stage(stage, tick_output, free_motion_ticks):
                    break
            else:
                raise SystemExit(
                    f"seed {seed}: no {stage}: {simulation.state.failure or tick_output.phase}"
                )
            for name, text, stages in HIDDEN_FAULTS:
                if stage in stages and selected_fault in name:
                    read_end, write_end = os.pipe()
                    if os.fork() == 0:
                        os.write(
                            write_end,
                            json.dumps(run_with_fault(simulation, text.format(**words))).encode(),
                        )
                        os._exit(0)
                    os.close(write_end)
                    with os.fdopen(read_end) as pipe:
                        yield {
                            "fault": name,
                            "stage": stage,
                            "seed": seed,
                            **json.loads(pipe.read()),
                        }
                    os.wait()


def results_table(results: list[dict[str, Any]]) -> str:
    """Make a table with a row for each fault and stage.

    The column "relaxed or cut" contains the number of runs in which the controller relaxed the hand
    or disabled the motors. The next columns are the reported faults, the longest delay of a
    reaction [ms], and the largest true tension [N] in the whole run. The last column is the largest
    true tension [N] after a stop.
    """
    lines = ["| fault | stage | relaxed or cut | by (runs) | at the latest, ms | true tension, N | after a stop, N |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for name, stage in dict.fromkeys((result["fault"], result["stage"]) for result in results):
        case_rows = [
            result for result in results if (result["fault"], result["stage"]) == (name, stage)
        ]
        by = Counter(id_ for run_row in case_rows for id_ in run_row["found"])
        reaction_times_ms = [run_row["ms"] for run_row in case_rows if run_row["ms"] >= 0]
        detected_text = ", ".join(f"{id_} ({n})" for id_, n in by.most_common(5)) or "-"
        stop_times_s = [run_row["stopped"] for run_row in case_rows if run_row["ms"] < 0]
        lines.append(f"| {name} | {stage} | {len(reaction_times_ms)} of {len(case_rows)} | {detected_text} | "
                     f"{max(reaction_times_ms, default=-1):.0f} | "
                     f"{max(run_row['tension'] for run_row in case_rows):.0f} | "
                     f"{max(stop_times_s, default=0.0):.0f} |")  # fmt: skip
        if not all(run_row["felt"] for run_row in case_rows):
            lines[-1] += " not felt"
    return "\n".join(lines)


def main() -> None:
    """Measure the reactions to all faults, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hand", default="jamia", help="packaged hand (default: jamia)")
    parser.add_argument(
        "--protocol",
        default="mit",
        choices=VERIFIABLE_PROTOCOLS,
        help="protocol of the drives (default: mit)",
    )
    parser.add_argument(
        "--seeds", type=int, default=1, help="number of runs for each fault (default: 1)"
    )
    parser.add_argument("--only", default="", help="only faults whose name contains this text")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    results = [
        row
        for seed in range(args.seeds)
        for row in fault_rows(args.hand, args.protocol, seed, args.only)
    ]
    print(json.dumps(results, indent=1) if args.json else results_table(results))


if __name__ == "__main__":
    main()
