"""Test the schema of a state block, the array views that compiled kernels use, and the digest of the block.

A state block contains the measurements, estimates and commands of a tick, and the values that the
next tick needs. The digest of a state block depends on every field of the block.
"""

import ast
import inspect
import random
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from handctl.controller.controller_state import (
    ClientLease,
    ControllerDecisions,
    ControllerState,
    layout_of_state,
)
from handctl.controller.monitor import safety_thresholds
from handctl.controller.pending_gains import PendingGains
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.core import constants, hand_constants
from handctl.core import state_block as state_block
from handctl.core.block_schema import INTEGER_TABLE_SUFFIX, BlockField, BlockSchema
from handctl.core.constants import (
    CONSTANT_SCHEMA,
    FILTER_DESIGN_COUNT,
    FILTER_DESIGN_SIZE,
    constant_tables,
)
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import MinimumJerk
from handctl.core.gains.gain_bounds import gains_with_values
from handctl.core.gains.gains import Gains
from handctl.core.hand_constants import HandConstants
from handctl.core.hand_model import HandModel
from handctl.core.state_block import STATE_SCHEMA, state_tables
from handctl.drives.cia404.amplifier import AmplifierState
from handctl.drives.contract import DrivePhase, DriveState
from handctl.drives.readback import ReadbackCursor
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand, packaged_hands
from handctl.programs.grip import GripState
from handctl.programs.program import ProgramProgress
from handctl.programs.stream_plans import StreamPlan
from handctl.safety.tick_verdict import LatchedFault, ReportedFault
from handctl.session.task_loading import load_task_for_hand
from tests.conftest import NIGHTLY
from tests.controller.controller_bench import ControllerBench
from tests.controller.synthetic_states import uncompiled_function
from tests.hand.many_motor_hands import fifteen_motor_hand

RANDOM_HAND_SEEDS = range(6)


def field_names(block_fields: list[BlockField]) -> list[str]:
    return [field.name for field in block_fields]


# Schema of a state block, and the memory layout that follows from the schema.


def small_schema() -> tuple[BlockSchema, dict[str, int]]:
    """Return a schema with three tables, and the lengths of the axes in this schema."""
    schema = BlockSchema("tendon", "joint*tendon", "run", "tendon_int")
    schema.declare_real_field("tension", "tendon", "N", "of a tendon", initial=2.5)
    schema.declare_real_field("past", "tendon", "N", "the last ones", rows=3)
    schema.declare_real_field("arms", "joint*tendon", "m", "moment arms")
    schema.declare_real_field("t", "run", "s", "time")
    schema.declare_integer_field("regime", "tendon", "", "of a tendon", initial=-1)
    return schema, {"tendon": 4, "joint": 2, "run": 1}


def test_a_field_has_its_rows_its_shape_and_its_initial_value() -> None:
    schema, axes = small_schema()
    layout = schema.layout(axes)
    assert layout.size == len(layout.initial) == 4 + 3 * 4 + 2 * 4 + 1 + 4
    shapes = {"tension": (4,), "past": (3, 4), "arms": (2, 4), "t": (1,), "regime": (4,)}
    assert {name: layout.view(layout.initial, name).shape for name in shapes} == shapes
    assert (layout.view(layout.initial, "tension") == 2.5).all()
    assert (layout.view(layout.initial, "regime") == -1).all()
    assert layout.view(layout.initial, "regime").dtype == np.int64
    assert not layout.initial.flags.writeable


