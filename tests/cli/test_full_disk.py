"""Test commands that cannot write the files beside the log, because the disk is full.

For each file that cannot be written, the command prints one error line. All files of the run that
can be written are complete.
"""

import json
from pathlib import Path

from handctl.cli.main import main
from handctl.session.verdict import _copy_truth
from tests.report.generated_run import JAMIA_HAND, write_truth, zero_truth_record

GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"
FULL_DISK_DEVICE = Path("/dev/full")
"""A device that behaves like a full disk: it accepts no byte."""
SHORT_TASK = """schema = 1
name = "short"
[[phase]]
kind = "move"
name = "bend"
angle_deg = 10.0
duration_s = 0.1
"""


def test_a_run_without_room_for_its_picture_keeps_its_numbers(work_folder, capsys):
    (work_folder / "short.toml").write_text(SHORT_TASK)
    (work_folder / "run.png").symlink_to(FULL_DISK_DEVICE)
    words = ("--lockstep", "--json", "--task", "short.toml", "--scene", "none", "--log", "run.mcap")
    assert main(["demo", *words]) == 0
    out, err = capsys.readouterr()
    assert "handctl: run.png is left out: No space left on device" in err.splitlines()
    result = json.loads(out)
    assert result["ticks"] > 100
    assert result["picture"] is None
    assert not (work_folder / "run.png").is_symlink(), "an incomplete picture is removed"


def test_a_truth_file_that_cannot_be_copied_is_read_in_place(work_folder):
    truth = work_folder / "sim.truth"
    record = zero_truth_record(JAMIA_HAND, 10)
    write_truth(truth, record)
    times = record.t_ns[[0, -1]].tolist()
    (work_folder / "run.truth").symlink_to(FULL_DISK_DEVICE)
    messages: list[str] = []
    assert _copy_truth(work_folder / "run.mcap", truth, times, messages.append) == truth
    assert messages == [
        f"handctl: {work_folder / 'run.truth'} is left out: No space left on device"
    ]


def test_a_page_that_cannot_be_written_is_one_line(work_folder, capsys):
    out = work_folder / "page.html"
    out.symlink_to(FULL_DISK_DEVICE)
    assert main(["report", str(GOLDEN_FOLDER / "jamia-fault.mcap"), "--output", str(out)]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert "No space left on device" in err
