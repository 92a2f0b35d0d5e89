"""Test streamed targets in lockstep: interpolation, limits, late targets, faulty clients, and permission to command."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from handctl.controller.controller_state import layout_of_state
from handctl.controller.state_snapshot import restore_state, snapshot_bytes
from handctl.controller.target_streams import stream_status
from handctl.core import state_block as s
from handctl.core.control_law.digit_goal import GoalKind
from handctl.core.control_law.streamed_motion import begin_segments
from handctl.core.control_law.trajectory import StreamedTrajectory
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, StreamTarget, TickOut, TickRequest
from handctl.hand.dynamics import static_torque
from handctl.programs.live_session import LiveProgram
from handctl.programs.requests import is_stream_target, parse_target, target_request_text
from handctl.programs.stream_plans import (
    blended_move,
    mapping_of_stream,
    nearest_holdable_posture,
    target_horizon_s,
)
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings, homed_controller

RATE_HZ = 100.0
SINE_MIDDLE_DEG, SINE_AMPLITUDE_DEG = 30.0, 20.0


def sine_angle(t: Any) -> Any:
    """Return the angle [deg] of the test motion at time t [s]. The test motion is a sine of 1 Hz."""
    return SINE_MIDDLE_DEG + SINE_AMPLITUDE_DEG * np.sin(2.0 * math.pi * t)


class StreamClient:
    """A client that commands a simulated hand in lockstep.

    Attributes:
        run: the simulation of the hand.
        sent: number of targets that the client has sent so far.
        tick_outputs: outputs of all ticks since the controller started to wait for requests.
    """

    def __init__(self, run: SimulatedRun, model: HandModel, client_name: str = "one") -> None:
        self.run, self.model, self.name, self.sent = run, model, client_name, 0
        self.tick_outputs = list[TickOut]()
        assert run.run_until(lambda out: out.phase == "live", 5.0)

    @property
    def t_ns(self) -> int:
        """Return the time of the next tick [ns]."""
        return self.run.k * self.run.period_ns

    def tick(self, *requests: TickRequest) -> TickOut:
        """Run a tick in which the given requests arrive, and return the output of the tick."""
        self.tick_outputs.append(self.run.run_tick(requests=requests))
        return self.tick_outputs[-1]

    def wait(self, duration_s: float) -> None:
        """Run ticks for ``duration_s`` seconds, without any request to the controller."""
        for _ in range(round(duration_s / self.model.period)):
            self.tick()

    def send_command(self, request_kind: str, **request_fields: Any) -> str:
        """Send a command, and return the text of the last event about this command."""
        out = self.tick(json.dumps({"do": request_kind, "client": self.name, **request_fields}))
        return [event.text for event in out.events if event.name == "request"][-1]

    def open_stream(
        self,
        target_space: str = "digit",
        coordinate_names: tuple[str, ...] = ("index",),
        **request_fields: Any,
    ) -> str:
        """Request a stream of targets, and return the text of the last event about this request."""
        request_fields = {"interpolation": "linear", "rate_Hz": RATE_HZ} | request_fields
        return self.send_command(
            "stream", stream="s", space=target_space, names=coordinate_names, **request_fields
        )

    def target_request(
        self, *target_values: float, sequence_number: int | None = None, age_s: float = 0.0
    ) -> StreamTarget:
        """Return a streamed target that was sent ``age_s`` seconds ago."""
        self.sent += sequence_number is None
        return StreamTarget(
            "s",
            self.sent if sequence_number is None else sequence_number,
            self.t_ns - round(1e9 * age_s),
            target_values,
        )

    def stream_motion(
        self, motion: Callable[[float], float], duration_s: float, rate_Hz: float = RATE_HZ
    ) -> None:
        """Stream the values of a motion at a regular rate."""
        ticks_per_target = round(1.0 / rate_Hz / self.model.period)
        for i in range(round(duration_s / self.model.period)):
            self.tick(
                *(
                    [self.target_request(motion(i * self.model.period))]
                    if i % ticks_per_target == 0
                    else []
                )
            )

    @property
    def reported_faults(self) -> set[str]:
        """Return the identifiers of all faults that the controller has reported so far."""
        return {
            event.text.split()[0]
            for out in self.tick_outputs
            for event in out.events
            if event.name == "fault"
        }

    def goal_history(self, telemetry_field: str) -> Any:
        """Return the goals of the first joint or tendon in all ticks so far.

        ``telemetry_field`` is the name of the telemetry field that contains the goals.
        """
        return np.array([getattr(out.telemetry, telemetry_field)[0] for out in self.tick_outputs])


@contextmanager
def live_client(model: HandModel) -> Iterator[StreamClient]:
    """Yield a client of a simulated hand. The controller of the hand waits for requests."""
    hand = model.hand.name
    with SimulatorSettings(hand, homed=True).begin_run(
        homed_controller(model, LiveProgram())
    ) as run:
        yield StreamClient(run, model)


def true_angle(run: SimulatedRun) -> float:
    """Return the mean joint angle of the first digit in the simulator [deg]."""
    return float(np.degrees(run.simulated_hand.world.plant.engine.q[:3]).mean())


def test_a_streamed_sine_is_followed_like_a_trajectory(jamia: HandModel) -> None:
    """Test the tracking error of a streamed sine, if the client knows the sine in advance.

    The hand reaches a streamed target only after a delay (``horizon_s``). The client knows the
    motion, so it sends the angle that the hand should have after the delay of the stream.
    """
    errors = {}
    for interpolation in ("linear", "minimum_jerk"):
        with live_client(jamia) as client:
            client.send_command("move", angle_deg={"index": SINE_MIDDLE_DEG})
            client.wait(1.2)
            assert client.open_stream(interpolation=interpolation).startswith(
                "stream digit of 1 values at 100 Hz"
            )
            client.tick_outputs.clear()
            began_ns, horizon = client.t_ns, target_horizon_s(RATE_HZ, jamia.period)
            missed = []
            for _ in range(3):
                for i in range(round(1.0 / jamia.period)):
                    missed.append(
                        true_angle(client.run) - sine_angle((client.t_ns - began_ns) / 1e9)
                    )
                    client.tick(
                        *(
                            [client.target_request(sine_angle(i * jamia.period + horizon))]
                            if i % 5 == 0
                            else []
                        )
                    )
            errors[interpolation] = float(np.sqrt(np.mean(np.square(missed[len(missed) // 3 :]))))
            assert client.reported_faults == set()
            assert stream_status(client.run.state).accepted == 300
            assert stream_status(client.run.state).clipped == 0
    known_error = rms_error_of_trajectory(jamia)
    assert errors["linear"] < 1.5 * known_error, (errors, known_error)
    assert errors["minimum_jerk"] < 1.2 * known_error, (errors, known_error)


def rms_error_of_trajectory(model: HandModel) -> float:
    """Run a task file with the test sine as a trajectory, and return the RMS tracking error [deg]."""
    times = np.arange(0.0, 3.001, 0.02)
    hold_phase = {
        "kind": "move",
        "name": "stay",
        "angle_deg": {"index": SINE_MIDDLE_DEG},
        "duration_s": 1.0,
    }
    angles = {"index": sine_angle(times).tolist()}
    follow_phase = {
        "kind": "follow",
        "name": "follow",
        "time_s": times.tolist(),
        "angle_deg": angles,
    }
    task = {"schema": 1, "name": "sine", "phase": [hold_phase, follow_phase]}
    program = TaskProgram(Task.model_validate_json(json.dumps(task)))
    with SimulatorSettings(model.hand.name, homed=True).begin_run(
        homed_controller(model, program)
    ) as run:
        began, missed = None, []
        while run.last_output is None or run.last_output.mode != HandMode.DONE:
            if run.last_output is not None and run.last_output.phase == "follow":
                began = run.k - 1 if began is None else began
                t = (run.k - began) * model.period
                if 1.0 < t < 3.0:
                    missed.append(true_angle(run) - sine_angle(t))
            run.run_tick()
    return float(np.sqrt(np.mean(np.square(missed))))


def test_the_ticks_of_a_stream_repeat_to_the_last_bit(jamia: HandModel) -> None:
    """Recorded ticks give equal results when they are executed again.

    The test executes the recorded ticks again from the start of the run, and from a snapshot in the
    middle of the stream.
    """
    with live_client(jamia) as client:
        client.open_stream(
            target_space="joint",
            coordinate_names=("index_j1", "index_j2", "index_j3", "thumb_j1"),
            interpolation="minimum_jerk",
        )
        for i in range(100):
            angles = [sine_angle(i / 100) + j for j in range(3)]
            client.tick(*([client.target_request(*angles, 10.0)] if i % 5 == 0 else []))
            if i == 50:
                middle_snapshot, at = (
                    snapshot_bytes(client.run.state),
                    len(client.run.recorded_ticks),
                )
        check_reexecuted_ticks(client.run, middle_snapshot, at)


def check_reexecuted_ticks(run: SimulatedRun, snapshot: bytes, snapshot_tick: int) -> None:
    """Check that the ticks of a run give equal results, to the last bit, when they are executed again.

    The function executes the ticks again from the start of the run, and from a snapshot after
    ``snapshot_tick`` ticks.
    """
    controller = run.controller
    for state, ticks in (
        (controller.initial_state(), run.recorded_ticks),
        (
            restore_state(controller.derived_constants.layout, snapshot),
            run.recorded_ticks[snapshot_tick:],
        ),
    ):
        for entry, out in ticks:
            state, again = controller.tick(state, entry)
            assert again.state_hash == out.state_hash


@pytest.mark.parametrize("interpolation", ["linear", "minimum_jerk"])
@pytest.mark.parametrize("target_value", [80.0, 150.0, -40.0])
def test_a_jump_is_bounded_in_speed_acceleration_and_range(
    jamia: HandModel, interpolation: str, target_value: float
) -> None:
    limits = jamia.hand.stream
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": 40.0})
        client.wait(1.2)
        client.open_stream(interpolation=interpolation)
        client.tick_outputs.clear()
        client.stream_motion(lambda t: target_value, 0.8)
        speed, angle = (
            np.degrees(client.goal_history("dq_goal")),
            np.degrees(client.goal_history("q_goal")),
        )
        assert np.abs(speed).max() <= limits.speed_deg_s * (1 + 1e-9)
        assert np.abs(np.diff(speed)).max() <= limits.acceleration_deg_s2 * jamia.period * (
            1 + 1e-9
        )
        assert np.abs(np.diff(angle)).max() <= limits.speed_deg_s * jamia.period * (1 + 1e-9)
        assert angle.min() >= -1e-9
        assert angle.max() <= 100.0 + 1e-9
        if target_value == 150.0:  # the finger touches the palm before it reaches its goal
            assert 7.0 < angle[-1] - true_angle(client.run) < 9.0
        else:
            assert angle[-1] == pytest.approx(max(target_value, 0.0), abs=1e-6)
        clipped = stream_status(client.run.state).clipped
        assert clipped == (0 if target_value == 80.0 else client.sent), "reported, and no fault"
        assert client.run.last_output is not None
        assert client.run.last_output.mode == HandMode.ACTIVE


def test_a_random_stream_never_leaves_the_limits(jamia: HandModel) -> None:
    """The streamed targets are random angles at random times, such as a faulty policy would send.

    The test of random targets runs with twenty seeds.
    """
    limits, period = jamia.hand.stream, jamia.period
    with live_client(jamia) as client:
        for seed in range(20):
            random = np.random.default_rng(seed)
            client.open_stream(interpolation=("linear", "minimum_jerk")[seed % 2])
            client.sent = 0
            client.tick_outputs.clear()
            for _ in range(100):
                client.tick(
                    *[
                        client.target_request(random.uniform(-30.0, 130.0))
                        for _ in range(random.integers(0, 3))
                    ]
                )
            speed, angle = (
                np.degrees(client.goal_history("dq_goal")),
                np.degrees(client.goal_history("q_goal")),
            )
            assert np.abs(np.diff(speed)).max() <= limits.acceleration_deg_s2 * period * (1 + 1e-9)
            assert np.abs(speed).max() <= limits.speed_deg_s * (1 + 1e-9)
            assert -1e-9 <= angle.min() <= angle.max() <= 100.0 + 1e-9
            tension = np.array([out.telemetry.tension_goal for out in client.tick_outputs])
            assert np.nanmax(tension - jamia.ceiling) <= 1e-9


def test_a_stale_stream_holds_then_relaxes(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 60.0 * t, 0.5)
        client.tick_outputs.clear()
        client.wait(0.09)
        assert client.reported_faults == set()
        client.wait(0.03)
        assert client.reported_faults == {"I11a"}
        at = client.goal_history("q_goal")[-1]
        client.wait(0.3)
        assert client.goal_history("q_goal")[-1] == at, "held"
        client.stream_motion(lambda t: math.degrees(at) + 20.0 * t, 0.3)
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE, "the next target goes on"
        assert client.goal_history("q_goal")[-1] > at + math.radians(4.0)
        client.wait(1.2)
        assert client.reported_faults == {"I11a", "I11b"}
        assert client.tick_outputs[-1].mode >= HandMode.RELAX


def test_a_late_target_waits_at_the_last_one(jamia: HandModel) -> None:
    """While a target is late, the controller does not extrapolate the stream.

    The reference angle brakes only after it has reached the last target. The reference angle
    overshoots the last target by at most the braking distance, and then returns to the last target.
    """
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 50.0 * t, 0.5)
        last_angle = 50.0 * (0.5 - 1.0 / RATE_HZ)
        client.tick_outputs.clear()
        client.wait(0.06)
        angle = np.degrees(client.goal_history("q_goal"))
        braking_distance_deg = 50.0**2 / (2.0 * jamia.hand.stream.acceleration_deg_s2)
        assert angle.max() <= last_angle + braking_distance_deg + 0.2
        assert angle[-1] == pytest.approx(last_angle, abs=1e-6)
        assert np.degrees(client.goal_history("dq_goal"))[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "target_values",
    [(math.nan,), (math.inf,), (1e308,), (-1e308,), (721.0,), (), (1.0, 2.0)],
)
def test_invalid_target_is_counted_without_effect(
    jamia: HandModel, target_values: tuple[float, ...]
) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 20.0, 0.3)
        goal_before = client.goal_history("q_goal")[-1]
        for _ in range(5):
            client.tick(client.target_request(*target_values))
        client.wait(0.02)
        assert client.goal_history("q_goal")[-1] == pytest.approx(goal_before, abs=1e-9)
        status = stream_status(client.run.state)
        assert (status.refused, status.accepted) == (5, 30)
        refusals = [
            event for out in client.tick_outputs for event in out.events if event.name == "stream"
        ]
        assert len(refusals) == 1, "reported once, so that a flood does not fill the log"
        client.stream_motion(lambda t: 20.0, 0.1)
        assert client.reported_faults == set()
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE


@pytest.mark.parametrize(
    "target_text",
    [
        "", "7", "[]", '"stream": "s"}', '"stream": "s", "n": 1.5, "sent_ns": 1, "values": []}',
        '"stream": "s", "n": 1, "sent_ns": 1, "values": [null]}',
        '"stream": "s", "n": 1, "sent_ns": 1, "values": "1"}', "[" * 5000,
    ],
)  # fmt: skip
def test_a_text_that_is_no_target_is_counted(target_text: str) -> None:
    request_text = '{"do": "target", ' + target_text
    assert is_stream_target(request_text)
    target = parse_target(request_text)
    assert target is None or target.values == (1.0,)


@pytest.mark.parametrize("target_value", [0.1 + 0.2, 1e308, -0.0, 5e-324, math.inf, math.nan])
def test_a_target_survives_the_log(target_value: float) -> None:
    """The controller receives streamed targets in decoded form.

    A re-execution of the run decodes the targets from the texts in the log. A target in the
    re-execution must have exactly the same bits as in the run.
    """
    target = StreamTarget("17-3", 2**62, -(2**40), (target_value, 1.0 / 3.0))
    repeated_target = parse_target(target_request_text(target))
    assert repeated_target is not None
    assert repeated_target[:3] == target[:3]
    assert np.array(repeated_target.values).tobytes() == np.array(target.values).tobytes()


@pytest.mark.parametrize(
    ("sequence_number", "sent_ns"), [(2**70, 0), (-(2**64), 0), (0, 2**63), (0, -(2**70))]
)
def test_integers_beyond_64_bits_do_not_end_the_run(
    jamia: HandModel, sequence_number: int, sent_ns: int
) -> None:
    """Reproduce a defect: a target with an integer of more than 64 bits in its text raised OverflowError in the tick.

    After the exception, the controller disabled all motors.
    """
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 20.0, 0.3)
        client.tick(target_request_text(StreamTarget("s", sequence_number, sent_ns, (80.0,))))
        client.wait(0.02)
        assert math.degrees(client.goal_history("q_goal")[-1]) < 21.0
        assert stream_status(client.run.state).refused == 1
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE


def test_repeated_overtaken_and_old_targets_are_ignored(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 20.0, 0.3)
        at = client.goal_history("q_goal")[-1]
        client.tick(
            client.target_request(80.0, sequence_number=client.sent),
            client.target_request(80.0, sequence_number=3),
        )
        client.tick(client.target_request(80.0, age_s=0.05), client.target_request(80.0, age_s=0.2))
        client.wait(0.02)
        assert client.goal_history("q_goal")[-1] == pytest.approx(at, abs=1e-9)
        assert stream_status(client.run.state).late == 4


def test_a_target_from_the_future_counts_as_sent_now(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        client.tick(client.target_request(10.0, age_s=-1e6))
        assert 0.0 <= stream_status(client.run.state).age_s <= jamia.period
        client.wait(0.2)
        assert client.reported_faults == {"I11a"}, (
            "it does not silence the watch for a million seconds"
        )


def test_targets_between_the_deadline_and_a_late_tick_are_in_order(jamia: HandModel) -> None:
    """If a tick is late, a client can send a target after the scheduled time of the tick.

    The controller sets the time of such a target back to the scheduled time of the tick. Two such
    targets of one tick therefore have the same time. Earlier defect: the controller refused the
    second target, because the time of the second target was not later than the time of the first.
    """
    with live_client(jamia) as client:
        client.open_stream()
        client.tick(
            client.target_request(10.0, age_s=-1e-4), client.target_request(10.0, age_s=-2e-4)
        )
        assert stream_status(client.run.state)[2:4] == (2, 0), "accepted and clipped"
        assert stream_status(client.run.state).late == 0


def test_a_jittering_stream_is_smooth(jamia: HandModel) -> None:
    """In this test, targets arrive up to 8 ms late, and some targets are lost.

    In spite of late and lost targets, the reference angle follows the streamed motion, and no fault
    occurs.
    """
    random = np.random.default_rng(4)
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": SINE_MIDDLE_DEG})
        client.wait(1.2)
        client.open_stream(interpolation="minimum_jerk")
        client.tick_outputs.clear()
        began_ns, waiting = client.t_ns, list[tuple[int, StreamTarget]]()
        for i in range(1000):
            if i % 5 == 0 and random.random() > 0.05:
                text = client.target_request(sine_angle((client.t_ns - began_ns) / 1e9))
                waiting.append((client.t_ns + int(random.uniform(0, 8e6)), text))
            due = [text for at, text in waiting if at <= client.t_ns]
            waiting = [(at, text) for at, text in waiting if at > client.t_ns]
            client.tick(*due)
        late = np.degrees(client.goal_history("q_goal"))[250:] - sine_angle(
            np.arange(250, 1000) * jamia.period - target_horizon_s(RATE_HZ, jamia.period)
        )
        assert np.sqrt(np.mean(late**2)) < 0.6
        assert client.reported_faults == set()


def test_a_stream_goes_on_from_a_moving_digit(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": 80.0})
        client.wait(0.5)
        tick_count_before = len(client.tick_outputs)
        client.open_stream(interpolation="minimum_jerk")
        client.stream_motion(lambda t: 40.0 + 100.0 * t, 0.2)
        speed = np.degrees(client.goal_history("dq_goal"))
        assert speed[tick_count_before - 1] > 100.0
        limit = jamia.hand.stream.acceleration_deg_s2 * jamia.period
        assert np.abs(np.diff(speed[tick_count_before - 5 :])).max() <= limit * (1 + 1e-9)
        client.send_command("move", angle_deg={"index": 20.0})
        client.wait(1.1)
        speed = np.degrees(client.goal_history("dq_goal"))
        assert np.abs(np.diff(speed[tick_count_before:])).max() <= limit * (1 + 1e-9), (
            "and a move goes on from the stream"
        )
        assert np.degrees(client.goal_history("q_goal"))[-1] == pytest.approx(20.0)
        assert client.run.state.decisions.stream is None, "which the move has ended"


def test_goals_with_a_long_horizon_move_the_hand(jamia: HandModel) -> None:
    """Reproduce a defect: each new goal began a trajectory that started at the estimated angle with zero speed.

    A hand that got 50 goals per second did not move, because each trajectory started again with
    zero speed.
    """
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": SINE_MIDDLE_DEG})
        client.wait(1.2)
        client.tick_outputs.clear()
        for i in range(round(3.0 / jamia.period)):
            if i % 10 == 0:
                client.send_command(
                    "move", angle_deg={"index": sine_angle(i * jamia.period / 4.0)}, duration_s=0.5
                )
            else:
                client.tick()
        swing_amplitude = np.degrees([out.telemetry.q[0] for out in client.tick_outputs[500:]])
        assert np.ptp(swing_amplitude) > 20.0


def test_a_long_move_of_a_fast_digit_stays_within_the_range() -> None:
    """A digit that is already fast when it gets a new target stays within the joint range.

    A quintic polynomial that starts at 300 deg/s and lasts five seconds would overshoot its target
    by 280 degrees.
    """
    reference = np.radians([[90.0], [300.0], [0.0]])
    reach = np.radians([0.0]), np.radians([100.0])
    move = blended_move(reference, np.radians([10.0]), 5.0, reach)
    trajectory = np.degrees([move.motion_at(t)[:, 0] for t in np.linspace(0.0, 5.0, 5001)])
    assert trajectory[:, 0].max() <= 100.5
    assert trajectory[0] == pytest.approx([90.0, 300.0, 0.0])
    assert trajectory[-1] == pytest.approx([10.0, 0.0, 0.0], abs=1e-9)


def test_three_goals_out_of_range_are_no_fault(jamia: HandModel) -> None:
    """Reproduce a defect: three goals outside of their limits caused a latched fault that relaxed the hand."""
    with live_client(jamia) as client:
        for _ in range(5):
            assert "from 0 to 100 deg" in client.send_command("move", angle_deg={"index": 120.0})
        client.wait(0.1)
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE
        assert client.reported_faults == {"I07a"}
        client.tick("{", "nonsense", '{"do": "fly"}')
        client.wait(0.01)
        assert client.tick_outputs[-1].mode >= HandMode.RELAX, (
            "a client that speaks no sense is stopped"
        )


def test_one_client_commands_and_another_takes_over(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 20.0, 0.2)
        client.name = "two"
        for request_kind, request_fields in (
            ("move", {"angle_deg": {"thumb": 5.0}}),
            ("hold", {"tension_N": {"thumb": 8.0}}),
        ):
            assert (
                client.send_command(request_kind, **request_fields)
                == "refused: one commands this hand, expected take_over"
            )
        client.wait(0.02)
        assert client.reported_faults == set()
        client.send_command("stay", take_over=True)
        assert client.run.state.decisions.stream is None
        assert client.send_command("move", angle_deg={"thumb": 5.0}) == "move thumb 5"
        client.name = "one"
        client.tick(client.target_request(90.0))
        assert client.send_command("move", angle_deg={"index": 5.0}).startswith(
            "refused: two commands"
        )
        client.name = "two"
        client.send_command("leave")
        client.name = "one"
        assert client.send_command("move", angle_deg={"index": 5.0}) == "move index 5"


def test_the_end_of_a_stream_brings_the_digit_to_rest(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 200.0 * t, 0.3)
        client.tick_outputs.clear()
        client.send_command("stream_end", stream="s")
        client.wait(1.5)
        assert client.reported_faults == set(), "a stream that has ended is not stale"
        assert client.goal_history("dq_goal")[-1] == 0.0
        assert np.degrees(client.goal_history("q_goal"))[-1] < 80.0


def test_streams_that_do_not_suit_the_hand_are_refused(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        assert "no digit 'pinky', expected some of index" in client.open_stream(
            coordinate_names=("pinky",)
        )
        assert "no joint 'index', expected some of index_j1" in client.open_stream(
            target_space="joint"
        )
        assert "twice" in client.open_stream(coordinate_names=("index", "index"))
        assert "5 Hz, expected 20 to 500 Hz" in client.open_stream(rate_Hz=5.0)
        assert "expected 20 to 500 Hz" in client.open_stream(rate_Hz=800.0)
        assert client.run.state.decisions.stream is None
        client.wait(0.01)
        assert client.reported_faults == set()


def test_joint_angles_become_coordinates(model: HandModel) -> None:
    """A stream can contain the angles of single joints instead of one angle for each digit.

    If the target angles of coupled joints violate the coupling, the joints turn to the nearest
    angles that satisfy it.
    """
    names = model.hand.joints
    where = mapping_of_stream(model, "joint", names)
    assert where.is_streamed.all()
    angles = np.linspace(10.0, 30.0, len(names))
    q = np.degrees(model.coupling @ where.matrix @ angles)
    for digit in model.digits:
        digit_angles = angles[digit.joints]
        nearest = digit.coupling @ np.linalg.lstsq(digit.coupling, digit_angles, rcond=None)[0]
        np.testing.assert_allclose(q[digit.joints], nearest, atol=1e-9)
    mapping = mapping_of_stream(model, "joint", (names[1],))
    assert mapping.is_streamed.sum() == 1, "the other joints of the digit stay"


def test_moves_of_single_joints(jamia: HandModel, jamia11: HandModel) -> None:
    with live_client(jamia) as client:
        text = client.send_command("move", angle_deg={"index_j1": 20.0, "index_j2": 30.0})
        assert "index_j1, index_j2 are coupled, expected index" in text
        assert client.send_command(
            "move", angle_deg={"index_j1": 20.0, "index_j2": 20.0}
        ).startswith("move index_j1 20")
        assert "expected either the digit or its joints" in client.send_command(
            "move", angle_deg={"index": 2, "index_j1": 3}
        )
    with live_client(jamia11) as client:
        assert client.send_command("move", angle_deg={"index_j1": 25.0}).startswith(
            "move index_j1 25"
        )
        client.wait(1.2)
        assert np.degrees(client.tick_outputs[-1].telemetry.q_goal[:3]) == pytest.approx(
            [25.0, 0.0, 0.0], abs=3.0
        )


def test_tensions_follow_a_stream(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        assert "expected one of angles" in client.open_stream(
            "tension", ("index_tendon",), stiffness_N_m_per_rad=1.0
        )
        assert client.open_stream("tension", ("index_tendon",)).startswith(
            "stream tension of 1 values"
        )
        for i in range(2000):  # the motion is slow, because 1 N moves a free finger by 12 deg
            target_tension = 10.0 + 3.0 * math.sin(2.0 * math.pi * i / 1000)
            client.tick(*([client.target_request(target_tension)] if i % 5 == 0 else []))
        goal = np.array([out.telemetry.tension_goal[0] for out in client.tick_outputs[-1000:]])
        measured_tension = np.array(
            [out.telemetry.tension[0] for out in client.tick_outputs[-1000:]]
        )
        assert np.ptp(goal) == pytest.approx(6.0, abs=0.3)
        # The tolerance is 1.5 N, half of the motor's Coulomb friction of 3 N. The Coulomb friction
        # opposes a freely moving finger in both directions.
        assert np.sqrt(np.mean((goal - measured_tension) ** 2)) < 1.5
        rate = np.abs(np.diff(goal)).max() / jamia.period
        assert rate < 1.5 * 3.0 * math.pi, "a ramp between targets, no steps"
        for value in (1e4, -5.0, 500.0):
            client.tick(client.target_request(value))
        client.wait(0.01)
        status = stream_status(client.run.state)
        assert (status.refused, status.clipped) == (1, 2)
        assert np.diff(
            [out.telemetry.tension_goal[0] for out in client.tick_outputs[-8:]]
        ).max() <= (jamia.hand.stream.tension_rate_N_per_s * jamia.period * (1 + 1e-9))
        client.send_command("stream_end", stream="s")
        client.wait(0.3)
        held_tensions = [out.telemetry.tension_goal[0] for out in client.tick_outputs[-50:]]
        assert np.ptp(held_tensions) < 1e-9, "the end of a stream holds the present tension"
        assert client.reported_faults == set()


def test_a_move_of_another_digit_does_not_disturb_streamed_tensions(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream("tension", ("index_tendon",))
        for i in range(100):
            client.tick(*([client.target_request(12.0)] if i % 5 == 0 else []))
        tick_count_before = len(client.tick_outputs)
        client.send_command("move", angle_deg={"thumb": 5.0})
        for i in range(20):
            client.tick(*([client.target_request(12.0)] if i % 5 == 4 else []))
        goal = [out.telemetry.tension_goal[0] for out in client.tick_outputs[tick_count_before:]]
        assert goal == pytest.approx([12.0] * len(goal), abs=1e-6)
        assert client.run.state.decisions.stream is not None


def test_tip_forces_become_tensions(jamia: HandModel, jamia11: HandModel) -> None:
    with live_client(jamia) as client:
        assert (
            "index has 1 tendons for 3 joints, expected a stream of tension"
            in client.open_stream("tip_force", ("index",))
        )
    with live_client(jamia11) as client:
        assert client.open_stream("tip_force", ("index",)).startswith("stream tip_force")
        client.tick(client.target_request(0.0))
        client.wait(0.04)
        resting_tensions = client.tick_outputs[-1].telemetry.tension_goal[:3].copy()
        client.tick(client.target_request(2.0))
        client.wait(0.06)
        later_tensions = client.tick_outputs[-1].telemetry.tension_goal[:3]
        assert (later_tensions >= resting_tensions - 0.1).all()
        assert later_tensions.sum() > resting_tensions.sum() + 5.0
        assert (later_tensions <= jamia11.ceiling[:3]).all()


@pytest.mark.parametrize("spring_softness", [None, 0.3, 0.05])
def test_a_softer_stream_is_still_followed_and_stable(
    jamia: HandModel, spring_softness: float | None
) -> None:
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": SINE_MIDDLE_DEG})
        client.wait(1.2)
        text = client.open_stream(
            interpolation="minimum_jerk", stiffness_N_m_per_rad=spring_softness
        )
        fraction = client.run.state.view("stiffness_fraction")[0]
        assert ("% of the stiffness" in text) == (spring_softness is not None)
        assert fraction == 1.0 if spring_softness is None else 0.05 <= fraction < 1.0
        assert (client.run.state.view("stiffness_fraction")[1:] == 1.0).all(), (
            "only the streamed digits"
        )
        client.tick_outputs.clear()
        client.stream_motion(lambda t: sine_angle(t), 3.0)
        apart = np.degrees(
            [out.telemetry.q[0] - out.telemetry.q_goal[0] for out in client.tick_outputs[500:]]
        )
        assert np.sqrt(np.mean(apart**2)) < 3.0
        assert client.reported_faults == set()
        client.send_command("stream_end", stream="s")
        assert (client.run.state.view("stiffness_fraction") == 1.0).all()
        assert (client.run.state.view("damping_fraction") == 1.0).all()


PUSH_FORCE_N = 1.5
"""Force that pushes the last link of the index finger against flexion, along +y of the palm frame [N]."""


def test_a_soft_digit_yields_to_a_push(jamia: HandModel) -> None:
    """A constant push on the last link opens a soft digit further than a stiff digit."""
    displacement_by_stiffness = {}
    for stiffness_N_m_per_rad in (None, 0.2):
        with live_client(jamia) as client:
            client.send_command("move", angle_deg={"index": 40.0})
            client.wait(1.2)
            client.open_stream(stiffness_N_m_per_rad=stiffness_N_m_per_rad)
            client.stream_motion(lambda t: 40.0, 0.4)
            start = true_angle(client.run)
            engine = client.run.simulated_hand.world.plant.engine
            engine._data.xfrc_applied[engine._model.body("index_link3").id, 1] = PUSH_FORCE_N
            client.stream_motion(lambda t: 40.0, 0.4)
            displacement_by_stiffness[stiffness_N_m_per_rad] = start - true_angle(client.run)
            assert client.tick_outputs[-1].mode == HandMode.ACTIVE
    assert displacement_by_stiffness[0.2] > 1.5 * displacement_by_stiffness[None] > 0.0, (
        displacement_by_stiffness
    )


def test_targets_that_tendons_cannot_hold_are_moved_to_the_nearest_posture(
    jamia11: HandModel,
) -> None:
    """The outer joint of a finger cannot bend alone, because a tendon of an inner joint would have to push.

    Earlier defect: the safety monitor reported the tendon of the inner joint as slack, and relaxed
    the hand.
    """
    digit = jamia11.digits[0]
    floor = jamia11.floor[digit.tendons]
    for angles in ([0.0, 25.0, 0.0], [0.0, 0.0, 40.0], [30.0, 30.0, 30.0], [5.0, 60.0, 60.0]):
        expected = np.radians(angles)
        held_posture = nearest_holdable_posture(digit, expected, floor)
        tension = digit.torque_to_tension @ np.asarray(
            static_torque(digit, digit.coupling @ held_posture)
        )
        assert (tension >= floor).all(), angles
    even_angles = np.radians([30.0, 30.0, 30.0])
    np.testing.assert_array_equal(nearest_holdable_posture(digit, even_angles, floor), even_angles)
    with live_client(jamia11) as client:
        client.open_stream("joint", ("index_j1", "index_j2", "index_j3"))
        for i in range(300):
            client.tick(client.target_request(0.0, min(25.0, i / 4), 0.0))
        assert client.reported_faults == set()
        assert stream_status(client.run.state).clipped > 0
        assert np.degrees(client.tick_outputs[-1].telemetry.q_goal[1]) > 10.0


def test_a_task_within_a_session_holds_until_it_is_released(jamia: HandModel) -> None:
    task = {
        "schema": 1, "name": "close", "phase": [
            {"kind": "move", "angle_deg": 10.0, "duration_s": 0.3},
            {"kind": "close", "angle_deg": 30.0, "speed_deg_s": 100.0},
            {"kind": "hold", "tension_N": 12.0, "duration_s": 0.2},
            {"kind": "release", "tension_N": 8.0},
            {"kind": "move", "name": "open", "angle_deg": 0.0, "duration_s": 0.3},
        ],
    }  # fmt: skip
    with live_client(jamia) as client:
        client.open_stream()
        client.stream_motion(lambda t: 20.0, 0.2)
        assert "no hold of a task" in client.send_command("release")
        assert client.send_command("grasp", task=task) == "grasp close"
        assert client.run.state.decisions.stream is None
        client.wait(3.0)
        assert client.tick_outputs[-1].phase == "hold", "longer than the task's 0.2 s"
        middle_snapshot = snapshot_bytes(client.run.state)
        assert (
            restore_state(client.run.controller.derived_constants.layout, middle_snapshot).digest()
            == client.run.state.digest()
        )
        assert client.send_command("release") == "release after hold"
        client.wait(1.5)
        assert client.tick_outputs[-1].phase == "live"
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE
        assert client.send_command("move", angle_deg={"index": 20.0}) == "move index 20"
        assert client.send_command("grasp", task=task) == "grasp close"
        client.wait(0.1)
        assert client.send_command("move", angle_deg={"index": 20.0}) == "move index 20"
        assert client.tick_outputs[-1].phase == "live", "a goal ends the task"
        wrong_task = task | {"phase": [{"kind": "move", "angle_deg": {"pinky": 3.0}}]}
        assert client.send_command("grasp", task=wrong_task).startswith("refused: task: phase[0]")
        too_fast_task = task | {"phase": [{"kind": "move", "angle_deg": 100.0, "duration_s": 0.2}]}
        assert client.send_command("grasp", task=too_fast_task).startswith("refused: ")
        slip_limit_task = task | {
            "phase": [{"kind": "hold", "tension_N": 12.0, "slip_limit_N": 10.0}]
        }
        assert client.send_command("grasp", task=slip_limit_task).startswith("refused: "), (
            "as a run refuses it"
        )
        assert client.tick_outputs[-1].phase == "live"


def test_a_segment_meets_both_ends(jamia: HandModel) -> None:
    random = np.random.default_rng(0)
    layout = layout_of_state(jamia, 1)
    count = jamia.coordinate_count
    T, apart = 0.014, 0.01
    for _ in range(20):
        start = random.normal(size=(3, count))
        target, speed = random.normal(size=count), random.normal(size=count)
        for smooth in (0, 1):
            block = layout.initial.copy()
            rows = layout.table(block, "coordinate")
            rows[s.TRAJECTORY : s.TRAJECTORY + 3] = start
            rows[s.STREAM_RANGE], rows[s.STREAM_RANGE + 1] = -9.0, 9.0
            rows[s.STREAM_TARGET] = target - speed * apart
            assert not begin_segments(
                block, layout.offsets, target, target, 0.5, T, apart, 9.0, smooth
            )
            assert (layout.view(block, "stream_since"), layout.view(block, "stream_duration")) == (
                0.5,
                T,
            )
            powers = rows[s.STREAM_SEGMENT : s.STREAM_SEGMENT + 6]
            at = [np.polynomial.polynomial.polyval(t, powers) for t in (0.0, T)]
            np.testing.assert_allclose(at[0], start[0], atol=1e-12)
            np.testing.assert_allclose(at[1], target, atol=1e-9)
            np.testing.assert_allclose(rows[s.STREAM_TARGET_RATE], speed)
            if smooth:
                slope = np.polynomial.polynomial.polyder(powers)
                np.testing.assert_allclose(np.polynomial.polynomial.polyval(0.0, slope), start[1])
                np.testing.assert_allclose(
                    np.polynomial.polynomial.polyval(T, slope), speed, atol=1e-6
                )


def test_a_segment_keeps_range_and_speed(jamia: HandModel) -> None:
    layout = layout_of_state(jamia, 1)
    block = layout.initial.copy()
    rows = layout.table(block, "coordinate")
    rows[s.STREAM_RANGE], rows[s.STREAM_RANGE + 1] = 0.0, 1.0
    aim = np.full(jamia.coordinate_count, 1.5)
    assert begin_segments(block, layout.offsets, aim, aim, 0.0, 0.01, 0.01, 5.0, 1), (
        "clipped to the range"
    )
    np.testing.assert_array_equal(rows[s.STREAM_TARGET], 1.0)
    np.testing.assert_array_equal(rows[s.STREAM_TARGET_RATE], 5.0)
    aim[:] = 0.5
    assert not begin_segments(block, layout.offsets, aim, aim, 0.0, 0.01, math.inf, 5.0, 1)
    np.testing.assert_array_equal(rows[s.STREAM_TARGET_RATE], 0.0)


def test_a_stream_needs_no_goal_objects_per_target(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream()
        goals = client.run.state.progress.goals
        client.stream_motion(lambda t: 10.0 * t, 0.2)
        assert client.run.state.progress.goals is goals
        assert goals[0].kind == GoalKind.MOTION
        assert isinstance(goals[0].trajectory, StreamedTrajectory)
