"""The content of a Rerun recording equals the content of the log from which it was made."""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rrd_entities import RecordingEntity, entities_of_file, read_entities, run_info_of

from handctl.core.tick_types import TELEMETRY_FIELDS
from handctl.drives.frame_time import frame_time_s
from handctl.errors import ConfigError, LogError
from handctl.hand.digit import DigitModel
from handctl.hand.link_frames import link_transforms
from handctl.log.read.logfile import LogFile
from handctl.log.read.reader import RunLog
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.view import rerun_conversion
from handctl.view.scene import palette
from handctl.view.scene.bus_load_calculator import BUS_LOAD_WINDOW_NS
from handctl.view.scene.run_info import RunInfo
from handctl.view.scene.topic_converters import ARROW_LENGTH_M_PER_N, limits_near_tensions


@pytest.fixture(scope="module")
def recorded_entities(recording_path: Path) -> dict[str, RecordingEntity]:
    return entities_of_file(recording_path)


@pytest.fixture(scope="module")
def run_log(log_path: Path) -> Iterator[RunLog]:
    with RunLog(log_path) as log:
        yield log


def test_every_number_of_the_controller_is_there_under_its_name(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    for name in TELEMETRY_FIELDS:
        entity = recorded_entities[f"/controller/{name}"]
        np.testing.assert_array_equal(entity.times, run_log.t_ns)
        np.testing.assert_array_equal(entity.table("Scalars:scalars"), run_log.field(name))
        assert tuple(entity.static_values["SeriesLines:names"]) == run_log.names(name)


def test_tension_has_its_band_and_command(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    entity = recorded_entities["/tension/estimate"]
    np.testing.assert_array_equal(entity.times, run_log.t_ns)
    np.testing.assert_array_equal(entity.table("Measurements:values"), run_log.field("tension"))
    np.testing.assert_allclose(
        entity.table("Measurements:variances") ** 0.5, run_log.field("tension_sigma"), rtol=1e-12
    )
    np.testing.assert_array_equal(
        recorded_entities["/tension/command"].table("Scalars:scalars"),
        run_log.field("tension_goal"),
    )
    assert entity.static_values["Measurements:names"] == list(run_log.header.tendons)


def test_a_distant_limit_is_not_drawn(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    """Reproduce a defect: a plot showed the limit of 110 N, so tensions of 30 N filled only a third of the plot."""
    largest = float(np.nanmax(run_log.field("tension")))
    assert largest < 0.6 * 110.0
    limit = recorded_entities.get("/tension/limit")
    assert limit is None or not limit.times.size
    tension = np.array([[3.0, 30.0], [np.nan, 66.0]])
    np.testing.assert_array_equal(
        limits_near_tensions([40.0, 110.0, 200.0], tension), [40, 110, np.nan]
    )
    assert np.isnan(limits_near_tensions([110.0], np.full((2, 2), np.nan))).all()


def test_angles_are_in_degrees_digit_by_digit(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    """Reproduce a defect: uncertainty bands of 20 deg covered the curves of the angles.

    To keep the curves visible, the view draws no uncertainty band for an angle.
    """
    for kind, name in {"estimate": "q", "command": "q_goal"}.items():
        angles_of_digits = [
            recorded_entities[f"/angle/{digit}/{kind}"].table("Scalars:scalars")
            for digit in run_log.header.digits
        ]
        np.testing.assert_allclose(
            np.hstack(angles_of_digits), np.degrees(run_log.field(name)), atol=1e-12
        )


def test_arrows_are_the_forces_of_the_object_on_the_tips(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    forces = run_log.field("tip_force")
    assert forces.max() > 1
    for index, digit in enumerate(run_log.header.digits):
        entity = recorded_entities[f"/force/{digit}"]
        vectors = entity.table("Arrows3D:vectors")[:, 0]
        force = np.where(forces[:, index] >= 0.05, forces[:, index], 0.0)
        np.testing.assert_allclose(
            vectors, force[:, None] * (0, -ARROW_LENGTH_M_PER_N, 0), atol=1e-7
        )
        tick_index = int(force.argmax())
        assert entity.rows["Arrows3D:labels"][tick_index] == [f"{force[tick_index]:.1f} N"]
        assert entity.static_values["CoordinateFrame:frame"] == [f"{digit}_tip"]


def test_states_change_as_in_the_log(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    phase = recorded_entities["/state/phase"]
    expected = [
        (int(t), names[0])
        for t, names in zip(phase.times, phase.rows["StateChange:state"], strict=True)
    ]
    assert expected == [(change.t_ns, change.name) for change in run_log.phases]
    assert len(expected) == 7
    for lane, numbers in (("mode", run_log.mode), ("safety", run_log.action)):
        changes = 1 + np.flatnonzero(np.diff(numbers.astype(int)))
        np.testing.assert_array_equal(
            recorded_entities[f"/state/{lane}"].times, run_log.t_ns[[0, *changes]]
        )
        shown_states = {
            names[0] for names in recorded_entities[f"/state/{lane}"].rows["StateChange:state"]
        }
        assert shown_states <= set(
            recorded_entities[f"/state/{lane}"].static_values["StateConfiguration:values"]
        )


def test_lateness_and_bus_load_add_up(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    np.testing.assert_allclose(
        recorded_entities["/loop/late"].table("Scalars:scalars")[:, 0],
        run_log.late_ns / 1e3,
        atol=1e-9,
    )
    period = run_log.header.period_ns * 1e-9
    bus_times, expected = [], []
    for tick in run_log.ticks():
        frames = (*tick.tick_in.frames, *tick.frames)
        bus_times.append(
            (tick.tick_in.t_ns, sum(frame_time_s(len(frame.data), False, 1e6) for frame in frames))
        )
        now = tick.tick_in.t_ns
        frame_times_in_window = [
            time for t, time in bus_times if now - BUS_LOAD_WINDOW_NS < t <= now
        ]
        expected.append(
            100 * sum(frame_times_in_window) / min(BUS_LOAD_WINDOW_NS * 1e-9, now * 1e-9 + period)
        )
    np.testing.assert_allclose(
        recorded_entities["/bus/load"].table("Scalars:scalars")[:, 0], expected, rtol=1e-9
    )
    assert 3 < expected[-1] < 100


def test_frames_put_the_fingertips_where_kinematics_does(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog, log_path: Path
) -> None:
    edges: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}
    time_ns = int(run_log.t_ns[-1] * 0.5)
    for entity in (recorded_entities["/tf_static"], recorded_entities["/tf"]):
        values_by_component = {name.split(":")[1]: values for name, values in entity.rows.items()}
        for i in np.flatnonzero(entity.times <= time_ns):
            child, parent = (
                values_by_component["child_frame"][i][0],
                values_by_component["parent_frame"][i][0],
            )
            edges[child] = (
                parent,
                np.array(values_by_component["translation"][i][0]),
                np.array(values_by_component["quaternion"][i][0]),
            )
    tick_index = int(
        np.searchsorted(
            run_log.t_ns,
            recorded_entities["/tf"].times[recorded_entities["/tf"].times <= time_ns].max(),
        )
    )
    hand = run_info_of(log_path).hand
    for digit, joints in zip(hand.digit, hand.digit_joints.values(), strict=True):
        tip = link_transforms(
            DigitModel.from_hand(hand, digit.name), run_log.field("q")[tick_index, joints]
        )[-1]
        np.testing.assert_allclose(_frame_position(edges, tip.frame), tip.position, atol=1e-7)


def _frame_position(
    transform_by_frame: dict[str, tuple[str, np.ndarray, np.ndarray]], frame_name: str
) -> np.ndarray:
    """Return the position of a coordinate frame's origin relative to the palm, from the chain of transforms."""
    frame_position = np.zeros(3)
    while frame_name != "palm":
        frame_name, translation, (x, y, z, w) = transform_by_frame[frame_name]
        axis = np.array([x, y, z])
        frame_position = (
            frame_position
            + 2 * np.cross(axis, np.cross(axis, frame_position) + w * frame_position)
            + translation
        )
    return frame_position


def test_every_visual_shape_is_solid_and_in_its_digits_colour(
    recorded_entities: dict[str, RecordingEntity], run_log: RunLog
) -> None:
    robot = ET.fromstring(run_log.header.attachments["hand.urdf"])
    visual_paths = {
        f"/hand/{link.get('name')}/visual_{i}"
        for link in robot
        for i, _ in enumerate(link.iter("visual"))
    }
    assert visual_paths == {path for path in recorded_entities if path.startswith("/hand/")}
    for path in visual_paths:
        static_values = recorded_entities[path].static_values
        (kind,) = {name.split(":")[0] for name in static_values} & {
            "Boxes3D",
            "Cylinders3D",
            "Ellipsoids3D",
        }
        assert static_values[f"{kind}:fill_mode"] == [3]
    red, green, blue = palette.digit_colour(0)
    colours = recorded_entities["/hand/index_link1/visual_0"].static_values["Cylinders3D:colors"]
    assert colours == [red << 24 | green << 16 | blue << 8 | 255]


def test_the_layout_is_saved_with_the_recording(recording_path: Path, log_path: Path) -> None:
    reader = RrdReader(recording_path)
    (recording,), (layout,) = reader.recordings(), reader.blueprints()
    assert recording.application_id == layout.application_id == f"handctl_{log_path.stem}"


def test_time_slices_do_not_change_the_recording(
    recorded_entities: dict[str, RecordingEntity], log_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handctl.view.time_slices.SLICE_DURATION_NS", 333_000_000)
    repeated_entities = read_entities(
        rerun_conversion.chunks_of_run(log_path, run_info_of(log_path), 333_000_000)
    )
    assert repeated_entities.keys() == recorded_entities.keys() - {"/__properties"}
    for path in repeated_entities.keys() - {"/tension/limit"}:
        entity = repeated_entities[path]
        np.testing.assert_array_equal(entity.times, recorded_entities[path].times)
        assert repr(entity.rows) == repr(recorded_entities[path].rows)


@pytest.mark.parametrize("log_fraction", [0.3, 0.5, 0.73, 0.9])
def test_a_log_that_ends_early_is_shown_up_to_there(
    log_fraction: float, jamia_log_path: Path, tmp_path: Path
) -> None:
    truncated_log_path = tmp_path / "cut.mcap"
    truncated_log_path.write_bytes(
        jamia_log_path.read_bytes()[: int(log_fraction * jamia_log_path.stat().st_size)]
    )
    with RunLog(truncated_log_path) as truncated_log:
        shown_entities = read_entities(
            rerun_conversion.chunks_of_run(truncated_log_path, run_info_of(truncated_log_path))
        )
        np.testing.assert_array_equal(
            shown_entities["/controller/q"].table("Scalars:scalars"), truncated_log.field("q")
        )
        assert (
            len(shown_entities["/loop/late"].times)
            == len(shown_entities["/bus/load"].times)
            == len(truncated_log)
            > 20
        )


def test_a_cut_within_the_index_of_a_chunk_loses_no_message(
    jamia_log_path: Path, tmp_path: Path
) -> None:
    file, scan = LogFile(jamia_log_path), RecordScan()
    scan_records(file, scan)
    file.close()
    truncated_log_path = tmp_path / "cut.mcap"
    truncated_log_path.write_bytes(jamia_log_path.read_bytes()[: scan.chunks[5].end + 40])
    with RunLog(truncated_log_path) as truncated_log:
        shown_entities = read_entities(
            rerun_conversion.chunks_of_run(truncated_log_path, run_info_of(truncated_log_path))
        )
        assert (
            truncated_log.t_ns[-1]
            == shown_entities["/loop/late"].times[-1]
            == shown_entities["/bus/load"].times[-1]
        )


def test_a_log_whose_hand_is_no_hand_or_another_is_refused(jamia_log_path: Path) -> None:
    from dataclasses import replace

    header = run_info_of(jamia_log_path).header
    for text in ("[[", "schema = 1\n"):
        with pytest.raises(ConfigError, match=r"hand\.toml"):
            RunInfo.from_header(replace(header, hand_toml=text), "run")
    with pytest.raises(LogError, match="names differ"):
        RunInfo.from_header(replace(header, digits=("a", "b", "c", "d")), "run")