def test_new_field_needs_one_line() -> None:
    """A new field of the schema gets the next row of its table.

    The older fields of a table keep their names and shapes when a field is added.
    """
    (schema_before, axes), (schema_after, _) = small_schema(), small_schema()
    row = schema_after.declare_real_field("speed", "tendon", "m/s", "of a tendon", initial=7.0)
    old_layout, new_layout = schema_before.layout(axes), schema_after.layout(axes)
    assert row == schema_before.rows("tendon") == schema_after.rows("tendon") - 1
    assert new_layout.size == old_layout.size + axes["tendon"]
    block = new_layout.initial.copy()
    np.testing.assert_array_equal(new_layout.table(block, "tendon")[row], np.full(4, 7.0))
    for field in schema_before.fields:
        np.testing.assert_array_equal(
            new_layout.view(block, field.name), old_layout.view(old_layout.initial, field.name)
        )
    assert new_layout.view(block, "speed").base is not None, "a view: changes go into the block"
    new_layout.view(block, "speed")[...] = 1.0
    assert (new_layout.table(block, "tendon")[row] == 1.0).all()


def test_fields_do_not_overlap_and_leave_no_gap() -> None:
    schema, axes = small_schema()
    layout = schema.layout(axes)
    count = np.zeros(layout.size)
    for field in schema.fields:
        field_view = layout.view(count, field.name)
        field_view += np.ones_like(field_view) if field_view.dtype == np.float64 else 0
    all_positions = np.concatenate([layout.view(np.arange(layout.size, dtype=np.float64), f.name).ravel()
                                    for f in schema.fields
                                    if not f.table.endswith(INTEGER_TABLE_SUFFIX)])  # fmt: skip
    assert len(set(all_positions.tolist())) == len(all_positions) == layout.size - 4
    assert (count[: layout.starts["tendon_int"]] == 1.0).all()


@pytest.fixture(params=["jamia", "jamia11"])
def state(request: pytest.FixtureRequest) -> ControllerState:
    """Return a controller's state that consists of random numbers.

    No two integers and no two floats in the returned state are equal.
    """
    model: HandModel = request.getfixturevalue(request.param)
    # A drive of this hand closes a position loop, so that no table of the state block is empty.
    axes = layout_of_state(model, 3).axes | {"servo": model.tendon_count}
    layout, rng = STATE_SCHEMA.layout(axes), np.random.default_rng(5)
    block = layout.initial.copy()
    for field in STATE_SCHEMA.fields:
        field_view = layout.view(block, field.name)
        is_integer = field.table.endswith(INTEGER_TABLE_SUFFIX)
        field_view[...] = (
            rng.integers(-(2**40), 2**40, field_view.shape)
            if is_integer
            else rng.normal(size=field_view.shape)
        )
    return ControllerState(
        layout, block, ControllerDecisions((), ProgramProgress.initial(len(model.digits), "test"))
    )


def constants_by_field(constant_module: Any) -> dict[str, str]:
    """Return a dictionary from the name of a field to the name of its module constant.

    The module constant of a field contains the index of the first row of this field in its table.
    The function reads the names of the constants from the source text of a module.
    """
    constant_by_field = {}
    for node in ast.parse(inspect.getsource(constant_module)).body:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Call)
            and isinstance(node.targets[0], ast.Name)
        ):
            function, first_argument = node.value.func, node.value.args[:1]
            if isinstance(function, ast.Name) and function.id in ("_real_field", "_integer_field"):
                assert isinstance(first_argument[0], ast.Constant)
                constant_by_field[str(first_argument[0].value)] = node.targets[0].id
    return constant_by_field


@pytest.mark.parametrize(
    ("schema", "constant_module"), [(STATE_SCHEMA, state_block), (CONSTANT_SCHEMA, constants)]
)
def test_every_field_is_declared_once_and_found_by_its_name(
    schema: BlockSchema, constant_module: Any
) -> None:
    names = field_names(schema.fields)
    assert len(set(names)) == len(names) > 50
    constant_by_field = constants_by_field(constant_module)
    assert set(constant_by_field) == set(names)
    assert len(set(constant_by_field.values())) == len(names)
    for field in schema.fields:
        assert getattr(constant_module, constant_by_field[field.name]) == field.first_row, (
            field.name
        )
        assert field.meaning, field.name


