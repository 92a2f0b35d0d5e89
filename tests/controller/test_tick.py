"""The tick as a function: the same in, the same out, nothing changed on the way, whatever the wire brings."""

import random
import tomllib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handctl.controller.retune import Coming
from handctl.controller.state import State
from handctl.core.estimation.posture import Posture
from handctl.core.gains.bounds import with_values
from handctl.core.gains.gains import Gains
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import MinimumJerk
from handctl.core.model import HandModel
from handctl.core.types import TELEMETRY_AXES, IoEvent, Mode, TickIn, TickOut
from handctl.drives.frame import Frame
from handctl.hand.load import hand_from, hand_path, load_hand
from handctl.programs.live import LiveProgram
from handctl.safety.action import Action
from handctl.safety.detectors.counts import Counts
from handctl.safety.detectors.ropes import Ropes
from tests.controller.bench import Bench, bench


def lively(name: str) -> Bench:
    """A whole live session: arming, moving, holding, a lost frame, a fault, the way home."""
    rate = {"jamia": 200.0, "jamia11": 200.0}[name]
    run = bench(HandModel.of(load_hand(name), Gains(), rate), LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(1.0)
    run.tick('{"do": "move", "angle_deg": {"middle": 20}, "duration_s": 0.3}')
    run.run(0.2)
    run.tick('{"do": "hold", "tension_N": {"index": 30, "thumb": 20}}', '{"do": "dance"}')
    run.to_host = lambda frames: frames[1:]
    run.tick()
    run.to_host = lambda frames: frames
    run.run(0.3)
    run.tick(io=(IoEvent("dropped", "local:x", 3),), late_ns=run.period_ns // 2)
    run.tick(skip=1)
    run.tick(extra=(Frame(0x001, bytes(8), t_ns=run.k * run.period_ns),))
    run.until(Mode.DONE)
    return run


@pytest.fixture(scope="module", params=["jamia", "jamia11"])
def session(request: pytest.FixtureRequest) -> Bench:
    return lively(request.param)


def bytes_of(out: TickOut) -> tuple[object, ...]:
    """Everything that a tick decided, NaN comparable."""
    plain = (out.frames, out.mode, out.phase, out.action, out.events, out.state_hash)
    return (*plain, out.telemetry.packed())


def test_the_same_in_gives_the_same_out(session: Bench) -> None:
    """A run of ticks that is executed again from any state agrees in every byte."""
    for before, entry, out in session.history[::3]:
        digest = before.digest()
        after, again = session.controller.tick(before, entry)
        assert bytes_of(again) == bytes_of(out)
        assert after.digest() == out.state_hash
        assert before.digest() == digest, "the state that went in is as it was"


def test_another_controller_of_the_same_hand_executes_the_run_again(session: Bench) -> None:
    model = session.controller.model
    other = bench(HandModel.of(model.hand, model.gains, 1.0 / model.period), LiveProgram()).controller
    state = other.initial()
    for _, entry, out in session.history:
        state, again = other.tick(state, entry)
        assert again.state_hash == out.state_hash, entry.k


def test_the_order_of_frames_within_a_tick_does_not_matter(session: Bench) -> None:
    shuffle = random.Random(3)
    checked = 0
    for before, entry, out in session.history[::3]:
        frames = list(entry.frames)
        shuffle.shuffle(frames)
        _, again = session.controller.tick(before, entry._replace(frames=tuple(frames)))
        assert bytes_of(again) == bytes_of(out)
        checked += frames != list(entry.frames)
    assert checked > 50


def test_identifiers_of_nobody_change_nothing(session: Bench) -> None:
    """But what is counted of them, and that a known identifier with a flag is a frame of a wrong shape."""
    noise = (Frame(0x666, bytes(8)), Frame(0x1A0, bytes(8), bus=3))
    misshapen = Frame(0x011 | 1 << 31, bytes(8))
    for before, entry, out in session.history[::7]:
        _, again = session.controller.tick(before, entry._replace(frames=(*noise, *entry.frames)))
        assert bytes_of(again._replace(state_hash=b"")) == bytes_of(out._replace(state_hash=b""))
        _, again = session.controller.tick(before, entry._replace(frames=(misshapen, *entry.frames)))
        assert (again.frames, again.mode) == (out.frames, out.mode)


def test_the_origin_of_time_does_not_matter() -> None:
    """The same run that begins 2560 ticks later, but for the counter of SYNC and the turns of registers read again."""
    model = HandModel.of(load_hand("jamia"), Gains(), 200.0)
    runs = []
    for first in (0, 2560):
        run = bench(model, LiveProgram())
        run.k = first
        run.state = run.state._replace(k=first - 1, mode_since=first * model.period)
        run.until(Mode.ACTIVE)
        run.run(0.5)
        run.tick('{"do": "hold", "tension_N": {"index": 15}}')
        run.run(0.3)
        run.tick('{"do": "stop"}')
        run.until(Mode.DONE)
        runs.append(run)
    early, late = (run.history for run in runs)
    assert len(early) == len(late)
    for (_, _, a), (_, _, b) in zip(early, late, strict=True):
        assert (a.mode, a.phase, a.action, [e.text for e in a.events]) == (
            b.mode,
            b.phase,
            b.action,
            [e.text for e in b.events],
        )
        commands = [[f for f in out.frames if f.can_id < 0x080] for out in (a, b)]
        assert commands[0] == commands[1]
        assert commands[0] or a.mode < Mode.ARMING or a.mode == Mode.DONE


def test_telemetry_has_the_declared_shapes_and_no_field_stands_still(session: Bench) -> None:
    hand = session.controller.model.hand
    sizes = {"joint": len(hand.joints), "tendon": len(hand.tendon), "motor": len(hand.motor), "digit": len(hand.digit)}
    silent_here = {"contact"} | ({"joint_encoder"} if not hand.sensor_node.joints else set())
    for name, axis in TELEMETRY_AXES.items():
        rows = [getattr(out.telemetry, name) for _, _, out in session.history]
        assert all(row.shape == (sizes[axis],) and row.dtype == np.float64 for row in rows), name
        values = np.array(rows)
        assert not np.isinf(values).any(), name
        if name not in silent_here:
            assert len(np.unique(values[~np.isnan(values)])) > 1 or name == "motor_temperature", name


def test_nothing_old_has_a_fresh_stamp() -> None:
    """A tick without frames shows NaN for every measurement, and its age grows."""
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 200.0), LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(0.5)
    run.to_host = lambda frames: []
    ages = []
    for _ in range(3):
        out = run.tick()
        numbers = out.telemetry
        for name in ("tension_raw", "motor_position", "motor_velocity", "motor_torque", "innovation", "nis"):
            assert np.isnan(getattr(numbers, name)).all(), name
        assert not np.isnan(numbers.tension).any(), "a prediction is there"
        ages.append(numbers.motor_age)
    np.testing.assert_allclose(np.diff(ages, axis=0), run.controller.model.period)


def test_missed_ticks_are_told_and_many_of_them_relax() -> None:
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 200.0), LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(0.5)
    assert run.tick(skip=1).action == Action.WARN
    run.run(0.1)
    stalled = run.controller.limits.stalled_ticks
    assert run.tick(skip=stalled - 1).action == Action.WARN
    run.run(0.1)
    out = run.tick(skip=stalled)
    assert (out.action, out.mode) == (Action.RELAX, Mode.RELAX)
    assert "H03" in run.state.failure


