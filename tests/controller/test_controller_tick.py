"""Test that a tick of the controller is a pure function.

With any received frames, equal inputs give equal outputs, and a tick does not change its inputs.
"""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.core import state_block as s
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TELEMETRY_AXES, HandMode, IoEvent, TickIn, TickOut
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand
from handctl.programs.live_session import LiveProgram
from handctl.safety.safety_action import SafetyAction
from tests.controller.controller_bench import ControllerBench, make_controller_bench


def run_session(hand_name: str) -> ControllerBench:
    """Return a test bench whose controller has executed a whole run.

    In the run, the hand was armed, moved, held a tension and relaxed. In addition, a frame was lost
    and a fault occurred.
    """
    rate = {"jamia": 200.0, "jamia11": 200.0}[hand_name]
    run = make_controller_bench(
        HandModel.from_hand(load_hand(hand_name), Gains(), rate), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    run.run(1.0)
    run.tick('{"do": "move", "angle_deg": {"middle": 20}, "duration_s": 0.3}')
    run.run(0.2)
    run.tick('{"do": "hold", "tension_N": {"index": 30, "thumb": 20}}', '{"do": "dance"}')
    run.modify_frames_to_host = lambda frames: frames[1:]
    run.tick()
    run.modify_frames_to_host = lambda frames: frames
    run.run(0.3)
    run.tick(io_events=(IoEvent("dropped", "local:x", 3),), lateness_ns=run.period_ns // 2)
    run.tick(missed_ticks=1)
    run.tick(extra_frames=(Frame(0x001, bytes(8), t_ns=run.k * run.period_ns),))
    run.run_until_mode(HandMode.DONE)
    return run


@pytest.fixture(scope="module", params=["jamia", "jamia11"])
def session_bench(request: pytest.FixtureRequest) -> ControllerBench:
    return run_session(request.param)


def comparable_outputs(tick_output: TickOut) -> tuple[object, ...]:
    """Return the outputs of a tick in a form that tests can compare. In this form, NaN equals NaN."""
    plain = (
        tick_output.frames,
        tick_output.mode,
        tick_output.phase,
        tick_output.action,
        tick_output.events,
        tick_output.state_hash,
    )
    return (*plain, tick_output.telemetry.to_bytes())


def test_equal_inputs_give_equal_outputs(session_bench: ControllerBench) -> None:
    """Each tick of a run is executed again from the state before this tick.

    All bytes of the outputs of a tick are equal in both executions.
    """
    for state_before, entry, out in session_bench.tick_history[::3]:
        digest = state_before.digest()
        state_after, again = session_bench.controller.tick(state_before, entry)
        assert comparable_outputs(again) == comparable_outputs(out)
        assert state_after.digest() == out.state_hash
        assert state_before.digest() == digest, "the state that went in is as it was"


def test_another_controller_of_the_same_hand_repeats_the_run(
    session_bench: ControllerBench,
) -> None:
    model = session_bench.controller.model
    other_controller = make_controller_bench(
        HandModel.from_hand(model.hand, model.gains, 1.0 / model.period), LiveProgram()
    ).controller
    state = other_controller.initial_state()
    for _, entry, out in session_bench.tick_history:
        state, again = other_controller.tick(state, entry)
        assert again.state_hash == out.state_hash, entry.k


def test_the_order_of_frames_within_a_tick_does_not_matter(session_bench: ControllerBench) -> None:
    random_generator = random.Random(3)
    shuffled_tick_count = 0
    for state_before, entry, out in session_bench.tick_history[::3]:
        frames = list(entry.frames)
        random_generator.shuffle(frames)
        _, again = session_bench.controller.tick(state_before, entry._replace(frames=tuple(frames)))
        assert comparable_outputs(again) == comparable_outputs(out)
        shuffled_tick_count += frames != list(entry.frames)
    assert shuffled_tick_count > 50


def test_frames_with_unknown_identifiers_change_no_decision(session_bench: ControllerBench) -> None:
    """Frames with unknown identifiers change only the counters of unknown frames.

    A frame with a known identifier and an unexpected flag counts as malformed.
    """
    noise = (Frame(0x666, bytes(8)), Frame(0x1A0, bytes(8), bus=3))
    misshapen_frame = Frame(0x011 | 1 << 31, bytes(8))
    for state_before, entry, out in session_bench.tick_history[::7]:
        _, again = session_bench.controller.tick(
            state_before, entry._replace(frames=(*noise, *entry.frames))
        )
        assert comparable_outputs(again._replace(state_hash=b"")) == comparable_outputs(
            out._replace(state_hash=b"")
        )
        _, again = session_bench.controller.tick(
            state_before, entry._replace(frames=(misshapen_frame, *entry.frames))
        )
        assert (again.frames, again.mode) == (out.frames, out.mode)


def test_the_origin_of_time_does_not_matter() -> None:
    """If a run starts 2560 ticks later, its modes, phases, actions and events stay the same.

    The later run is allowed to differ only in the SYNC counter and in the order in which registers
    are read.
    """
    model = HandModel.from_hand(load_hand("jamia"), Gains(), 200.0)
    runs = []
    for first_tick in (0, 2560):
        run = make_controller_bench(model, LiveProgram())
        run.k = first_tick
        run.state.run_integers[s.K] = first_tick - 1
        run.state.mode_start_time = first_tick * model.period
        run.run_until_mode(HandMode.ACTIVE)
        run.run(0.5)
        run.tick('{"do": "hold", "tension_N": {"index": 15}}')
        run.run(0.3)
        run.tick('{"do": "stop"}')
        run.run_until_mode(HandMode.DONE)
        runs.append(run)
    early_run, late = (run.tick_history for run in runs)
    assert len(early_run) == len(late)
    for (_, _, a), (_, _, b) in zip(early_run, late, strict=True):
        assert (a.mode, a.phase, a.action, [e.text for e in a.events]) == (
            b.mode,
            b.phase,
            b.action,
            [e.text for e in b.events],
        )
        commands = [[f for f in out.frames if f.can_id < 0x080] for out in (a, b)]
        assert commands[0] == commands[1]
        assert commands[0] or a.mode < HandMode.ARMING or a.mode == HandMode.DONE


def test_telemetry_has_the_declared_shapes_and_its_fields_change(
    session_bench: ControllerBench,
) -> None:
    hand = session_bench.controller.model.hand
    sizes = {
        "joint": len(hand.joints),
        "tendon": len(hand.tendon),
        "motor": len(hand.motor),
        "digit": len(hand.digit),
    }
    constant_fields = {"contact"} | ({"joint_encoder"} if not hand.sensor_node.joints else set())
    for name, axis in TELEMETRY_AXES.items():
        rows = [getattr(out.telemetry, name) for _, _, out in session_bench.tick_history]
        assert all(row.shape == (sizes[axis],) and row.dtype == np.float64 for row in rows), name
        values = np.array(rows)
        assert not np.isinf(values).any(), name
        if name not in constant_fields:
            assert len(np.unique(values[~np.isnan(values)])) > 1 or name == "motor_temperature", (
                name
            )


def test_old_values_have_no_new_time_stamp() -> None:
    """In a tick without frames, the telemetry contains NaN for every measurement.

    For each measured quantity, the telemetry also contains the age of the last measurement. In
    ticks without frames, this age grows from tick to tick.
    """
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 200.0), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.5)
    run.modify_frames_to_host = lambda frames: []
    ages = []
    for _ in range(3):
        out = run.tick()
        numbers = out.telemetry
        for name in (
            "tension_raw",
            "motor_position",
            "motor_velocity",
            "motor_torque",
            "innovation",
            "nis",
        ):
            assert np.isnan(getattr(numbers, name)).all(), name
        assert not np.isnan(numbers.tension).any(), "a prediction is there"
        ages.append(numbers.motor_age)
    np.testing.assert_allclose(np.diff(ages, axis=0), run.controller.model.period)


