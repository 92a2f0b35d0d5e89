"""What safety remembers between ticks, on two made-up ropes: every signal from both sides of its limit."""

import math

import numpy as np
import pytest

from handctl.safety import watch
from handctl.safety.detectors import residuals, ropes
from handctl.safety.detectors.counts import Counts
from handctl.safety.detectors.residuals import Rotor
from handctl.safety.signals import Limits, Signals
from handctl.safety.watch import Seen, Watcher, WatchState, counted, screen, watched

T, N = 0.002, np.nan
PAIR = np.array([1.0, 1.0])
LIMITS = Limits(("a", "b"), (140.0, 140.0), 240.0, ("ma", "mb"), noise_most=1e-4)
WATCHER: Watcher
ARMED = Signals(armed=True, motor_age=(0, 0), sensor_age=(0, 0))


def made(stiffness=1e5, motor_period=(T, T), joint_period=T):
    """A hand of two ropes of a stiffness [N/m], whose motors and joints are read so often [s]."""
    return Watcher(
        limits=LIMITS, joints=("ja", "jb"),
        rotor=Rotor(5.0 * PAIR, 40.0 * PAIR, 3.0 * PAIR, T, np.array(motor_period), joint_period),
        stiffness=stiffness * PAIR, spool=0.005 * PAIR, arms=np.array([0.02, 0.01]),
        spool_to_joints=np.array([[50.0, 0.0], [0.0, 100.0]]), step_most=(np.array([0.1, 0.2]), np.array([0.3, 0.4])),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def _watcher():
    """Made for each test: what is made while a module is imported, no mutation test reaches."""
    global WATCHER
    WATCHER = made()


def seen(**given):
    """A tick of two ropes at rest under 20 N, some of it otherwise; a number stands for both."""
    facts = {"tension": 20.0, "travel": 0.0, "position": 0.0, "speed": 0.0, "force": 20.0, "excursion": N, "joints": N}
    facts |= {"read": False, "cut": False} | given
    return Seen(**{name: v if isinstance(v, bool) else np.array(v) * PAIR for name, v in facts.items()})


def wanting(**given):
    """A state in which 20 N are wanted and asked for, and nothing moves."""
    commanded = {"asked": 20.0, "wanted": 20.0, "goal": 0.0} | given
    return WATCHER.start._replace(**{name: np.array(v) * PAIR for name, v in commanded.items()})


def ticks(number, state=None, raw=ARMED, **given):
    """The same tick several times; values that are functions get its number."""
    state = state or wanting()
    for k in range(number):
        state, told = watched(WATCHER, state, raw, seen(**{n: v(k) if callable(v) else v for n, v in given.items()}))
    return state, told


def test_at_rest_nothing_is_told_and_the_same_signals_come_back():
    assert ticks(30)[1] is ARMED, "not even another object"
    state, told = ticks(600)
    assert told == ARMED
    assert state.taut == pytest.approx((1.2, 1.2))
    assert state.ropes == ropes.Ropes((0, 0), (0, 0))


def test_a_hand_that_is_armed_while_its_ropes_are_taut_is_not_stuck():
    """What is filtered begins at what is there: tension and force have not moved, so that nothing needs to."""
    _, told = ticks(200, wanting(wanted=N, goal=N, asked=N))
    assert (told.stuck_motor, told.stuck_cell) == ((), ())


def test_without_torque_everything_but_the_counts_begins_anew():
    state, _ = ticks(10)
    state = state._replace(counts=Counts(unknown=3.0), owed=(2, 1))
    after, told = watched(WATCHER, state, Signals(armed=False), seen())
    assert after == WATCHER.start._replace(counts=Counts(unknown=3.0), owed=(2, 1))
    assert told == Signals(armed=False)


def test_after_the_cut_a_rope_that_does_not_let_go_is_told():
    state = ticks(3)[0]
    for _ in range(50):
        state, told = watched(WATCHER, state, ARMED, seen(tension=[30.0, 8.0], cut=True))
        assert told.limp == ()
    state, told = watched(WATCHER, state, ARMED, seen(tension=[30.0, 8.0], cut=True))
    assert told.limp == (("a", 30.0),)
    assert state.ropes.cut_from == (30.0, 8.0)


def test_a_rope_that_does_not_let_go_is_told_though_its_sample_was_lost_at_the_cut():
    state = ticks(3, tension=[30.0, 25.0])[0]
    state = ticks(2, state, tension=N)[0]
    for k in range(51):
        state, told = watched(WATCHER, state, ARMED, seen(tension=[30.0, 8.0] if k else N, cut=True))
    assert told.limp == (("a", 30.0),)
    assert state.ropes.cut_from == (30.0, 25.0)


@pytest.mark.parametrize(("tension", "residual"), [(29.8, 4.8), (30.2, 5.2), (9.7, 5.3), (5.0, 10.0), (20.0, 0.0)])
def test_a_residual_that_lasts(tension, residual):
    """Of what the torque does not explain, 3 N are friction, and a tenth of 20 N the torque constant's tolerance."""
    _, signals = ticks(1200, tension=tension)
    assert signals.residual == (pytest.approx((residual, residual), abs=0.05) if residual else ())


@pytest.mark.parametrize(("force", "told"), [(5.1, ()), (4.9, (15.1, 15.1)), (35.1, (15.1, 15.1))])
def test_torque_that_is_not_made(force, told):
    _, signals = ticks(600, force=force, tension=force)
    assert signals.disobeyed == pytest.approx(told, abs=0.01)


@pytest.mark.parametrize(("rub", "told"), [(5.8, False), (6.1, True)])
def test_friction_beyond_the_file_s(rub, told):
    """After many seconds of motion: a tenth of 29 N is the torque constant's tolerance; then 3 N are told."""
    state = ticks(30)[0]
    low = state.filtered.low.copy()
    low[residuals.RUB], low[residuals.FORCE] = rub, 29.0
    _, signals = ticks(1, state._replace(filtered=state.filtered._replace(low=low)), force=29.0, tension=29.0)
    assert signals.friction == pytest.approx((rub - 2.9,) * 2, abs=0.01)
    assert (max(signals.friction) > 3.0) == told


def test_a_noisy_encoder():
    """Mean squared jerk of a position that goes to and fro by d each tick: 16 d^2."""
    for size, told in ((2.4e-3, ()), (2.6e-3, (1.08e-4, 1.08e-4))):
        _, signals = ticks(600, position=lambda k, size=size: size * (-1.0) ** k)
        assert signals.noise == pytest.approx(told, rel=0.02)


def test_a_slack_rope_and_a_torn_one():
    state, _ = ticks(100)
    state, told = ticks(90, state, tension=[0.0, 20.0])
    assert [name for name, _ in told.slack] == ["a"]
    assert told.snapped == ()
    state, _ = ticks(100)
    state, told = ticks(3, state, tension=[0.0, 20.0], speed=[0.05, 0.05])
    assert told.snapped == (("a", 0.05),)


def test_joint_and_spool_are_compared_from_when_the_rope_is_taut():
    """Rope a: 20 mm of arms; 3 deg are 1.05 mm at the joints, filtered over 0.3 s; unfiltered 15 deg are told."""

    def slipped(deg):
        state, _ = ticks(100, excursion=0.0, read=True)
        assert not np.isnan(state.slip_from).any()
        return ticks(1500, state, excursion=[-0.02 * np.radians(deg), 0.0], read=True)[1]

    assert slipped(2.9).slip == ()
    told = slipped(3.1)
    assert told.slip == pytest.approx((3.1, 0.0), abs=0.02)
    assert told.derailed == ()
    assert slipped(14.9).derailed == ()
    assert slipped(-15.1).derailed == pytest.approx((15.1, 0.0), abs=1e-6)


def test_joint_and_spool_say_nothing_of_a_slack_rope_or_just_after_it():
    state, _ = ticks(100, excursion=0.0, read=True)
    state, _ = ticks(1, state, tension=[1.9, 20.0], excursion=0.0, read=True)
    assert (state.taut[0], np.isnan(state.slip_from[0])) == (0.0, True)
    state, _ = ticks(5, state, tension=[2.2, 20.0], excursion=0.0, read=True)
    assert state.taut[0] == 0.0, "between slack and taut no time passes"
    state, told = ticks(49, state, excursion=0.5, read=True)
    assert np.isnan(state.slip_from[0]), "100 ms after it became taut"
    state, told = ticks(3, state, excursion=0.5, read=True)
    assert state.slip_from[0] == pytest.approx(-20.0 / 1e5 - 0.5)
    unread, told = ticks(1, state, excursion=N)
    assert unread.slip_from[0] == state.slip_from[0]
    assert told.derailed == ()


EVERY = 4
"""Joints are read in every fourth tick, where a bus has no room for more."""


def sparse(number, state, **given):
    """Ticks of a hand whose joints are read in every fourth, and all that they told."""
    told = []
    for k in range(number):
        read = {"read": True} | given if k % EVERY == 0 else {n: v for n, v in given.items() if n == "travel"}
        state, signals = watched(WATCHER, state, ARMED, seen(**read))
        told.append(signals)
    return state, told


def test_a_rope_that_left_its_pulley_shows_in_three_readings_however_seldom_joints_are_read():
    global WATCHER
    WATCHER = made(joint_period=EVERY * T)
    state, _ = sparse(100, wanting(), excursion=0.0, joints=0.0)
    off = {"excursion": [-0.02 * np.radians(15.1), 0.0], "joints": 0.0}
    _, told = sparse(9, state, **off)
    assert [k for k, signals in enumerate(told) if signals.derailed] == [8]
    assert told[8].derailed == pytest.approx((15.1, 0.0), abs=1e-6)
    after, told = sparse(8, state, **off)
    assert not any(signals.derailed for signals in told)
    after, _ = sparse(4, after, excursion=0.0, joints=0.0)
    _, told = sparse(8, after, **off)
    assert not any(signals.derailed for signals in told), "three in a row, and one between them was well"


def test_joint_against_spool_is_filtered_over_the_same_time_however_seldom_joints_are_read():
    """3 deg of 3.5 are reached after 0.3 s ln 7 = 0.58 s."""
    global WATCHER
    for every in (1, EVERY):
        WATCHER = made(joint_period=every * T)
        state, _ = ticks(100, excursion=0.0, read=True)
        begun = None
        for k in range(400):
            read = {"excursion": [-0.02 * np.radians(3.5), 0.0], "read": True} if k % every == 0 else {}
            state, signals = watched(WATCHER, state, ARMED, seen(**read))
            begun = k * T if begun is None and signals.slip else begun
        assert begun == pytest.approx(0.584, abs=0.01)


def test_a_joint_or_a_motor_that_stands_is_told_after_the_same_time_however_seldom_it_is_read():
    global WATCHER
    WATCHER = made(motor_period=(EVERY * T, T), joint_period=EVERY * T)
    assert WATCHER.patience.tolist() == [12, 50, 40, 40, 12, 12]
    state, _ = sparse(100, wanting(), travel=0.0, excursion=0.0, joints=0.2)
    state, _ = sparse(4, state, travel=0.0, excursion=0.0, joints=0.3)
    _, told = sparse(56, state, travel=[np.radians(10.1) / 50.0, 0.0], excursion=0.0, joints=0.3)
    assert next(k for k, signals in enumerate(told) if signals.stuck_joint) == 48, "100 ms are 12.5 readings after one"
    state = just_moved()._replace(goal=np.array([0.51e-3, 0.0]))
    first = None
    for k in range(60):
        state, signals = watched(WATCHER, state, ARMED, seen(travel=1e-5 if k % EVERY == 0 else [N, 1e-5]))
        first = k if first is None and signals.stuck_motor else first
    assert first == 48


def just_moved(**given):
    """A state in which all filters have settled, and motors have moved in the last tick."""
    return ticks(1, ticks(150, **given)[0], travel=1e-5, **given)[0]


@pytest.mark.parametrize(("number", "goal", "told"), [
    (51, 0.51e-3, True), (50, 0.51e-3, False),      # 100 ms
    (60, 0.49e-3, False), (60, -0.51e-3, True),
])  # fmt: skip
def test_a_motor_that_stands_while_its_goal_moves(number, goal, told):
    moved = just_moved()._replace(goal=np.array([goal, 0.0]))
    _, signals = ticks(number, moved, travel=1e-5)
    assert [name for name, _ in signals.stuck_motor] == (["ma"] if told else [])
    if told:
        assert signals.stuck_motor[0][1] == pytest.approx(0.51)


def test_a_motor_that_stands_while_its_rope_s_tension_moves():
    for tension, told in ((27.9, []), (28.2, ["mb"]), (11.8, ["mb"])):
        _, signals = ticks(200, just_moved(), travel=1e-5, tension=[20.0, tension], force=[20.0, tension])
        assert [name for name, _ in signals.stuck_motor] == told


def test_a_joint_that_stands_while_the_spool_turns():
    for angle, told in ((9.9, []), (10.1, ["ja"])):
        joints = {"excursion": 0.0, "read": True}
        state, _ = ticks(1, just_moved(joints=0.2, **joints), travel=1e-5, joints=0.3, **joints)
        travel = [1e-5 + np.radians(angle) / 50.0, 1e-5]
        _, signals = ticks(55, state, travel=travel, joints=0.3, **joints)
        assert [name for name, _ in signals.stuck_joint] == told


def test_a_spool_that_turns_while_its_tendon_is_slack_says_nothing_of_a_joint():
    """Slack is wound up; from where the tendon bears on, joint and spool move together."""
    turn, joints = np.radians(10.1) / 50.0, {"joints": 0.3, "excursion": 0.0, "read": True}
    state, told = ticks(200, wanting(), tension=0.5, force=0.5, travel=lambda k: [3.0 * turn * (k > 20), 0.0], **joints)
    assert told.stuck_joint == ()
    state, told = ticks(200, state, travel=[3.0 * turn, 0.0], **joints)
    assert told.stuck_joint == (), "that it has become taut moves nothing"
    _, told = ticks(200, state, travel=[4.1 * turn, 0.0], **joints)
    assert [name for name, _ in told.stuck_joint] == ["ja"]


@pytest.mark.parametrize(("tension", "told"), [(2.1, ["ja"]), (1.9, [])])
def test_a_tendon_bears_until_it_is_slack(tension, told):
    joints = {"joints": 0.3, "excursion": 0.0, "read": True}
    state, _ = ticks(200, wanting(), tension=2.6, force=2.6, **joints)
    state, _ = ticks(200, state, tension=tension, force=tension, **joints)
    _, signals = ticks(60, state, tension=tension, force=tension, travel=[np.radians(12.0) / 50.0, 0.0], **joints)
    assert [name for name, _ in signals.stuck_joint] == told


def test_each_joint_has_its_own_tendons_as_witnesses():
    """Joint b does not care that tendon a is slack."""
    joints = {"joints": 0.3, "excursion": 0.0, "read": True}
    state, _ = ticks(200, wanting(), tension=[0.5, 20.0], force=[0.5, 20.0], **joints)
    travel = [np.radians(12.0) / 50.0, np.radians(12.0) / 100.0]
    _, signals = ticks(60, state, tension=[0.5, 20.0], force=[0.5, 20.0], travel=travel, **joints)
    assert [name for name, _ in signals.stuck_joint] == ["jb"]


@pytest.mark.parametrize(("number", "force", "tension", "told"), [
    (400, 25.2, 20.0, True), (400, 14.8, 20.0, True), (400, 24.8, 20.0, False), (38, 60.0, 20.0, False),
    (39, 60.0, 20.0, False), (40, 60.0, 20.0, True), (400, 26.0, 2.5, False), (400, 26.0, 2.6, True),
])  # fmt: skip
def test_a_cell_that_repeats_itself_while_the_torque_moves(number, force, tension, told):
    chance = np.random.default_rng(1)
    state, _ = ticks(100, tension=lambda k: tension + 0.1 * chance.standard_normal())
    state, _ = ticks(1, state, tension=tension)
    _, signals = ticks(number, state, tension=tension, force=[force, 20.0])
    assert [name for name, _ in signals.stuck_cell] == (["a"] if told else [])


@pytest.mark.parametrize("late", [0, 1])
def test_an_even_motion_is_no_noise_and_no_force_because_ticks_were_skipped(late):
    """The way of five ticks at once, in the tick behind the gap, or in the next one, whose answer is from behind it."""

    def course(raw):
        state, at, speed, told = ticks(5, speed=0.1, force=27.0)[0], 0.0, 0.1, []
        for k in range(20):
            at, speed = (at + 0.25, 0.14) if k == 10 + late else (at + 0.05, speed)
            tick = raw if k == 10 else ARMED
            state, signals = watched(WATCHER, state, tick, seen(position=at, speed=speed, force=23.0 + 40.0 * speed))
            told.append(signals.noise)
        noisy = any(max(noise, default=0.0) > LIMITS.noise_most for noise in told)
        return noisy, state.filtered.low[residuals.BALANCE]

    noisy, balance = course(ARMED._replace(missed=4))
    assert not noisy
    assert np.abs(balance).max() < 0.05
    noisy, balance = course(ARMED)
    assert noisy, "positive control"
    assert np.abs(balance).max() > 0.5


def test_positions_are_screened_apart():
    state, jumped, twisted = screen(WATCHER, WATCHER.start, np.zeros(2), np.zeros(2))
    assert (jumped, twisted) == (None, None)
    state, jumped, twisted = screen(WATCHER, state, np.array([0.11, 0.19]), np.array([0.29, 0.41]))
    assert jumped.tolist() == [0.11, 0.0]
    assert twisted.tolist() == [0.0, 0.41]
    state, jumped, twisted = screen(WATCHER, state, np.array([0.05, 0.19]), None)
    assert (jumped, twisted) == (None, None)
    assert state.joints.gap.tolist() == [1.0, 2.0]
    assert state.motors.value.tolist() == [0.05, 0.19]
    assert state.motors.dropped.tolist() == [0.0, 0.0]
    assert state.joints.dropped.tolist() == [0.0, 1.0]


def test_after_missed_ticks_motors_and_joints_may_have_gone_so_much_further():
    before = screen(WATCHER, WATCHER.start, np.zeros(2), np.zeros(2))[0]
    motor, joint = np.array([0.29, 0.61]), np.array([0.91, 1.19])
    _, jumped, twisted = screen(WATCHER, before, motor, joint)
    assert (jumped.tolist(), twisted.tolist()) == ([0.29, 0.61], [0.91, 1.19])
    _, jumped, twisted = screen(WATCHER, before, motor, joint, 2)
    assert jumped.tolist() == [0.0, 0.61], "three times 0.1 and 0.2"
    assert twisted.tolist() == [0.91, 0.0], "three times 0.3 and 0.4"
    assert screen(WATCHER, before, motor, None, 2)[0].joints.gap.tolist() == [3.0, 3.0]


def counting(raw=ARMED, state=None, misshapen=(False,) * 3, strange=(0, 0), k=1):
    return counted(WATCHER, state or WATCHER.start, raw, misshapen, strange, k)


def test_where_nothing_is_lost_nothing_is_counted():
    state, told = counting()
    assert state is WATCHER.start
    assert told is ARMED


@pytest.mark.parametrize(("raw", "lost"), [
    (ARMED._replace(motor_age=(0, 1)), (0, 1, 0)), (ARMED._replace(sensor_age=(0, 1)), (0, 0, 1)),
    (ARMED._replace(motor_age=(3, 0), sensor_age=()), (1, 0, 0)),
    (ARMED._replace(motor_age=(1, 1), missed=1), ()), (ARMED._replace(motor_age=(1, 1), armed=False), ()),
])  # fmt: skip
def test_what_counts_as_lost(raw, lost):
    assert counting(raw)[1].lost == lost


def test_misshapen_frames_are_told_of_who_sent_one_now_and_how_many_there_were_of_late():
    state = WATCHER.start
    for k in range(3):
        state, told = counting(state=state, misshapen=(True, k == 0, False), k=k)
    assert told.misshapen == (("ma", 3.0),)
    _, told = counting(state=state, misshapen=(False, False, True), k=4)
    assert told.misshapen == (("load cells", 1.0),)


def test_a_node_that_answers_every_second_tick():
    state = WATCHER.start
    for k in range(20):
        state, told = counting(ARMED._replace(motor_age=(0, k % 2)), state, k=k)
        assert told.halved == (("mb",) if k >= 13 else ()), k


def test_strange_frames_and_refused_goals():
    state, told = counting(strange=(5, 2))
    assert (told.unknown, told.refused) == (5.0, 2)
    state, told = counting(state=state, strange=(0, 1), k=2)
    assert told.unknown == pytest.approx(5.0 * (1.0 - T))
    assert told.refused == 3
    _, told = counting(state=state, k=3)
    assert told.refused == 0, "told where one comes"


def test_what_is_fixed_follows_from_the_hand():
    assert WATCHER.period == T
    assert WATCHER.patience.tolist() == [50, 50, 40, 40, 50, 50]
    limits = [5.0 + 3.0, np.inf, 15.0, np.inf, np.inf, 3.0, 1e-4, 3.0]
    assert WATCHER.suspicion.tolist() == [[limit] * 2 for limit in limits]
    assert WATCHER.initial() is WATCHER.start
    assert WatchState.initial(2, 2).stuck.value.shape == (6,)
    assert watch.JUMP_MARGIN == 1.5
    assert residuals.GAIN_SHARE == 0.1


def test_what_is_filtered_quickly_begins_at_what_is_there_once_only():
    state = ticks(5)[0]
    after = ticks(1, state, tension=30.0, force=30.0)[0]
    moved = 10.0 * -math.expm1(-T / residuals.QUICK_S)
    for row in (residuals.TENSION, residuals.QUICK_FORCE):
        assert state.filtered.low[row] == pytest.approx([20.0, 20.0])
        assert after.filtered.low[row] == pytest.approx([20.0 + moved, 20.0 + moved])