def test_load_cells_wired_in_another_order_belong_to_their_tendons() -> None:
    """The node lists its channels from the last tendon to the first; its second frame is lost."""
    content = tomllib.loads(hand_path("jamia11").read_text())
    content["sensor_node"]["tendons"] = content["sensor_node"]["tendons"][::-1]
    run = bench(HandModel.of(hand_from(content, "reversed"), Gains(), 200.0), LiveProgram())
    run.peer.order = list(range(11))[::-1]
    run.peer.bias[:] = np.linspace(0.0, 2.0, 11)
    run.until(Mode.ACTIVE)
    np.testing.assert_allclose(run.history[-1][2].telemetry.tension_raw, run.peer.bias, atol=0.05)
    run.to_host = lambda frames: [frame for frame in frames if frame.can_id != 0x1A1]
    run.until(Mode.DONE)
    lost = {mark.instance for mark in run.state.safety.latched if mark.id == "N02"}
    assert lost == set(run.controller.model.hand.tendon_names[::-1][5:10])


@pytest.fixture(scope="module")
def active() -> Bench:
    """A hand in action that holds something."""
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 200.0), LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(1.0)
    run.tick('{"do": "move", "angle_deg": {"middle": 20}, "duration_s": 5}')
    run.tick('{"do": "hold", "tension_N": {"index": 30}}')
    run.run(0.1)
    return run


FILTER_ARRAYS = ("x", "surprise", "nis", "lately", "wary")
FILTER_TUPLES = ("regimes", "stopped", "turning", "measured", "doubtful")