def test_kernels_see_every_field_where_the_layout_has_it(state: ControllerState) -> None:
    tables_of_kernel = uncompiled_function(state_tables)(state.block, state.layout.offsets)
    for field in STATE_SCHEMA.fields:
        rows = getattr(tables_of_kernel, field.table)[
            field.first_row : field.first_row + field.rows
        ]
        np.testing.assert_array_equal(
            rows.ravel(), state.view(field.name).ravel(), err_msg=field.name
        )
        assert np.shares_memory(rows, state.block), field.name
        assert rows.dtype == (
            np.int64 if field.table.endswith(INTEGER_TABLE_SUFFIX) else np.float64
        ), field.name


def test_a_copy_is_another_block_of_the_same_numbers(state: ControllerState) -> None:
    copy = state.copy()
    assert copy.digest() == state.digest()
    assert state.layout.first_difference(copy.block, state.block) is None
    for field in STATE_SCHEMA.fields:
        copy.view(field.name)[...] = 77
    assert not any((state.view(field.name) == 77).all() for field in STATE_SCHEMA.fields)


@pytest.mark.parametrize("field", STATE_SCHEMA.fields, ids=field_names(STATE_SCHEMA.fields))
def test_a_difference_names_its_field(state: ControllerState, field: BlockField) -> None:
    """The reported difference of two states names the first field that differs, in the order of the schema.

    The reported difference also contains the index of the first element that differs, and both
    values of this element.
    """
    other_state = state.copy()
    values = other_state.view(field.name).reshape(-1)
    at = len(values) // 2
    value_before, values[at] = values[at].item(), 3
    assert state.layout.first_difference(state.block, other_state.block) == (
        field.name,
        at,
        value_before,
        3,
    )
    for later_field in STATE_SCHEMA.fields[STATE_SCHEMA.fields.index(field) + 1 :]:
        other_state.view(later_field.name)[...] = 3
    difference = state.layout.first_difference(state.block, other_state.block)
    assert difference is not None
    assert difference[0] == field.name


def test_nan_is_the_same_as_nan_and_zero_is_not_minus_zero(state: ControllerState) -> None:
    one_state, other_state = state.copy(), state.copy()
    for changed_state in (one_state, other_state):
        changed_state.view("tension")[0] = np.nan
        changed_state.view("sigma")[0] = 0.0
    assert state.layout.first_difference(one_state.block, other_state.block) is None
    other_state.view("sigma")[0] = -0.0
    difference = state.layout.first_difference(one_state.block, other_state.block)
    assert difference is not None
    assert difference[:2] == ("sigma", 0)


# Block of the constants of a hand.


def random_hand(seed: int) -> HandModel:
    """Return the model of a random hand.

    The digits of the random hand are a random selection from a packaged hand, or from a hand with
    15 motors. The function varies the masses, springs and friction of the digits at random.
    """
    rng = random.Random(seed)
    content: dict[str, Any] = fifteen_motor_hand()
    if seed % 3:
        content = hand_content(("jamia", "jamia11")[seed % 3 - 1])
    digits = [digit["name"] for digit in content["digit"]]
    digit_names = sorted(rng.sample(digits, rng.randint(1, len(digits))), key=digits.index)

    def is_kept_section(drive_field: str) -> bool:
        return any(
            drive_field == digit or drive_field.startswith(f"{digit}_") for digit in digit_names
        )

    for section in ("digit", "tendon", "motor"):
        content[section] = [
            _randomised_section(entry, rng)
            for entry in content[section]
            if is_kept_section(entry["name"])
        ]
    node = content["sensor_node"]
    content["sensor_node"] = node | {
        key: [name for name in node[key] if is_kept_section(name)] for key in ("tendons", "joints")
    }
    return HandModel.from_hand(
        hand_from_content(content | {"name": f"random_{seed}"}, "test"), Gains(), 200.0
    )


