"""Test the time scale of a run.

By default, a run uses the time scale of the running simulator. The operator can request another
time scale for a run.
"""

import pytest

from handctl.errors import ConfigError
from handctl.session.run_plan import RunOptions, make_plan
from tests.runtime.processes import LOCAL_BUS, make_time_scale_options, run_handctl, start_hand


@pytest.fixture
def hand_at_slow_time_scale(work_folder, started_processes):
    """Start a simulated hand whose time runs at 0.3 times real time."""
    started_processes.append(
        start_hand(work_folder / "truth", "--hand", "jamia", *make_time_scale_options(0.3))
    )
    return started_processes[-1]


def time_scale_of(**choice):
    return make_plan(RunOptions("jamia", bus_arguments=[LOCAL_BUS], **choice)).time_scale


def test_a_run_has_the_time_scale_of_the_simulator_on_its_bus(hand_at_slow_time_scale):
    assert time_scale_of() == 0.3
    assert time_scale_of(time_scale=0.3) == 0.3
    with pytest.raises(
        ConfigError, match=r"--time-scale: 1; expected 0\.3, as the simulator on local:t has"
    ):
        time_scale_of(time_scale=1.0)


def test_a_wrong_time_scale_is_refused_before_the_bus_is_opened(hand_at_slow_time_scale):
    for verb in (("run", "--task", "short.toml"), ("bus", "watch", "--for", "1"), ("commission",)):
        process_result = run_handctl(
            *verb, "--hand", "jamia", "--bus", LOCAL_BUS, *make_time_scale_options(1.0)
        )
        assert process_result.returncode == 2
        assert "expected 0.3" in process_result.stderr


def test_without_a_simulator_a_run_has_real_time(work_folder):
    assert time_scale_of() == 1.0
    assert time_scale_of(time_scale=0.5) == 0.5
    assert make_plan(RunOptions("jamia")).time_scale == 1.0


def test_the_socket_of_a_killed_simulator_is_passed_over(hand_at_slow_time_scale):
    hand_at_slow_time_scale.kill()
    hand_at_slow_time_scale.wait()
    assert time_scale_of() == 1.0