def test_missed_ticks_are_reported_and_many_of_them_relax() -> None:
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 200.0), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.5)
    assert run.tick(missed_ticks=1).action == SafetyAction.WARN
    run.run(0.1)
    stalled_tick_limit = run.controller.derived_constants.limits.stalled_ticks
    assert run.tick(missed_ticks=stalled_tick_limit - 1).action == SafetyAction.WARN
    run.run(0.1)
    out = run.tick(missed_ticks=stalled_tick_limit)
    assert (out.action, out.mode) == (SafetyAction.RELAX, HandMode.RELAX)
    assert "H03" in run.state.failure


def test_load_cells_wired_in_another_order_belong_to_their_tendons() -> None:
    """The channels of the sensor node are in reverse order in this test.

    In this test, the second frame of the sensor node is lost. The resulting fault names exactly the
    tendons whose channels are in the lost frame.
    """
    content = hand_content("jamia11")
    content["sensor_node"]["tendons"] = content["sensor_node"]["tendons"][::-1]
    run = make_controller_bench(
        HandModel.from_hand(hand_from_content(content, "reversed"), Gains(), 200.0), LiveProgram()
    )
    run.toy_hand.tendon_of_channel = list(range(11))[::-1]
    run.toy_hand.cell_bias[:] = np.linspace(0.0, 2.0, 11)
    run.run_until_mode(HandMode.ACTIVE)
    np.testing.assert_allclose(
        run.tick_history[-1][2].telemetry.tension_raw, run.toy_hand.cell_bias, atol=0.05
    )
    run.modify_frames_to_host = lambda frames: [frame for frame in frames if frame.can_id != 0x1A1]
    run.run_until_mode(HandMode.DONE)
    lost_instances = {mark.part_name for mark in run.state.latched_faults if mark.id == "N02"}
    assert lost_instances == set(run.controller.model.hand.tendon_names[::-1][5:10])