RANDOMISED_KEYS = ("link_mass_kg", "joint_damping_N_m_s_per_rad", "spring_preload_rad", "friction_coefficient",
          "stiffness_N_per_m", "inertia_kg_m2", "coulomb_N_m")  # fmt: skip


def _randomised_section(section: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Return a section of a hand file in which numbers are varied at random."""
    randomised_section = dict(section)
    for key in RANDOMISED_KEYS:
        if key in randomised_section:
            factor = rng.uniform(0.8, 1.25)
            randomised_section[key] = (
                [factor * x for x in randomised_section[key]]
                if isinstance(randomised_section[key], list)
                else factor * randomised_section[key]
            )
    return randomised_section


def packed_constants(
    model: HandModel, monkeypatch: pytest.MonkeyPatch
) -> tuple[HandConstants, dict[str, object]]:
    """Return the block of constants of a hand model, and a dictionary from each field to its values in the block."""
    values: dict[str, object] = {"design": hand_constants.filter_design_array(model)}
    for group_name in (
        "_motor_constants",
        "_control_law_constants",
        "_link_constants",
        "_structure_constants",
        "_posture_constants",
    ):
        packed = getattr(hand_constants, group_name)(model)
        assert not values.keys() & packed.keys(), "each field is packed once"
        values |= packed

    def record_packed_values(model: HandModel, packed_values: dict[str, object]) -> HandConstants:
        assert not values.keys() & packed_values.keys(), "each field is packed once"
        values.update(packed_values)
        return HandConstants(model, packed_values)

    monkeypatch.setattr(safety_thresholds, "HandConstants", record_packed_values)
    drives, sensors = make_drives(model.hand), make_sensors(model.hand)
    limits = safety_thresholds.safety_limits(model, drives, sensors)
    tare, zero = np.random.default_rng(2).normal(size=(2, model.tendon_count))
    return safety_thresholds.compiled_constants(model, drives, sensors, limits, tare, zero), values


@pytest.mark.parametrize("hand", [*packaged_hands(), *RANDOM_HAND_SEEDS])
def test_every_constant_that_kernels_see_is_what_was_packed(
    hand: str | int, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = (
        random_hand(hand)
        if isinstance(hand, int)
        else HandModel.from_hand(load_hand(hand), Gains(), 200.0)
    )
    recorded_constants, values = packed_constants(model, monkeypatch)
    assert values.keys() == set(field_names(CONSTANT_SCHEMA.fields)), "every field is packed"
    assert not recorded_constants.block.flags.writeable
    tables_of_kernel = uncompiled_function(constant_tables)(
        recorded_constants.block, recorded_constants.layout.offsets
    )
    assert tables_of_kernel.design.shape == (
        model.tendon_count,
        FILTER_DESIGN_COUNT,
        FILTER_DESIGN_SIZE,
    )
    for field in CONSTANT_SCHEMA.fields:
        view = recorded_constants.layout.view(recorded_constants.block, field.name)
        value = np.asarray(values[field.name])
        np.testing.assert_array_equal(view, np.broadcast_to(value, view.shape), err_msg=field.name)
        if field.name == "design":
            np.testing.assert_array_equal(tables_of_kernel.design, value)
            continue
        table_name = f"{field.table.replace('*', '_')}_table" if "*" in field.table else field.table
        rows = getattr(tables_of_kernel, table_name)[field.first_row : field.first_row + field.rows]
        np.testing.assert_array_equal(rows.ravel(), view.ravel(), err_msg=field.name)
        assert np.shares_memory(rows, recorded_constants.block)


# Digest of a state.


@pytest.mark.parametrize("field", STATE_SCHEMA.fields, ids=field_names(STATE_SCHEMA.fields))
def test_every_element_of_every_field_changes_the_digest(
    active_bench: ControllerBench, field: BlockField
) -> None:
    """Change each element of a state by the smallest possible amount.

    Each change of an element must give another digest of the state.

    An ordinary test run changes only 16 elements of each field.
    """
    state = active_bench.state
    known_digests = {state.digest()}
    size = state.view(field.name).size
    for at in (
        range(size)
        if NIGHTLY
        else sorted({*np.linspace(0, size - 1, min(size, 16), dtype=int).tolist()})
    ):
        changed_state = state.copy()
        values = changed_state.view(field.name).reshape(-1)
        values[at] = (
            values[at] + 1
            if field.table.endswith(INTEGER_TABLE_SUFFIX)
            else np.nextafter(np.nan_to_num(values[at]), 9e9)
        )
        digest = changed_state.digest()
        assert len(digest) == 8
        assert digest not in known_digests, at
        known_digests.add(digest)


def goal_variants() -> Iterator[tuple[str, DigitGoal]]:
    move = MinimumJerk(np.array([0.1]), np.array([0.2]), 1.0)
    tension = np.array([5.0])
    yield "limp", DigitGoal()
    yield "motion", DigitGoal(GoalKind.MOTION, move, since=1.0)
    yield "since", DigitGoal(GoalKind.MOTION, move, since=2.0)
    for name, value in (("start", np.array([0.11])), ("end", np.array([0.21])), ("duration", 1.1)):
        yield name, DigitGoal(GoalKind.MOTION, replace(move, **{name: value}), since=1.0)
    yield "tension", DigitGoal(GoalKind.TENSION, tension=tension)
    yield "other tension", DigitGoal(GoalKind.TENSION, tension=tension + 1e-12)
    yield "rate", DigitGoal(GoalKind.TENSION, tension=tension, rate=201.0)
    yield "limit", DigitGoal(GoalKind.TENSION, tension=tension, force_limit=12.0)


def progress_variants(progress: ProgramProgress) -> Iterator[tuple[str, ProgramProgress]]:
    """Yield changed copies of ``progress``, the progress of a program.

    Each copy differs from the original in one attribute.

    For the attribute ``goals``, each copy has one changed goal.
    """
    grip = GripState(np.full(4, 20.0), np.full(4, np.nan), 1.0)
    values: dict[str, list[Any]] = {
        "step": [progress.step + 1], "since": [progress.since + 1e-9], "phase": ["x"], "finished": [True],
        "failure": ["x"], "record": [(1.0,)], "tare": [(1.0,)], "contact": [(True, *progress.contact[1:])],
        "touching": [(9, *progress.touching[1:])], "closing": [(True,) * 4, (False,) * 4],
        "grip": [grip, grip._replace(tension=np.full(4, 21.0)), grip._replace(reference_excursion=np.zeros(4)),
                 grip._replace(ready=2.0), grip._replace(tension_factor=1.2), grip._replace(is_limit_reported=True)],
        "goals": [progress.goals[::-1], *((goal, *progress.goals[1:]) for _, goal in goal_variants())],
        "task": [load_task_for_hand(None, load_hand(name))[0] for name in ("jamia", "t42")],
    }  # fmt: skip
    assert values.keys() == {field.name for field in fields(ProgramProgress)}, (
        "a new part of the progress needs a line here"
    )
    for name, other_field_values in values.items():
        for value in other_field_values:
            yield name, replace(progress, **{name: value})


EXAMPLE_STREAM = StreamPlan("s", "one", "digit", ("index",), "linear", 0.01, 0.014)
CHANGED_STREAM_VALUES = {
    "name": "t", "client": "two", "space": "joint", "names": ("thumb",), "interpolation": "minimum_jerk",
    "period": 0.02, "horizon": 0.015,
}  # fmt: skip


def decision_variants(decisions: ControllerDecisions) -> Iterator[tuple[str, ControllerDecisions]]:
    """Yield copies of a controller's decisions. Each copy differs from the original in one attribute."""
    pending_gains = PendingGains(gains_with_values(Gains(), {"motion.force_N": 21.0}, "test"))
    values: dict[str, list[Any]] = {
        "drives": [decisions.drives[::-1]],
        "progress": [progress for _, progress in progress_variants(decisions.progress)],
        "latched_faults": [
            (*decisions.latched_faults, LatchedFault("B01", "x")),
            (LatchedFault("B01", "y"),),
            (LatchedFault("B02", "x"),),
        ],
        "reported_faults": [
            (ReportedFault("B01", "x", 1),),
            (ReportedFault("B01", "x", 2),),
            (ReportedFault("B01", "y", 1),),
        ],
        "refusals": [(1,), (2,), (1, 2)],
        "failure": ["x"],
        "unconfirmed_motors": [("x",)],
        "gains": [pending_gains.gains],
        "pending_gains": [
            pending_gains,
            replace(pending_gains, designed_loop_count=1),
            replace(pending_gains, gains=Gains()),
        ],
        "commanding_client": ["one", "two"],
        "lease": [
            ClientLease(*lease_fields)
            for lease_fields in (
                ("a", 1, 2),
                ("b", 1, 2),
                ("a", 2, 2),
                ("a", 1, 1),
                ("a", 1, 2, True),
            )
        ],
        "amplifiers": [
            (AmplifierState(0x21),),
            (AmplifierState(0x22),),
            (AmplifierState(0x21, DrivePhase.READY),),
            (AmplifierState(0x21, cursor=ReadbackCursor(1)),),
            (AmplifierState(0x21, started_ns=1),),
            (AmplifierState(0x21, error_text="x"),),
            (AmplifierState(0x21), AmplifierState(0x22)),
        ],
        "stream": [
            EXAMPLE_STREAM,
            *(
                replace(EXAMPLE_STREAM, **{name: value})
                for name, value in CHANGED_STREAM_VALUES.items()
            ),
        ],
    }
    assert values.keys() == set(ControllerDecisions._fields), "a new decision needs a line here"
    for name, other_field_values in values.items():
        for value in other_field_values:
            yield name, decisions._replace(**{name: value})


def test_every_decision_changes_the_digest(active_bench: ControllerBench) -> None:
    state = active_bench.state
    name_by_digest = {state.digest(): "unchanged"}
    for name, changed in decision_variants(state.decisions):
        digest = ControllerState(state.layout, state.block, changed).digest()
        assert digest not in name_by_digest, f"{name} and {name_by_digest[digest]} have one digest"
        name_by_digest[digest] = name
    assert state.copy().digest() == state.digest()


def other_values(original_value: Any) -> list[Any]:
    """Return values that differ from a given value and have the same type.

    For a named tuple, each returned tuple differs from the given tuple in one field.
    """
    if isinstance(original_value, bool):
        return [not original_value]
    if isinstance(original_value, DrivePhase):
        return [phase for phase in DrivePhase if phase != original_value]
    if isinstance(original_value, int | float):
        return [original_value + 1]
    if isinstance(original_value, str):
        return [original_value + "x"]
    assert hasattr(original_value, "_fields"), original_value
    plain = {
        name: getattr(original_value, name)
        for name in original_value._fields
        if not isinstance(getattr(original_value, name), tuple)
    }
    return [
        original_value._replace(**{name: other_value})
        for name, field_value in plain.items()
        for other_value in other_values(field_value)
    ]


@pytest.mark.parametrize("drive_field", DriveState._fields)
def test_everything_that_is_known_of_a_drive_changes_the_digest(
    active_bench: ControllerBench, drive_field: str
) -> None:
    """The digest of a state depends on the measured values of each drive, and on the progress of the drive's set-up."""
    state = active_bench.state
    known_digests = {state.digest()}
    for n, drive in enumerate(state.drives):
        for value in other_values(getattr(drive, drive_field)):
            changed_state = state.copy()
            active_bench.controller.store_drive_state(
                changed_state, n, drive._replace(**{drive_field: value})
            )
            digest = changed_state.digest()
            assert digest not in known_digests, (n, value)
            known_digests.add(digest)
