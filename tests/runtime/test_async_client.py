"""Test the Python client for asyncio with a simulated hand in real time."""

import asyncio
import inspect

import numpy as np
import pytest

import handctl as library
from handctl import BusError, ConfigError, DriveError
from tests.runtime.processes import LOCAL_BUS, modes_of_complete_log

REALTIME_MARK = pytest.mark.realtime


async def use_hand_as_client(*connect_options):
    """Use a client to move a hand, to stream targets, to observe the hand, and to cancel a motion.

    At the same time, another asyncio task counts how often it runs. The count shows that the client
    does not block the event loop.
    """
    loop_count = 0

    async def count():
        nonlocal loop_count
        while True:
            loop_count += 1
            await asyncio.sleep(0.01)

    counting_task = asyncio.create_task(count())
    async with library.connect_async("jamia", LOCAL_BUS, *connect_options) as hand:
        loop_count = 0
        await hand.move(index=30.0)
        assert loop_count > 30, "other tasks go on while the hand moves"
        assert hand.observe().q_deg[:3] == pytest.approx(30.0, abs=3.0)
        with pytest.raises(ConfigError, match="no digit 'pinky'"):
            await hand.wait_for(contact="pinky")
        observe_task = asyncio.create_task(observe_hand(hand))
        async with await hand.stream(50, "digit", ["index"]) as stream:
            assert (stream.names, stream.rate_Hz) == (("index",), 50)
            assert 1 / 50 < stream.horizon_s < 2 / 50
            for i in range(50):
                stream.send([30.0 + 10.0 * np.sin(2 * np.pi * i / 50)])
                await stream.sleep()
            status = stream.status
        ticks, swing_amplitude = await observe_task
        moving_task = asyncio.create_task(hand.move(index=80.0, duration_s=20.0))
        await hand.wait_for(phase="live")
        await asyncio.sleep(1.0)
        moving_task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving_task
        await hand.hold()
        await asyncio.sleep(1.0)
        at = hand.observe().q_deg[:3].mean()
    counting_task.cancel()
    return hand.result, status, ticks, swing_amplitude, at


async def observe_hand(hand):
    """Observe a hand 200 times.

    Return the ticks of the observations, and the range of the first joint angle [deg]. The range of
    a joint angle is the largest angle minus the smallest angle.
    """
    ticks, angles = [], []
    async for observation in hand.observations():
        ticks.append(observation.k)
        angles.append(observation.q_deg[0])
        if len(ticks) == 200:
            return ticks, np.ptp(angles)
    raise AssertionError("the run has ended")


@REALTIME_MARK
def test_a_program_moves_a_hand_with_asyncio(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    options = ("--calibration", "c.toml", "--log", "live.mcap", *time_scale_options)
    result, status, ticks, swing_amplitude, at = asyncio.run(use_hand_as_client(*options))
    assert result["failure"] == ""
    assert status.accepted > 45
    assert (status.refused, status.clipped) == (0, 0)
    assert set(np.diff(ticks)) == {1}, "every tick, in order"
    assert swing_amplitude > 5.0
    assert at < 60.0, "hold ended the move"
    modes_of_complete_log(work_folder / "live.mcap")


@REALTIME_MARK
def test_a_hand_is_opened_and_closed_without_a_block(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    async def connect_and_use_hand():
        options = ("--calibration", "c.toml", "--log", "live.mcap", *time_scale_options)
        hand_truth_file = await library.connect_async("jamia", LOCAL_BUS, *options).open()
        phase = hand_truth_file.observe().phase
        await hand_truth_file.close()
        await hand_truth_file.close()  # a second call of ``close`` has no effect
        return phase, hand_truth_file.result

    phase, result = asyncio.run(connect_and_use_hand())
    assert (phase, result["failure"]) == ("live", "")
    modes_of_complete_log(work_folder / "live.mcap")


@REALTIME_MARK
def test_an_exception_in_the_block_stops_the_hand(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    async def fail():
        async with library.connect_async(
            "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
        ):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        asyncio.run(fail())
    modes_of_complete_log(work_folder / "live.mcap")


@REALTIME_MARK
@pytest.mark.parametrize("wait_s", [0.0, 0.5])
def test_a_cancelled_start_leaves_no_armed_hand(
    work_folder, hand_truth_file, calibration_options, time_scale_options, wait_s
):
    """Reproduce a defect: if the start in ``async with`` timed out, the controller still armed the hand.

    When the timeout ended the start, the body of the ``async with`` block had not begun. Therefore
    nothing closed the client, and the hand stayed armed.
    """

    async def connect_with_short_timeout():
        client = library.connect_async(
            "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
        )
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(wait_s), client:
                raise AssertionError("the hand needs longer to start")
        return client

    client = asyncio.run(connect_with_short_timeout())
    assert client.client.child.poll() is not None, "the controller has ended"
    with pytest.raises(BusError, match="this client is closed"):
        client.observe()


def test_a_controller_that_cannot_start_is_one_error(work_folder):
    async def connect():
        async with library.connect_async("no-such-hand", LOCAL_BUS):
            pass

    with pytest.raises(DriveError, match="no-such-hand"):
        asyncio.run(connect())


def test_every_call_has_its_coroutine():
    """With a few exceptions, the asyncio client has a coroutine for each method of the ordinary client."""
    names_without_coroutine = {
        "end_stream",
        "state",
        "wait",
        "poll_observations",
        "observe",
        "observations",
    }
    names = (
        {name for name in vars(library.HandClient) if not name.startswith("_")}
        - names_without_coroutine
        - {"description"}
    )
    for name in names:
        blocking_call, asynchronous_call = (
            getattr(library.HandClient, name),
            getattr(library.AsyncHandClient, name),
        )
        assert inspect.iscoroutinefunction(asynchronous_call), name
        expected = set(inspect.signature(blocking_call).parameters)
        own_parameters = set(inspect.signature(asynchronous_call).parameters)
        assert own_parameters == expected or "options" in own_parameters, name
    blocking_call, asynchronous_call = (
        inspect.signature(library.connect),
        inspect.signature(library.connect_async),
    )
    assert blocking_call.parameters == asynchronous_call.parameters
