"""Record ten simulated minutes with injected faults, and execute the log again. This test runs at night.

`python tests/replay/test_long.py OUT.mcap` keeps the log.
"""

import random
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import runs

from handctl.core.types import IoEvent
from handctl.log.read.reader import RunLog
from handctl.programs.grasp import TaskProgram
from handctl.programs.task import load_task
from handctl.replay.execute import execute_log
from handctl.runtime.clocks.lockstep import LockstepSimulator

RATE_HZ, SECONDS = 200.0, 600.0
DEAF_S = 598.0
MOVE = '[[phase]]\nkind = "move"\nname = "move {n}"\nangle_deg = {angle:.3f}\nduration_s = 2.0\n'


@dataclass
class LossyPeer:
    """A lockstep peer that loses one reply in two hundred, and sometimes all replies of two ticks.

    Such losses do not end a run.
    """

    peer: LockstepSimulator
    chance: random.Random = field(default_factory=lambda: random.Random(6))
    silent: int = 0

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Step the peer, and return its replies without the lost ones."""
        replies = self.peer.step(t_ns, frames)
        if self.chance.random() < 0.002:
            self.silent = 2
        self.silent -= 1
        return [reply for reply in replies if self.silent < 0 and self.chance.random() > 0.005]

    def close(self) -> None:
        """Close the peer without lost replies."""
        self.peer.close()


def write(log: Path) -> None:
    """Record ten minutes with a grasp and many moves.

    Frames are lost all the time, and a motor falls silent at the end.
    """
    chance = random.Random(7)
    moves = [
        MOVE.format(n=n, angle=chance.uniform(2.0, 60.0)) for n in range(int((SECONDS - 4) / 2))
    ]
    task = log.with_suffix(".task.toml")
    task.write_text(runs.TASK + "".join(moves))
    ticks = range(400, int(SECONDS * RATE_HZ), 1999)
    io_events = {k: (IoEvent("recorder", "dropped", 1),) for k in ticks}
    requests = {k + 7: ("no request",) for k in ticks}

    def spoil(peer: LockstepSimulator) -> LockstepSimulator:
        return runs.PeerWithLostReplies(LossyPeer(peer), 0x12, int(DEAF_S * 1e9))

    runs.run(
        log,
        TaskProgram(load_task(task)),
        rate_hz=RATE_HZ,
        spoil=spoil,
        io_events=io_events,
        requests=requests,
    )


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_ten_minutes_with_faults_repeat_to_the_last_bit(tmp_path: Path) -> None:
    write(tmp_path / "ten.mcap")
    with RunLog(tmp_path / "ten.mcap") as log:
        faults = {event.event.text[:3] for event in log.events if event.event.name == "fault"}
        assert {"B01", "B17", "H09", "I07"} <= faults
        result = execute_log(log)
        assert result.ticks == len(log) > 0.99 * SECONDS * RATE_HZ
    assert (result.differing_ticks, result.first_difference) == (0, None)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
