"""Fault detection of a tick.

The detectors update their stored values and find faults. For each fault, the consecutive ticks with
the fault are counted. After the fault detection, ``safety.tick_verdict`` latches the active faults,
adds the faults that the buses and the host report, and chooses the reaction.
"""

import math

import numpy as np

from handctl.compiled import kernel_helper
from handctl.core import state_block as s
from handctl.core.block_schema import BlockLayout
from handctl.core.constants import ConstantTables
from handctl.core.control_law import servo_commands
from handctl.core.detectors import (
    bus_faults,
    frame_losses,
    host_faults,
    node_faults,
    replayed_readings,
    residuals,
    slack_history,
    stuck_sensors,
    tendon_faults,
    tendon_slip,
    tension_swings,
    torque_correlation,
)
from handctl.core.detectors.bus_faults import EvidenceTable
from handctl.core.state_block import StateTables, reset_monitor
from handctl.core.tick_types import ARMING_MODE, CUT_MODE, DISARM_MODE, RELAX_MODE
from handctl.safety.faults.table import ACTION_NUMBERS, DEBOUNCE_TICKS


def empty_evidence(layout: BlockLayout) -> EvidenceTable:
    """Return an evidence table without faults: an array (faults, instances) of NaN.

    Args:
        layout: layout of the state block.
    """
    return np.full((len(ACTION_NUMBERS), layout.axes["instance"]), math.nan)


@kernel_helper
def find_and_debounce_faults(
    x: StateTables, c: ConstantTables, initial: StateTables, evidence: EvidenceTable
) -> int:
    """Find the faults of a tick, and write the number of newly active faults to ``NEW_FAULT_COUNT``.

    Args:
        x: state tables.
        c: constants of the hand.
        initial: state tables before the first tick.
        evidence: (faults, instances) result: evidence of each fault. The evidence of an absent fault
            is NaN.

    Returns:
        The most severe reaction that an active fault demands.
    """
    mode = x.run_int[s.HAND_MODE]
    # Motors are allowed to make torque in the states from ARMING to RELAX, but not in DISARM and
    # CUT.
    is_armed = ARMING_MODE <= mode <= RELAX_MODE
    is_torque_cut = mode == CUT_MODE or mode == DISARM_MODE
    for row in range(evidence.shape[0]):
        for i in range(evidence.shape[1]):
            evidence[row, i] = math.nan
    frame_losses.update_loss_counts(
        x,
        c,
        x.run_int[s.TICK_TIME_NS],
        x.run_int[s.UNKNOWN_FRAME_COUNT],
        is_armed and x.run_int[s.MISSED_TICKS] == 0,
    )
    bus_faults.detect_bus_faults(x, c, is_armed, evidence)
    node_faults.detect_node_faults(x, c, is_armed, evidence)
    tendon_faults.detect_tendon_faults(x, c, is_armed, evidence)
    host_faults.detect_host_faults(x, c, is_armed, evidence)
    if is_armed:
        update_fault_memory(x, c)
        node_faults.detect_node_faults_under_torque(x, c, evidence)
        tendon_faults.detect_tendon_faults_under_torque(x, c, evidence)
    elif is_torque_cut:
        slack_history.update_history_after_cut(x, c, x.run_int[s.ARE_CELLS_TARED] == 1)
        node_faults.detect_tension_after_cut(x, c, evidence)
    else:
        reset_monitor(x, initial)
    return debounce_faults(x, evidence)


@kernel_helper
def update_fault_memory(x: StateTables, c: ConstantTables) -> None:
    """Update the stored values of the detectors that run while the motors are allowed to make torque."""
    missed_ticks = x.run_int[s.MISSED_TICKS]
    are_cells_tared = x.run_int[s.ARE_CELLS_TARED] == 1
    tendon_slip.update_tendon_slip(x, c, are_cells_tared)
    servo_commands.predict_reported_forces(x, c)
    residuals.update_residuals(x, c, missed_ticks, are_cells_tared)
    slack_history.update_slack_history(x, c)
    stuck_sensors.update_stuck_counts(x, c, are_cells_tared)
    torque_correlation.update_correlation(x, c, missed_ticks)
    replayed_readings.count_repeated_readings(x, are_cells_tared)
    tension_swings.update_tension_swing(x, c, are_cells_tared)


@kernel_helper
def debounce_faults(x: StateTables, evidence: EvidenceTable) -> int:
    """Count the consecutive ticks in which each fault is present.

    Return the most severe reaction that an active fault demands.
    """
    action = 0
    new_fault_count = 0
    for row in range(evidence.shape[0]):
        # The first loop always writes, so that the compiler can handle several numbers at once.
        has_evidence = 0
        for i in range(evidence.shape[1]):
            ticks = x.instance_int[s.FAULT_TICKS + row, i] + 1
            ticks = 0 if math.isnan(evidence[row, i]) else ticks
            x.instance_int[s.FAULT_TICKS + row, i] = ticks
            has_evidence |= ticks
        if has_evidence == 0:
            continue
        for i in range(evidence.shape[1]):
            ticks = x.instance_int[s.FAULT_TICKS + row, i]
            if ticks >= DEBOUNCE_TICKS[row]:
                action = max(action, ACTION_NUMBERS[row])
                new_fault_count += ticks == DEBOUNCE_TICKS[row]
    x.run_int[s.NEW_FAULT_COUNT] = new_fault_count
    return action