def changes(state: State) -> Iterator[tuple[str, State]]:
    """The state with one part of it changed, for every part."""
    simple = {
        "k": state.k + 1,
        "mode": Mode.RELAX,
        "mode_since": state.mode_since + 1e-9,
        "goal_time": np.nextafter(state.goal_time, 9e9),
        "armed": not state.armed,
        "clearing": not state.clearing,
        "failure": "x",
        "unconfirmed": ("x",),
    }
    for name, value in simple.items():
        yield name, state._replace(**{name: value})
    for i, drive in enumerate(state.drives):
        for name in drive._fields:
            value = {"phase": 4, "error_text": "x", "private": (*drive.private[:-1], 12345)}.get(name)
            new = drive._replace(**{name: getattr(drive, name) + 1 if value is None else value})
            yield f"drives[{i}].{name}", state._replace(drives=(*state.drives[:i], new, *state.drives[i + 1 :]))
    for name in ("asked", "stale", "misread"):
        sensors = state.sensors._replace(**{name: getattr(state.sensors, name) + 1})
        yield f"sensors.{name}", state._replace(sensors=sensors)
    for name in state.sensors.groups[0]._fields:
        group = state.sensors.groups[0]
        value = (*group.raw[:-1], 7) if name == "raw" else getattr(group, name) + 1
        groups = (group._replace(**{name: value}), *state.sensors.groups[1:])
        yield f"sensors.groups[0].{name}", state._replace(sensors=state.sensors._replace(groups=groups))
    for name in FILTER_ARRAYS:
        for i in range(len(getattr(state.filter, name))):
            x = getattr(state.filter, name).copy()
            x[i] = np.nextafter(x[i], 9e9)
            yield f"filter.{name}[{i}]", state._replace(filter=state.filter._replace(**{name: x}))
    for name in FILTER_TUPLES:
        values = getattr(state.filter, name)
        yield (
            f"filter.{name}",
            state._replace(filter=state.filter._replace(**{name: (type(values[0])(not values[0]), *values[1:])})),
        )
    yield "filter.covariance", state._replace(filter=state.filter._replace(covariance=np.eye(7)))
    yield "filter.started", state._replace(filter=state.filter._replace(started=not state.filter.started))
    for field in state.law._fields:
        present = getattr(state.law, field)
        array = np.zeros_like(state.law.force) if present is None else np.nan_to_num(present)
        array[-1] = np.nextafter(array[-1], 9e9)
        yield f"law.{field}", state._replace(law=state.law._replace(**{field: array}))
    coming = Coming(with_values(Gains(), {"motion.force_N": 21.0}, "test"))
    yield "gains", state._replace(gains=coming.gains)
    yield "coming", state._replace(coming=coming)
    yield "coming.step", state._replace(coming=replace(coming, step=1))
    progress = state.progress
    for name, value in {
        "step": progress.step + 1, "since": progress.since + 1e-9, "phase": "x", "finished": True, "failure": "x",
        "record": (1.0,), "tare": (1.0,), "contact": (True, *progress.contact[1:]),
        "touching": (9, *progress.touching[1:]),
    }.items():  # fmt: skip
        yield f"progress.{name}", state._replace(progress=replace(progress, **{name: value}))
    for name, goal in goals():
        yield f"goal {name}", state._replace(progress=replace(progress, goals=(goal, *progress.goals[1:])))
    yield "goals swapped", state._replace(progress=replace(progress, goals=progress.goals[::-1]))
    safety = state.safety
    yield "watch.counts", state._replace(watch=state.watch._replace(counts=Counts(unknown=1.0)))
    yield "watch.ropes", state._replace(watch=state.watch._replace(ropes=Ropes(cut=3)))
    for name in ("slip_from", "asked", "wanted", "goal"):
        yield f"watch.{name}", state._replace(watch=state.watch._replace(**{name: np.full(4, 7.5)}))
    yield "watch.taut", state._replace(watch=state.watch._replace(taut=(7.5,) * 4))
    yield "watch.owed", state._replace(watch=state.watch._replace(owed=(7,) * 4))
    low = state.watch.filtered.low + 1.0
    yield "watch.filtered", state._replace(watch=state.watch._replace(filtered=state.watch.filtered._replace(low=low)))
    stuck = state.watch.stuck
    for name in ("motors", "joints"):
        accepted = getattr(state.watch, name)
        gap = accepted._replace(gap=accepted.gap + 1)
        yield f"watch.{name}", state._replace(watch=state.watch._replace(**{name: gap}))
    yield "watch.stuck", state._replace(watch=state.watch._replace(stuck=stuck._replace(ticks=stuck.ticks + 1)))
    yield "touch.tension", state._replace(touch=state.touch._replace(tension=state.touch.tension + 1.0))
    for name in Posture._fields:
        changed = state.posture._replace(**{name: getattr(state.posture, name) + 1.0})
        yield f"posture.{name}", state._replace(posture=changed)
    yield "touch.blocked", state._replace(touch=state.touch._replace(blocked=(True,) * 4))
    yield "safety.counting", state._replace(safety=replace(safety, counting=(*safety.counting, ("B01", "x", 1))))
    yield "safety.latched", state._replace(safety=replace(safety, latched=(*safety.latched, ("B01", "x"))))  # type: ignore[arg-type]


