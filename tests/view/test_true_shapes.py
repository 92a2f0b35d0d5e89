"""Test how the view shows the object and the table of a simulated run.

In the view, the poses of object and table equal those in the truth file of the simulator.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rrd_entities import entities_of_file, read_entities, run_info_of

from handctl.cli.main import main
from handctl.errors import LogError
from handctl.report.truth_record import TruthRecord, read_truth
from handctl.view.scene.object_and_table import object_and_table_chunks
from handctl.view.scene.run_info import RunInfo

SCENE_SHAPES: dict[str, Any] = {
    "object": {"shape": "cylinder", "size_m": [0.04, 0.04, 0.09]},
    "table": {"shape": "box", "size_m": [0.2, 0.2, 0.01], "position_m": [0.02, 0.0, -0.05]},
}
GROUND_TRUTH_COLUMNS = (
    *(f"object/{pose_column}" for pose_column in ("x", "y", "z", "qw", "qx", "qy", "qz")),
    "support",
)


def make_truth_record(scene_shapes: dict[str, Any], duration_s: float = 1.0) -> TruthRecord:
    """Return a truth record in which the object rises at 10 mm/s and the table sinks at 50 mm/s."""
    t_ns = np.arange(0, int(duration_s * 1e9) + 1, 1_000_000)
    values = np.zeros((len(t_ns), len(GROUND_TRUTH_COLUMNS)))
    values[:, 2] = 0.01e-9 * t_ns
    values[:, 3] = 1.0
    values[:, 7] = 0.05e-9 * t_ns
    return TruthRecord({"shapes": scene_shapes}, t_ns, values, GROUND_TRUTH_COLUMNS)


def drawn_entities(log_path: Path, truth: TruthRecord | None, offset_ns: int = 0) -> dict[str, Any]:
    """Return the viewer's entities for object and table of a run with the truth record ``truth``."""
    run = run_info_of(log_path)
    header = replace(
        run.header, metadata={**run.header.metadata, "truth_offset_ns": str(offset_ns)}
    )
    return read_entities(object_and_table_chunks(RunInfo(header, run.hand, run.name, truth)))


def test_object_and_table_are_where_the_truth_has_them(jamia_log_path: Path) -> None:
    entities = drawn_entities(
        jamia_log_path, make_truth_record(SCENE_SHAPES), offset_ns=400_000_000
    )
    assert entities.keys() == {
        f"/true/{name}" for name in ("object", "table", "object_pose", "table_pose")
    }
    body, table = entities["/true/object_pose"], entities["/true/table_pose"]
    assert body.times[0] == 0
    position = np.array([row[0] for row in body.rows["Transform3D:translation"]])
    assert position[0] == pytest.approx([0.0, 0.0, 0.004], abs=1e-6)
    assert np.diff(position[:, 2]) == pytest.approx(0.01 * 0.02, abs=1e-6)
    table_positions = np.array([row[0] for row in table.rows["Transform3D:translation"]])
    assert table_positions[0] == pytest.approx([0.02, 0.0, -0.07], abs=1e-6)


def test_a_run_without_truth_or_without_shapes_has_none(jamia_log_path: Path) -> None:
    assert drawn_entities(jamia_log_path, None) == {}
    assert drawn_entities(jamia_log_path, make_truth_record({})) == {}


def test_an_unknown_shape_is_one_line(jamia_log_path: Path) -> None:
    with pytest.raises(LogError, match="expected cylinder, sphere or box"):
        drawn_entities(
            jamia_log_path, make_truth_record({"object": {"shape": "torus", "size_m": [1, 1, 1]}})
        )


def write_truth(truth_file: Path, truth: TruthRecord) -> None:
    """Write a truth record to a file, and assert that the reader of truth files can read the file."""
    head = json.dumps({"columns": truth.columns, **truth.header}) + "\n"
    rows = np.zeros(len(truth.t_ns), [("t_ns", "<i8"), ("v", "<f8", (len(truth.columns),))])
    rows["t_ns"] = truth.t_ns
    rows["v"] = truth.values
    truth_file.write_bytes(head.encode() + rows.tobytes())
    assert read_truth(truth_file).columns == truth.columns


def test_a_named_truth_is_drawn_and_one_of_another_time_refused(
    jamia_log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, recording_path = tmp_path / "some.truth", tmp_path / "run.rrd"
    write_truth(path, make_truth_record(SCENE_SHAPES))
    arguments = ["view", str(jamia_log_path), "--save", str(recording_path), "--truth", str(path)]
    assert main([*arguments, "--json"]) == 0
    assert "/true/object" in entities_of_file(recording_path)
    capsys.readouterr()
    truth = make_truth_record(SCENE_SHAPES)
    write_truth(
        path,
        TruthRecord(truth.header, truth.t_ns + 10**12, truth.values, truth.columns),
    )
    assert main(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1
