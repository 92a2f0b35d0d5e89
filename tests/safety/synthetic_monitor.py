"""Safety monitor of a generated hand, for tests that set the state of the monitor directly.

Each call of ``SyntheticMonitor.tick`` runs the fault detectors (``find_faults``) for one tick.
"""

from collections.abc import Iterable
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from handctl.compiled import compile_kernels
from handctl.controller.apply_requests import clear_latched_faults
from handctl.controller.controller_state import ControllerDecisions, ControllerState
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.constants import (
    CONSTANT_AXES,
    CONSTANT_SCHEMA,
    FILTER_DESIGN_COUNT,
    FILTER_DESIGN_SIZE,
    ConstantTables,
    constant_tables,
)
from handctl.core.detectors.fault_detection import empty_evidence
from handctl.core.detectors.residuals import QUICK_FORCE, TENSION
from handctl.core.hand_constants import low_pass_fractions
from handctl.core.state_block import STATE_SCHEMA, StateTables, state_tables
from handctl.core.tick_types import HandMode
from handctl.safety.faults.fault import (
    FAULT_PLACE_JOINT,
    FAULT_PLACE_MOTOR,
    FAULT_PLACE_NODE,
    FAULT_PLACE_TENDON,
)
from handctl.safety.faults.table import DETECTOR_ROWS
from handctl.safety.safety_limits import LOAD_CELL_NODE_NAME, SafetyLimits
from handctl.safety.tick_verdict import (
    EventReport,
    LatchedFault,
    ReportedFault,
    TickVerdict,
    judge_tick,
    newly_active_faults,
)
from tests.controller.synthetic_states import NO_TELEMETRY

PERIOD_S, NAN = 0.002, np.nan
SPOOL_RADIUS_M = 0.005
"""Radius of the spools [m]."""
NOW_NS = 10_000_000_000
"""Time of every tick [ns].

All ticks have the same time, because the detectors use only the ages of readings.
"""
PERIOD_NS = round(PERIOD_S * 1e9)
StateValues = dict[str, Any]
"""Values of the state by the name of a field: one value for all elements of the field, or one value per index."""


def synthetic_limits(tendon_count: int) -> SafetyLimits:
    """Return the safety limits of a generated hand with the tendons t0, t1, ...

    Each tendon of the generated hand has one motor and one joint.
    """
    names = [tuple(f"{letter}{i}" for i in range(tendon_count)) for letter in "tmj"]
    return SafetyLimits(
        *names, tension_trip=(140.0,) * tendon_count, drive_limit=(160.0,) * tendon_count,
        tension_rail=244.0, tension_low=-5.0, silent_ticks=6, silent_ticks_of_single_motor=4, stalled_ticks=5,
        max_frames_per_tick=64, max_position_noise=1e-4,
    )  # fmt: skip


