"""Gains that were set in a run are in its log, and the run repeats to the last bit."""

from pathlib import Path

import runs

from handctl.log.reader import RunLog
from handctl.replay.execute import execute

REQUEST = '{"do": "gains", "set": {"motion.force_N": 40.0, "tension.integral_per_s": 6.0}}'


def test_a_run_whose_gains_were_set_repeats(tmp_path: Path) -> None:
    log = tmp_path / "set.mcap"
    asked = {300: (REQUEST, '{"do": "gains", "set": {"motion.force": 1}}'), 600: ('{"do": "stop"}',)}
    runs.run(log, runs.short_task(tmp_path), rate_hz=200.0, asked=asked)
    with RunLog(log) as record:
        told = {event.event.where: event.event.text for event in record.events if event.event.name == "gain"}
        assert told == {"motion.force_N": "40.0", "tension.integral_per_s": "6.0"}
        refused = [event.event.text for event in record.events if event.event.text.startswith("refused")]
        assert refused == ["refused: gains: motion.force: no such gain; expected motion.force_N?"]
        found = execute(record)
    assert (found.differing, found.first) == (0, None)
