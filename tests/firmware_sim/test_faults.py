"""Test faults that are scheduled in the simulator.

The tests parse the text of a fault, check the times of its start and end, and count its effects.
Two scheduled faults with equal seeds disturb the hand in the same way.
"""

import contextlib

import pytest

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.faults.fault_text import (
    DRIVE_ONLY_FAULTS,
    FAULT_KINDS,
    TWO_MOTOR_FAULTS,
    instances_of_component,
    parse_fault,
)
from firmware_sim.lockstep_hand import LockstepHand

JAMIA_HAND = load_hand("jamia")
SYNC_ID = 0x080
REFRESH_FRAME = Frame(0x7FF, bytes((1, 0, 0xCC, 0)))


def make_hand(seed=0):
    return LockstepHand("jamia", seed=seed, homed=True)


def replies_of_ticks(simulated_hand, tick_count, frames=(REFRESH_FRAME,)):
    """Run ticks in which a SYNC frame and the given frames arrive, and return the replies of each tick."""
    replies = []
    for _ in range(tick_count):
        k = simulated_hand.world.t_ns // 2_000_000
        replies.append(
            simulated_hand.step(
                simulated_hand.world.t_ns, [Frame(SYNC_ID, bytes((k & 0xFF,))), *frames]
            )
        )
    return replies


def test_a_fault_is_parsed_from_a_line():
    fault = parse_fault("drop node=3 p=0.05 at=3s for=2s seed=7", JAMIA_HAND, 10)
    assert (fault.kind, fault.component, fault.instance) == (
        "drop",
        "node",
        JAMIA_HAND.motors[2].name,
    )
    assert (fault.start_ns, fault.duration_ns, fault.p, fault.seed) == (
        3_000_000_010,
        2_000_000_000,
        0.05,
        7,
    )


@pytest.mark.parametrize(
    ("fault_text", "expected_message"),
    [
        ("", "no such kind"), ("explode node=1", "expected one of drop, deaf"),
        ("drop", "drop needs node=NAME or bus"),
        ("drop node=9", "no node '9'"), ("drop tendon=index_tendon", "drop needs"),
        ("snap node=1", "snap needs tendon"),
        ("drop node=1 node=1", "not a new KEY=VALUE"), ("drop node=1 p=2", "p=2: expected a number from 0 to 1"),
        ("drop node=1 at=3", "at=3: expected"), ("drop node=1 at=nans", "at=na: expected"),
        ("drop node=1 foo=3", "'foo'"),
        ("drop node=1 bus=main", "drop needs"), ("stuck joint=index_j1", "no joint"), ("drop node=1 p=", "KEY=VALUE"),
    ],
)  # fmt: skip
def test_wrong_faults_are_refused_in_one_line(fault_text, expected_message):
    with pytest.raises(SimulatorError) as caught:
        parse_fault(fault_text, JAMIA_HAND)
    assert expected_message in str(caught.value)
    assert "\n" not in str(caught.value)


def second_motor_text(fault_kind: str, index: int) -> str:
    """Return the part ``with=...`` of a fault text, which names the second motor of a fault on two motors.

    If the fault acts on a single motor, return an empty text.
    """
    return f" with={JAMIA_HAND.motors[index].name}" if fault_kind in TWO_MOTOR_FAULTS else ""


FAULTS_OF_FIRST_COMPONENTS = [
    f"{kind} {component}={instances_of_component(component, JAMIA_HAND, kind)[0]}{second_motor_text(kind, -1)}"
    for kind, fault_kind in FAULT_KINDS.items()
    for component in fault_kind.components
    if instances_of_component(component, JAMIA_HAND, kind)
]
FAULTS_OF_LAST_COMPONENTS = [
    f"{kind} {component}={instances_of_component(component, JAMIA_HAND, kind)[-1]}{second_motor_text(kind, 0)}"
    for kind, fault_kind in FAULT_KINDS.items()
    for component in fault_kind.components
    if instances_of_component(component, JAMIA_HAND, kind)
]


@pytest.mark.parametrize("fault_text", FAULTS_OF_FIRST_COMPONENTS)
def test_every_fault_has_an_effect_and_ends(fault_text):
    run = make_hand()
    run.world.plant.motors["index_motor"].servo.torque = 0.1
    run.world.plant.motors["index_motor"].servo.limit = 0.8
    replies_of_ticks(run, 5)
    run.inject(f"{fault_text} at=4ms for=40ms")
    assert run.fault_states()[0]["state"] == "waiting"
    replies_of_ticks(run, 10)
    assert run.fault_states()[0]["state"] == "acting"
    run.world.plant.motors["index_motor"].servo.torque = 0.02
    replies_of_ticks(run, 20)
    state = run.fault_states()[0]
    assert state["state"] == "over"
    assert state["felt"] > 0, "the disturbance had an effect"
    assert 14_000_000 <= state["first_ns"] <= 54_000_000
    effects_before = state["felt"]
    replies_of_ticks(run, 10)
    assert run.fault_states()[0]["felt"] == effects_before