class SyntheticMonitor:
    """Safety monitor of a generated hand with N tendons.

    Each tendon has a motor, a joint, and separate frames for its load cell and its joint encoder.

    The hand is active and at rest, and all nodes have just replied. The load cells read 20 N, and
    the commanded and the reported motor force is 20 N.

    Attributes:
        limits: names of the parts of the hand, and thresholds of the faults of the hand.
        layout, block: layout of the state, and the array with all values of the state.
        constants_layout, constants: layout of the constants, and the array with all constants.
            Tests can change the constants.
        latched, reported_faults: faults that are latched, and faults that were reported, in the
            form that ``safety.tick_verdict`` uses.
    """

    def __init__(
        self,
        limits: SafetyLimits,
        motor_period: Any = PERIOD_S,
        joint_period: float = PERIOD_S,
        **constants: Any,
    ) -> None:
        compile_kernels()
        n = len(limits.tendons)
        self.limits = limits
        sizes = dict.fromkeys((*s.STATE_AXES, *CONSTANT_AXES), n) | {
            "node": n + 1, "group": 2 * n, "instance": n + 1, "run": 1,
            "kind": FILTER_DESIGN_COUNT, "element": FILTER_DESIGN_SIZE, "place": 3,
        }  # fmt: skip
        self.layout = STATE_SCHEMA.layout({name: sizes[name] for name in s.STATE_AXES})
        self.constants_layout = CONSTANT_SCHEMA.layout(
            {name: sizes[name] for name in CONSTANT_AXES}
        )
        self.constants = self.constants_layout.initial.copy()
        motor_period = np.full(n, 1.0) * motor_period
        model = SimpleNamespace(period=PERIOD_S, tendon_count=n)
        self.set_constants(
            motor_mass=5.0, motor_damping=40.0, coulomb=3.0, mass=5.0, error_gain=4e3,
            stiffness=1e5, spool=SPOOL_RADIUS_M, arms_sum=0.02,
            excursion_to_joints=50.0 * np.eye(n), moves=np.eye(n), period=PERIOD_S, period_ns=PERIOD_NS,
            motor_period=motor_period, joint_period=joint_period,
            residual_fraction=low_pass_fractions(model, motor_period, joint_period),  # type: ignore[arg-type]
            cell_group=np.arange(n), joint_group=n + np.arange(n), tension_groups=n, mute_ns=30_000_000,
            answers_once=1, digit=np.arange(n), joints_first=np.arange(n), joints_end=np.arange(n) + 1,
            stream_hold_ns=100_000_000, stream_relax_ns=1_000_000_000,
        )  # fmt: skip
        self.replace_limits(limits)
        self.set_constants(**constants)
        self.block = self.layout.initial.copy()
        self.found_values = empty_evidence(self.layout)
        self.latched: tuple[LatchedFault, ...] = ()
        self.reported_faults: tuple[ReportedFault, ...] = ()
        self.set_state_values({
            "mode": int(HandMode.ACTIVE), "t_ns": NOW_NS, "feedback_ns": NOW_NS, "group_ns": NOW_NS, "started": 1,
            "measured_travel": 0.0, "measured_position": 0.0, "measured_tension": 20.0, "measured_force": 20.0,
            "asked": 20.0, "wanted": 20.0, "followed": 0.0, "temperature": 40.0, "phase": 3, "phase_before": 3,
            "residual": {TENSION: 20.0, QUICK_FORCE: 20.0}, "filtered": 1,
        })  # fmt: skip
        self.block_at_rest = self.block.copy()

    def replace_limits(self, limits: SafetyLimits) -> None:
        """Replace the names of the hand's parts and the fault thresholds, starting with the next tick."""
        self.limits = limits
        self.set_constants(
            tension_trip=limits.tension_trip, drive_limit=limits.drive_limit, noise_limit=limits.max_position_noise,
            temperature_soft=limits.temperature_soft, temperature_hard=limits.temperature_hard,
            tension_rail=limits.tension_rail, tension_low=limits.tension_low, silent_ticks=limits.silent_ticks,
            one_silent_ticks=limits.silent_ticks_of_single_motor, stalled_ticks=limits.stalled_ticks,
            frames_limit=limits.max_frames_per_tick,
        )  # fmt: skip

    def set_constants(self, **constant_by_name: Any) -> None:
        """Set the named constants of the hand to the given values."""
        for name, value in constant_by_name.items():
            self.constants_layout.view(self.constants, name)[...] = value

    def set_state_values(self, value_by_field: StateValues) -> None:
        """Set the named fields of the state to the given values."""
        for name, value in value_by_field.items():
            if isinstance(value, dict):
                for index, element in value.items():
                    self.view(name)[index] = element
            else:
                self.view(name)[...] = value

    def view(self, field_name: str) -> Any:
        """Return a field of the state as a view that can be changed."""
        return self.layout.view(self.block, field_name)

    def field_values(self, field_name: str) -> list[Any]:
        """Return a field of the state as a list."""
        return list(self.view(field_name).tolist())

    def reset_to_rest(self) -> None:
        """Reset all values to those of a hand at rest.

        Only the field ``fault_ticks`` keeps its values: the number of ticks for which each fault
        has been present.
        """
        fault_ticks = self.view("fault_ticks").copy()
        self.block[:] = self.block_at_rest
        self.set_state_values({"fault_ticks": fault_ticks})

    @property
    def state_tables(self) -> StateTables:
        """Return the tables of the state for functions that run as Python code without compilation."""
        return _uncompiled_helper(state_tables)(self.block, self.layout.offsets)

    @property
    def hand_tables(self) -> ConstantTables:
        """Return the tables of the constants for functions that run as Python code without compilation."""
        return _uncompiled_helper(constant_tables)(self.constants, self.constants_layout.offsets)

    def tick(
        self, value_by_field: StateValues | None = None, **more_values: Any
    ) -> dict[str, dict[str, float]]:
        """Set values of the state, and run the fault detectors for one tick.

        Return, for each fault, a dictionary from the affected part of the hand to the value that
        the detector has found.
        """
        self.set_state_values({**(value_by_field or {}), **more_values})
        self.demanded_action = tick_stages.find_faults(
            self.block,
            self.layout.offsets,
            self._read_only_constants(),
            self.constants_layout.offsets,
            self.layout.initial,
            self.found_values,
        )
        reported: dict[str, dict[str, float]] = {}
        for row, i in zip(*np.nonzero(~np.isnan(self.found_values)), strict=True):
            fault, kind = DETECTOR_ROWS[row]
            reported.setdefault(fault.id, {})[self.instance_name(kind, i) or fault.name] = float(
                self.found_values[row, i]
            )
        return reported

    def observe_readings(self, value_by_field: StateValues | None = None) -> None:
        """Convert received values to measurements, and reject impossible positions.

        In a run, each tick converts the received values before the detectors run.
        """
        self.set_state_values(value_by_field or {})
        tick_stages.observe_tick(
            self.block,
            self.layout.offsets,
            self._read_only_constants(),
            self.constants_layout.offsets,
        )

    def store_commands(self, value_by_field: StateValues | None = None) -> None:
        """Store the commands of the present tick. A run stores the commands at the end of each tick."""
        self.set_state_values(value_by_field or {})
        tick_stages.store_commands(
            self.block,
            self.layout.offsets,
            self._read_only_constants(),
            self.constants_layout.offsets,
            *NO_TELEMETRY,
        )

    def judge(
        self, value_by_field: StateValues | None = None, reports: Iterable[EventReport] = ()
    ) -> TickVerdict:
        """Return the verdict of the safety monitor on one tick.

        The verdict contains the action and the reported faults. The verdict depends on the findings
        of the detectors, the latched faults, and events of buses and host.
        """
        self.tick(value_by_field)
        return self.conclude(self.demanded_action, reports)

    def conclude(self, demanded_action: int, reports: Iterable[EventReport]) -> TickVerdict:
        """Latch the findings of a tick, add events of buses and host, and select the action of the monitor."""
        fresh = newly_active_faults(self.limits, self.found_values, self.view("fault_ticks"))
        verdict = judge_tick(self.latched, self.reported_faults, fresh, demanded_action, reports)
        self.latched, self.reported_faults = verdict.latched_faults, verdict.reported_faults
        return verdict

    def clear_latched(self) -> None:
        """Clear the latched faults. In a run, a request of the operator clears the latched faults."""
        decisions = ControllerDecisions((), None, self.latched, self.reported_faults)  # type: ignore[arg-type]
        state = ControllerState(self.layout, self.block, decisions)
        clear_latched_faults(state)
        self.latched, self.reported_faults = state.latched_faults, state.decisions.reported_faults

    def instance_name(self, part_kind: str, part_index: int) -> str:
        """Return the name of the part that has a fault, or an empty text for a fault of the whole hand."""
        names = {
            FAULT_PLACE_TENDON: self.limits.tendons,
            FAULT_PLACE_MOTOR: self.limits.motors,
            FAULT_PLACE_JOINT: self.limits.joints,
        }
        return (
            {**names, FAULT_PLACE_NODE: (*self.limits.motors, LOAD_CELL_NODE_NAME)}[part_kind][
                part_index
            ]
            if part_kind in {*names, FAULT_PLACE_NODE}
            else ""
        )

    def _read_only_constants(self) -> Any:
        constants = self.constants.view()
        constants.flags.writeable = False
        return constants


def _uncompiled_helper(kernel_helper: Any) -> Any:
    """Return an uncompiled copy of a kernel helper, which is a function that only compiled kernels call.

    The copy calls an uncompiled copy of each kernel helper that the original calls.
    """
    if not hasattr(kernel_helper, "py_func"):
        return kernel_helper
    python_function = kernel_helper.py_func
    global_names = dict(python_function.__globals__)
    global_names |= {
        name: _uncompiled_helper(global_names[name])
        for name in python_function.__code__.co_names
        if hasattr(global_names.get(name), "py_func")
    }
    return FunctionType(
        python_function.__code__,
        global_names,
        python_function.__name__,
        python_function.__defaults__,
    )


def call_interpreted(kernel_helper: Any, *arguments: Any) -> Any:
    """Run a kernel helper as Python code, without compiling it.

    A kernel helper is a function that only compiled kernels call. A kernel helper can call other
    kernel helpers of its module.
    """
    with np.errstate(all="ignore"):
        return _uncompiled_helper(kernel_helper)(*arguments)
