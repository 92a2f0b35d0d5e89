"""Test the exports of tables and datasets.

Polars, Rerun and Rerun's reader of LeRobot datasets read the exported files.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars
import pytest
from rerun.chunk import RrdReader
from rerun.experimental import LeRobotReader

from handctl.cli.main import main
from handctl.core.tick_types import TELEMETRY_FIELDS, HandMode
from handctl.errors import ConfigError, LogError
from handctl.log.export.camera_video import histogram_statistics
from handctl.log.export.csv_and_candump import column_names, column_title, export_csv
from handctl.log.export.lerobot import export_lerobot
from handctl.log.export.parquet import export_parquet
from handctl.log.read.reader import RunLog
from handctl.view.rerun_conversion import write_rrd
from handctl.view.scene.run_info import RunInfo

GOLDEN_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-fault.mcap"


@pytest.fixture
def golden_log() -> Iterator[RunLog]:
    with RunLog(GOLDEN_LOG) as opened_log:
        yield opened_log


def telemetry_array(golden_log: RunLog) -> np.ndarray:
    return np.array([np.frombuffer(row, "<f8") for row in golden_log.packed_telemetry()])


def read_dataset_frames(path: Path) -> polars.DataFrame:
    return polars.read_parquet(path / "data" / "chunk-000" / "file-000.parquet")


@pytest.fixture
def exported_dataset(golden_log: RunLog, tmp_path: Path) -> Path:
    frames = export_lerobot([golden_log], tmp_path / "x.lerobot")
    assert frames == int((golden_log.mode == int(HandMode.ACTIVE)).sum())
    return tmp_path / "x.lerobot"


def test_polars_reads_the_table(golden_log: RunLog, tmp_path: Path) -> None:
    export_parquet(golden_log, tmp_path / "x.parquet")
    table = polars.read_parquet(tmp_path / "x.parquet")
    assert table["k"].to_list() == golden_log.k.tolist()
    assert table["mode"].to_list() == [HandMode(value).name for value in golden_log.mode.tolist()]
    np.testing.assert_array_equal(
        table.select(column_names(golden_log)).to_numpy(), telemetry_array(golden_log)
    )


def test_polars_reads_the_text(golden_log: RunLog, tmp_path: Path) -> None:
    export_csv(golden_log, tmp_path / "x.csv")
    table = polars.read_csv(tmp_path / "x.csv", infer_schema_length=None)
    assert table["t_ns"].to_list() == golden_log.t_ns.tolist()
    numbers = table.select(
        [polars.col(column_title(name)).cast(polars.Float64) for name in column_names(golden_log)]
    ).to_numpy()
    np.testing.assert_array_equal(numbers, telemetry_array(golden_log))


def test_the_dataset_has_the_values_of_the_log(golden_log: RunLog, exported_dataset: Path) -> None:
    dataset_info = json.loads((exported_dataset / "meta" / "info.json").read_text())
    file_indices = {"chunk_index": 0, "file_index": 0}
    table = polars.read_parquet(exported_dataset / dataset_info["data_path"].format(**file_indices))
    active = golden_log.mode == int(HandMode.ACTIVE)
    state = np.hstack([golden_log.field("q")[active], golden_log.field("tension")[active]]).astype(
        np.float32
    )
    np.testing.assert_array_equal(table["observation.state"].to_numpy(), state)
    goal, q = golden_log.field("q_goal")[active], golden_log.field("q")[active]
    commands = np.hstack(
        [np.where(np.isnan(goal), q, goal), golden_log.field("tension_goal")[active]]
    ).astype(np.float32)
    np.testing.assert_array_equal(table["action"].to_numpy(), commands)
    times = (golden_log.t_ns[active] - golden_log.t_ns[active][0]) * 1e-9
    np.testing.assert_allclose(table["timestamp"].to_numpy(), times, atol=1e-6)
    assert table["frame_index"].to_list() == table["index"].to_list() == list(range(len(table)))
    assert table["next.done"].to_list() == [False] * (len(table) - 1) + [True]
    assert (dataset_info["fps"], dataset_info["total_frames"], dataset_info["robot_type"]) == (
        200,
        len(table),
        "jamia",
    )


def test_every_feature_is_declared_as_it_is(exported_dataset: Path) -> None:
    dataset_info = json.loads((exported_dataset / "meta" / "info.json").read_text())
    statistics = json.loads((exported_dataset / "meta" / "stats.json").read_text())
    table = polars.read_parquet(
        exported_dataset / dataset_info["data_path"].format(chunk_index=0, file_index=0)
    )
    assert set(dataset_info["features"]) == set(table.columns) == set(statistics)
    for name, feature in dataset_info["features"].items():
        (size,) = feature["shape"]
        assert np.asarray(table[name].to_numpy()).reshape(len(table), -1).shape[1] == size, name
        assert str(np.asarray(table[name].to_numpy()).dtype) == feature["dtype"], name
        assert {len(values) for key, values in statistics[name].items() if key != "count"} == {size}
        assert feature["names"] is None or len(feature["names"]) == size
    state = statistics["observation.state"]
    np.testing.assert_allclose(
        state["mean"], table["observation.state"].to_numpy().mean(axis=0), rtol=1e-4, atol=1e-5
    )
    assert all(
        a <= b <= c for a, b, c in zip(state["min"], state["q50"], state["max"], strict=True)
    )
    (episode,) = polars.read_parquet(
        exported_dataset / "meta/episodes/chunk-000/file-000.parquet"
    ).to_dicts()
    assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (0, len(table))
    assert (
        polars.read_parquet(exported_dataset / "meta/tasks.parquet")["task"].to_list()
        == episode["tasks"]
    )


def test_the_episode_has_its_statistics(exported_dataset: Path) -> None:
    """When LeRobot splits a dataset, it computes the statistics of a part from those of the episodes in this part."""
    whole_content = json.loads((exported_dataset / "meta" / "stats.json").read_text())
    table = polars.read_parquet(exported_dataset / "meta/episodes/chunk-000/file-000.parquet")
    names = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
    features = json.loads((exported_dataset / "meta" / "info.json").read_text())["features"]
    expected = {f"stats/{feature}/{name}" for feature in features for name in names}
    assert {column for column in table.columns if column.startswith("stats/")} == expected
    for column in expected:
        _, feature, name = column.split("/")
        (values,) = table[column].to_list()
        assert values == whole_content[feature][name], column
        assert len(values) == (1 if name == "count" else features[feature]["shape"][0])
        assert table[column].dtype == polars.List(
            polars.Int64 if name == "count" else polars.Float64
        )


def test_several_logs_become_episodes_of_one_dataset(
    golden_log: RunLog, exported_dataset: Path, tmp_path: Path
) -> None:
    with RunLog(GOLDEN_LOG.parent / "jamia-grasp.mcap") as other_log:
        frames = export_lerobot([other_log, golden_log, other_log], tmp_path / "y")
    table = polars.read_parquet(tmp_path / "y" / "data" / "chunk-000" / "file-000.parquet")
    episodes = polars.read_parquet(
        tmp_path / "y" / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    ).to_dicts()
    dataset_info = json.loads((tmp_path / "y" / "meta" / "info.json").read_text())
    tasks = polars.read_parquet(tmp_path / "y" / "meta" / "tasks.parquet").to_dicts()
    assert (
        dataset_info["total_episodes"],
        dataset_info["total_frames"],
        dataset_info["splits"],
    ) == (
        3,
        frames,
        {"train": "0:3"},
    )
    assert table["index"].to_list() == list(range(frames))
    assert (
        len(tasks)
        == dataset_info["total_tasks"]
        == len({episode["tasks"][0] for episode in episodes})
    )
    single_log_table = polars.read_parquet(
        exported_dataset / "data" / "chunk-000" / "file-000.parquet"
    )
    for episode in episodes:
        episode_rows = table[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert set(episode_rows["episode_index"]) == {episode["episode_index"]}
        assert episode_rows["frame_index"].to_list() == list(range(episode["length"]))
        assert {tasks[i]["task"] for i in episode_rows["task_index"]} == set(episode["tasks"])
        assert episode["stats/action/mean"] == pytest.approx(
            episode_rows["action"].to_numpy().mean(axis=0), abs=1e-4
        )
    second_episode_rows = table.filter(polars.col("episode_index") == 1)
    for name in ("observation.state", "action", "timestamp", "next.done"):
        assert second_episode_rows[name].to_list() == single_log_table[name].to_list()


def test_a_log_of_another_hand_is_no_episode(golden_log: RunLog, tmp_path: Path) -> None:
    with (
        RunLog(GOLDEN_LOG.parent / "jamia11-grasp.mcap") as other_log,
        pytest.raises(
            LogError, match="log 2: a run of hand jamia11; expected a run of hand jamia, as in"
        ),
    ):
        export_lerobot([golden_log, other_log], tmp_path / "y")
    assert not (tmp_path / "y").exists()


def test_only_a_dataset_takes_several_logs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "log",
                "export",
                str(GOLDEN_LOG),
                str(GOLDEN_LOG),
                "--csv",
                "--output",
                str(tmp_path / "x"),
            ]
        )
        == 2
    )
    assert "a second log" in capsys.readouterr().err
    assert (
        main(
            [
                "log",
                "export",
                str(GOLDEN_LOG),
                str(GOLDEN_LOG),
                "--lerobot",
                "--output",
                str(tmp_path / "x"),
            ]
        )
        == 0
    )
    assert json.loads((tmp_path / "x" / "meta" / "info.json").read_text())["total_episodes"] == 2


def test_a_lower_frame_rate_takes_the_latest_tick(
    golden_log: RunLog, exported_dataset: Path, tmp_path: Path
) -> None:
    frames = export_lerobot([golden_log], tmp_path / "slow", fps=40)
    all_frames, slow_frames = [
        read_dataset_frames(path) for path in (exported_dataset, tmp_path / "slow")
    ]
    assert len(slow_frames) == frames == (len(all_frames) - 1) // 5 + 1
    assert slow_frames["action"].to_list() == all_frames["action"].to_list()[::5]
    assert slow_frames["timestamp"].to_list() == pytest.approx([i / 40 for i in range(frames)])
    for fps in (0, 201):
        with pytest.raises(ConfigError, match=f"--fps: {fps} Hz; expected 1 to 200 Hz"):
            export_lerobot([golden_log], tmp_path / "wrong", fps=fps)
    assert not (tmp_path / "wrong").exists()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--csv --fps 20", "log export --csv: frame rate or camera; expected --lerobot"),
        (
            "--csv --camera wrist one.mp4",
            "log export --csv: frame rate or camera; expected --lerobot",
        ),
        # Reproduce a defect: the export accepted the option for the time of a camera, but the
        # option had no effect.
        ("--csv --camera-start 3", "log export --csv: frame rate or camera; expected --lerobot"),
        (
            "--lerobot --camera wrist",
            "--camera wrist: 0 videos for 1 logs; expected one video for each log",
        ),
        (
            "--lerobot --camera wrist one.mp4 two.mp4",
            "--camera wrist: 2 videos for 1 logs; expected one video",
        ),
        ("--lerobot --camera wrist no.mp4", "no.mp4: no such file; expected a video"),
        (
            "--lerobot --camera ../x one.mp4",
            "--camera: '../x'; expected a name of letters and digits",
        ),
        (
            "--lerobot --camera a one.mp4 --camera a one.mp4",
            "--camera: 'a'; expected a name of letters and digits",
        ),
        (
            "--lerobot --camera-start 1 2",
            "--camera-start: 2 times; expected one, or 1 finite times [s]",
        ),
        (
            "--lerobot --camera-start nan",
            "--camera-start: 1 times; expected one, or 1 finite times [s]",
        ),
        (
            "--lerobot --camera wrist one.mp4",
            "--camera: no program ffmpeg; expected ffmpeg installed",
        ),
    ],
)
def test_a_wrong_camera_is_one_line(
    words: str,
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "")
    (tmp_path / "one.mp4").touch()
    (tmp_path / "two.mp4").touch()
    assert main(["log", "export", str(GOLDEN_LOG), *words.split(), "--output", "out"]) == 2
    assert f"handctl: {line}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_statistics_of_images_are_those_of_their_pixels() -> None:
    pixels = np.random.default_rng(0).integers(0, 200, (3, 5000))
    histogram = np.array([np.bincount(channel, minlength=256) for channel in pixels])
    image_statistics = histogram_statistics(histogram, 7, (10, 50, 99))
    expected = {name: getattr(pixels / 255, name)(axis=1) for name in ("min", "max", "mean", "std")}
    expected |= {
        f"q{percent}": np.percentile(pixels / 255, percent, axis=1) for percent in (10, 50, 99)
    }
    assert image_statistics.pop("count") == [7]
    assert image_statistics.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(
            np.array(image_statistics[name]),
            values.reshape(3, 1, 1),
            atol=1 / 255 + 1e-12,
            err_msg=name,
        )


def test_names_of_elements_have_their_unit(exported_dataset: Path) -> None:
    features = json.loads((exported_dataset / "meta" / "info.json").read_text())["features"]
    units = {
        "observation.state": {"pos_rad", "tension_N"},
        "observation.sigma": {"pos_sigma_rad", "tension_sigma_N"},
        "observation.tip_force": {"force_N"},
    }
    for name, feature in features.items():
        if feature["names"]:
            expected = units.get(name, units["observation.state"])
            assert {inner.partition(".")[2] for inner in feature["names"]} == expected, name


def test_rerun_reads_the_dataset(golden_log: RunLog, exported_dataset: Path) -> None:
    reader = LeRobotReader(exported_dataset)
    assert reader.episodes() == [0]
    chunks = {str(chunk.entity_path): chunk for chunk in reader.stream(0).to_chunks()}
    batch = chunks["/observation.state"].to_record_batch()
    values = np.array(batch.column("Scalars:scalars").to_pylist())
    active = golden_log.mode == int(HandMode.ACTIVE)
    np.testing.assert_array_equal(
        values[:, : len(golden_log.header.joints)], golden_log.field("q")[active].astype(np.float32)
    )
    assert batch.column("frame_index").to_pylist() == list(range(len(values)))


def test_rerun_reads_the_recording(golden_log: RunLog, tmp_path: Path) -> None:
    write_rrd(GOLDEN_LOG, RunInfo.from_header(golden_log.header, "x"), tmp_path / "x.rrd")
    lines: dict[str, list[tuple[int, list[float]]]] = {}
    for chunk in RrdReader(tmp_path / "x.rrd").stream().to_chunks():
        field = str(chunk.entity_path).removeprefix("/controller/")
        if field in TELEMETRY_FIELDS and "run_time" in chunk.timeline_names:
            batch = chunk.to_record_batch()
            times = batch.column("run_time").to_pylist()
            values = next(
                c
                for f, c in zip(batch.schema, batch.columns, strict=True)
                if f.name.endswith("scalars")
            )
            lines.setdefault(field, []).extend(zip(times, values.to_pylist(), strict=True))
    assert set(lines) == set(TELEMETRY_FIELDS)
    for field, rows in lines.items():
        rows.sort(key=lambda row: row[0])
        np.testing.assert_array_equal(
            np.array([values for _, values in rows]), golden_log.field(field), err_msg=field
        )


def test_a_folder_that_is_there_is_left_alone(golden_log: RunLog, tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    with pytest.raises(FileExistsError, match="x"):
        export_lerobot([golden_log], tmp_path / "x")
    assert list((tmp_path / "x").iterdir()) == []