@pytest.mark.parametrize("fault_text", FAULTS_OF_LAST_COMPONENTS)
def test_no_size_of_any_fault_ends_the_simulator(fault_text):
    """The test injects each kind of fault with very small to very large values of ``size``.

    Each fault acts on the last motor, tendon or node of the hand that can have this fault.
    """
    run = make_hand()
    for i, size in enumerate(("-1e12", "-1e6", "0", "1", "2", "1000", "1e6", "1e12")):
        with contextlib.suppress(SimulatorError):
            run.inject(f"{fault_text} size={size} for=6ms seed={i}")
        replies_of_ticks(run, 4)
    assert 1 <= len(run.fault_states()) < 7


@pytest.mark.parametrize("fault_kind", DRIVE_ONLY_FAULTS)
def test_the_sensor_node_is_no_drive(fault_kind):
    with pytest.raises(SimulatorError, match="no node 'sensors'; expected one of index_motor"):
        parse_fault(f"{fault_kind} node=sensors", JAMIA_HAND)


def test_equal_seeds_lose_equal_frames():
    runs = []
    for seed in (1, 1, 2):
        run = make_hand()
        run.inject(f"drop node=sensors p=0.3 seed={seed}")
        runs.append([len(replies) for replies in replies_of_ticks(run, 200)])
    assert runs[0] == runs[1] != runs[2]
    lost = 400 - sum(runs[0])
    assert 30 <= lost <= 95


def test_a_delayed_frame_comes_late_and_a_reordered_one_behind_the_next():
    run = make_hand()
    run.inject("delay node=sensors size=5")
    replies = replies_of_ticks(run, 10, ())
    assert [len(a) for a in replies[:3]] == [0, 0, 1]
    run = make_hand()
    run.inject("reorder node=sensors")
    counters = [
        frame.data[0] & 0xF
        for a in replies_of_ticks(run, 6, ())
        for frame in a
        if frame.can_id == 0x1A0
    ]
    assert counters == [1, 0, 3, 2, 5, 4]


def test_a_broken_tendon_is_slack_until_it_is_mended():
    run = make_hand()
    motor = run.world.plant.motors["index_motor"]
    motor.servo.torque, motor.servo.limit = 0.15, 0.8
    replies_of_ticks(run, 150)
    assert run.truth()["tension"][0] > 15.0
    run.inject("snap tendon=index_tendon for=20ms")
    replies_of_ticks(run, 1)
    assert run.truth()["tension"][0] == 0.0
    replies_of_ticks(run, 10)
    assert run.truth()["tension"][0] > 15.0


FAULT_TEXTS = (
    "drop node=index_motor p=0.2 for=60ms", "delay node=index_motor p=0.3 size=3.3 at=70500us",
    "flood bus=can0 size=2 at=17500us for=20ms", "foreign node=middle_motor at=31ms for=30ms",
    "runaway node=ring_motor size=0.5 at=25ms for=40ms", "reset node=thumb_motor at=50500us for=10ms",
)  # fmt: skip


def test_blocks_of_steps_end_at_every_event():
    """Advance one hand in blocks of steps, and another hand step by step.

    The frames, the faults and the motion of the two simulated hands must be equal.
    """

    def run(step_ns):
        simulated_hand = make_hand()
        world = simulated_hand.world
        for text in FAULT_TEXTS:
            simulated_hand.inject(text.replace("can0", JAMIA_HAND.buses[0]))
        frames = []
        for k in range(60):
            for t_ns in range(world.t_ns + step_ns, (k + 1) * 2_000_000 + 1, step_ns):
                world.advance(t_ns)
            frames += [
                *world.receive(REFRESH_FRAME),
                *world.receive(Frame(SYNC_ID, bytes((k,)))),
                *world.take_unsolicited_frames(),
            ]
        state = [
            {key: value for key, value in fault.items() if key != "state"}
            for fault in simulated_hand.fault_states()
        ]
        return frames, state, [motor.theta.hex() for motor in world.plant.motors.values()]

    long_step_result, short_step_result = run(2_000_000), run(500_000)
    assert long_step_result == short_step_result
    assert sum(fault["felt"] > 0 for fault in long_step_result[1]) == len(FAULT_TEXTS)