@pytest.mark.parametrize("non_finite_value", [np.nan, np.inf])
def test_no_frame_contains_nan(active_bench: ControllerBench, non_finite_value: float) -> None:
    state = active_bench.state.copy()
    state.view("travel")[0] = non_finite_value
    entry = TickIn(active_bench.k, active_bench.k * active_bench.period_ns)
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match="torque"):
        active_bench.controller.tick(state, entry)


KNOWN_IDENTIFIERS = [0x011, 0x012, 0x013, 0x014, 0x1A0, 0x1B0]
random_frames = st.builds(
    Frame,
    can_id=st.sampled_from(KNOWN_IDENTIFIERS) | st.integers(0, 0x7FF) | st.integers(0, 2**32 - 1),
    data=st.binary(max_size=8) | st.binary(max_size=64),
    flags=st.sampled_from([0, 4, 5]),
    bus=st.sampled_from([0, 0, 0, 1, 7]),
    t_ns=st.integers(-1, 2**62),
)


@given(frames_by_tick=st.lists(st.lists(random_frames, max_size=12), min_size=1, max_size=6))
def test_no_frame_can_stop_the_tick(
    active_bench: ControllerBench, frames_by_tick: list[list[Frame]]
) -> None:
    """A tick of an active hand raises no exception, whatever frames the controller receives.

    With any received frames, all commanded torques are finite and within their limits.
    """
    state, k = active_bench.state, active_bench.k
    for some in frames_by_tick:
        state, out = active_bench.controller.tick(
            state, TickIn(k, k * active_bench.period_ns, frames=tuple(some))
        )
        torque = out.telemetry.motor_torque_goal
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= active_bench.controller.model.torque_limit * (1 + 1e-9)).all()
        k += 1


@given(
    request_texts=st.lists(
        st.text(max_size=60) | st.sampled_from(['{"do": "clear"}', '{"do": "arm"}', "[" * 900]),
        max_size=4,
    ),
    event_kinds=st.lists(
        st.sampled_from(["enobufs", "dropped", "recorder", "error_frame", "signal", "?"]),
        max_size=4,
    ),
    lateness_ns=st.integers(0, 10**10),
    time_gap_ns=st.integers(0, 10**6),
)
def test_no_request_event_or_delay_can_stop_the_tick(
    active_bench: ControllerBench,
    request_texts: list[str],
    event_kinds: list[str],
    lateness_ns: int,
    time_gap_ns: int,
) -> None:
    k = active_bench.k + time_gap_ns
    events = tuple(IoEvent(kind, "x", 1) for kind in event_kinds)
    entry = TickIn(k, k * active_bench.period_ns, lateness_ns, (), events, tuple(request_texts))
    _, out = active_bench.controller.tick(active_bench.state, entry)
    assert all(event.text.isprintable() for event in out.events)


def test_a_hand_armed_under_tension_is_not_jerked() -> None:
    """When a hand is armed, the tension loop of each tendon starts at the present tension.

    The tendons can already be under tension, for example if the hand holds an object.
    """
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 200.0), LiveProgram()
    )
    run.toy_hand.spool_travel[:] = 0.3e-3 + 20.0 / run.toy_hand.tendon_stiffness
    run.toy_hand.locked_when_disabled = True
    run.run_until_mode(HandMode.ACTIVE)
    first_telemetry = run.tick_history[-1][2].telemetry
    np.testing.assert_allclose(first_telemetry.tension, 20.0, atol=6.0)
    assert (first_telemetry.motor_torque_goal > 0.0).all(), "no kick backwards"
