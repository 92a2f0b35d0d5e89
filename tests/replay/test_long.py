"""Record a simulated run of ten minutes with injected faults, and execute the log again.

The test of ten minutes runs only in nightly test runs.

`python tests/replay/test_long.py OUT.mcap` stores the log of the run.
"""

import random
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import short_runs

from handctl.core.tick_types import IoEvent
from handctl.log.read.reader import RunLog
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.replay.log_execution import execute_log
from handctl.runtime.clocks.lockstep import LockstepSimulator

RATE_HZ, DURATION_S = 200.0, 600.0
SILENCE_START_S = 598.0
MOVE_PHASE = (
    '[[phase]]\nkind = "move"\nname = "move {n}"\nangle_deg = {angle:.3f}\nduration_s = 2.0\n'
)


@dataclass
class SimulatorWithLostReplies:
    """Wrap a lockstep simulator, and drop some of the simulator's replies at random.

    The wrapper drops one reply in two hundred, and sometimes all replies of two ticks. Because only
    a few replies are lost, the run continues.
    """

    peer: LockstepSimulator
    random_source: random.Random = field(default_factory=lambda: random.Random(6))
    silent_ticks_left: int = 0

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Step the wrapped simulator, and return those of its replies that the wrapper does not drop."""
        replies = self.peer.step(t_ns, frames)
        if self.random_source.random() < 0.002:
            self.silent_ticks_left = 2
        self.silent_ticks_left -= 1
        return [
            reply
            for reply in replies
            if self.silent_ticks_left < 0 and self.random_source.random() > 0.005
        ]

    def close(self) -> None:
        """Close the wrapped simulator."""
        self.peer.close()


def write_long_log(log_path: Path) -> None:
    """Record a simulated run of ten minutes with a grasp and many moves.

    Frames are lost during the whole run, and a motor stops sending at the end of the run.
    """
    random_source = random.Random(7)
    move_phases = [
        MOVE_PHASE.format(n=n, angle=random_source.uniform(2.0, 60.0))
        for n in range(int((DURATION_S - 4) / 2))
    ]
    task = log_path.with_suffix(".task.toml")
    task.write_text(short_runs.SHORT_GRASP_TASK + "".join(move_phases))
    ticks = range(400, int(DURATION_S * RATE_HZ), 1999)
    io_events = {k: (IoEvent("recorder", "dropped", 1),) for k in ticks}
    requests = {k + 7: ("no request",) for k in ticks}

    def wrap_with_lost_replies(peer: LockstepSimulator) -> LockstepSimulator:
        return short_runs.PeerWithLostReplies(
            SimulatorWithLostReplies(peer), 0x12, int(SILENCE_START_S * 1e9)
        )

    short_runs.record_lockstep_run(
        log_path,
        TaskProgram(load_task(task)),
        rate_hz=RATE_HZ,
        wrap_simulator=wrap_with_lost_replies,
        io_events=io_events,
        requests=requests,
    )


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_ten_minutes_with_faults_repeat_to_the_last_bit(tmp_path: Path) -> None:
    write_long_log(tmp_path / "ten.mcap")
    with RunLog(tmp_path / "ten.mcap") as log:
        faults = {event.event.text[:3] for event in log.events if event.event.name == "fault"}
        assert {"B01", "B17", "H09", "I07"} <= faults
        result = execute_log(log)
        assert result.ticks == len(log) > 0.99 * DURATION_S * RATE_HZ
    assert (result.differing_ticks, result.first_difference) == (0, None)


if __name__ == "__main__":
    write_long_log(Path(sys.argv[1]))