def goals() -> Iterator[tuple[str, DigitGoal]]:
    move = MinimumJerk(np.array([0.1]), np.array([0.2]), 1.0)
    tension = np.array([5.0])
    yield "limp", DigitGoal()
    yield "motion", DigitGoal(Kind.MOTION, move, since=1.0)
    yield "since", DigitGoal(Kind.MOTION, move, since=2.0)
    for name, value in (("start", np.array([0.11])), ("end", np.array([0.21])), ("duration", 1.1)):
        yield name, DigitGoal(Kind.MOTION, replace(move, **{name: value}), since=1.0)
    yield "tension", DigitGoal(Kind.TENSION, tension=tension)
    yield "other tension", DigitGoal(Kind.TENSION, tension=tension + 1e-12)
    yield "rate", DigitGoal(Kind.TENSION, tension=tension, rate=201.0)
    yield "limit", DigitGoal(Kind.TENSION, tension=tension, force_limit=12.0)


def test_every_part_of_the_state_changes_its_digest(active: Bench) -> None:
    state = active.state
    names = set(State._fields)
    seen = {state.digest(): "unchanged"}
    covered = set()
    for name, changed in changes(state):
        digest = changed.digest()
        assert len(digest) == 8
        assert digest not in seen, f"{name} and {seen[digest]} have one digest"
        seen[digest] = name
        covered |= {one for one in names if getattr(changed, one) is not getattr(state, one)}
    assert covered == names, "a new part of the state needs a line in changes()"
    assert set(state.filter._fields) == {*FILTER_ARRAYS, *FILTER_TUPLES, "covariance", "started"}
    law = {"setpoint", "integral", "force", "planned", "rate", "trim", "held", "friction_state"}
    assert set(state.law._fields) == law
    assert state._replace().digest() == state.digest()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_never_reaches_a_wire(active: Bench, bad: float) -> None:
    x = active.state.filter.x.copy()
    x[0] = bad
    state = active.state._replace(filter=active.state.filter._replace(x=x))
    entry = TickIn(active.k, active.k * active.period_ns)
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match="torque"):
        active.controller.tick(state, entry)


KNOWN = [0x011, 0x012, 0x013, 0x014, 0x1A0, 0x1B0]
frames = st.builds(
    Frame,
    can_id=st.sampled_from(KNOWN) | st.integers(0, 0x7FF) | st.integers(0, 2**32 - 1),
    data=st.binary(max_size=8) | st.binary(max_size=64),
    flags=st.sampled_from([0, 4, 5]),
    bus=st.sampled_from([0, 0, 0, 1, 7]),
    t_ns=st.integers(-1, 2**62),
)


@settings(max_examples=150)
@given(burst=st.lists(st.lists(frames, max_size=12), min_size=1, max_size=6))
def test_no_frame_can_stop_the_tick(active: Bench, burst: list[list[Frame]]) -> None:
    """Whatever comes, in action: no exception, every torque within the limit, every number finite."""
    state, k = active.state, active.k
    for some in burst:
        state, out = active.controller.tick(state, TickIn(k, k * active.period_ns, frames=tuple(some)))
        torque = out.telemetry.motor_torque_goal
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= active.controller.model.torque_limit * (1 + 1e-9)).all()
        k += 1


@settings(max_examples=50)
@given(
    texts=st.lists(st.text(max_size=60) | st.sampled_from(['{"do": "clear"}', '{"do": "arm"}', "[" * 900]), max_size=4),
    kinds=st.lists(st.sampled_from(["enobufs", "dropped", "recorder", "error_frame", "signal", "?"]), max_size=4),
    late=st.integers(0, 10**10),
    gap=st.integers(0, 10**6),
)
def test_no_request_event_or_delay_can_stop_the_tick(
    active: Bench, texts: list[str], kinds: list[str], late: int, gap: int
) -> None:
    k = active.k + gap
    events = tuple(IoEvent(kind, "x", 1) for kind in kinds)
    entry = TickIn(k, k * active.period_ns, late, (), events, tuple(texts))
    _, out = active.controller.tick(active.state, entry)
    assert all(event.text.isprintable() for event in out.events)


def test_a_hand_armed_under_tension_is_not_jerked() -> None:
    """A hand that already holds something when its program begins: the tension loop starts at what is there."""
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 200.0), LiveProgram())
    run.peer.x[:] = 0.3e-3 + 20.0 / run.peer.stiffness
    run.peer.braked = True
    run.until(Mode.ACTIVE)
    first = run.history[-1][2].telemetry
    np.testing.assert_allclose(first.tension, 20.0, atol=6.0)
    assert (first.motor_torque_goal > 0.0).all(), "no kick backwards"
