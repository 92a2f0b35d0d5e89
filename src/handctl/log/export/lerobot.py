"""Export of logs to a LeRobot dataset.

Each log becomes one episode of the dataset. An episode is the part of a run in which the hand was
active, sampled at equal intervals of time. The files have the layout of LeRobot's codebase version
3.0. One file contains the frames of all episodes. Each episode has one video for each camera. The
feature `observation.state` contains joint angles [rad], positions of prismatic joints [m] and
estimated tensions [N]. The feature `action` contains commanded joint angles and tensions. While a
digit holds a tension, its joints have no commanded angle. In this case, `action` contains the
estimated angles of these joints.

The name of each vector element ends in a unit, for example `index_j1.pos_rad` or
`index_tendon.tension_N`.

The file `meta/stats.json` contains the statistics of the whole dataset. Columns of `meta/episodes`
contain the statistics of each episode. LeRobot needs the statistics of each episode to split a
dataset or to delete episodes.

Source of the file paths and of the names of the fields: LeRobot 0.4 and 0.6, `datasets/utils.py`
and `dataset_metadata.py`.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray

from handctl.core.tick_types import HandMode
from handctl.errors import ConfigError, LogError
from handctl.hand.hand_loading import parse_toml
from handctl.log.export.camera_video import (
    VIDEO_PATH_PATTERN,
    DatasetCamera,
    EpisodeVideo,
    histogram_statistics,
    video_file_numbers,
    write_episode_video,
)
from handctl.log.export.element_names import position_names
from handctl.log.read.hand_in_log import prismatic_joints
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import check_tick_times
from handctl.printing import printable_text

DATA_PATH_PATTERN = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH_PATTERN = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
STATISTICS_PERCENTILES = (1, 10, 50, 90, 99)
"""Percentiles in the statistics of a feature."""

STANDARD_DEVIATION_FIELDS = ("q_sigma", "tension_sigma")
"""Telemetry fields with the standard deviations of the values in `observation.state`.

Logs of version 0.1 lack `q_sigma`.
"""

Array = NDArray[np.float64]
FeatureStatistics = dict[str, dict[str, list[Any]]]
"""Values of each statistic of each feature.

The first key is the name of the feature, and the second key is the name of the statistic.
"""


class _Episode(NamedTuple):
    """Frames that are computed from one log and form one episode of a dataset.

    Attributes:
        vector_features: names and values (frames, n) of each vector feature.
        task: description of the task that the log shows.
        frames: number of frames of the episode.
        start_s: time from the start of the run to the first frame [s].
    """

    vector_features: dict[str, tuple[list[str], Array]]
    task: str
    frames: int
    start_s: float

    @property
    def element_names(self) -> dict[str, list[str]]:
        """Return the names of the elements of each vector feature."""
        return {name: names for name, (names, _) in self.vector_features.items()}


def export_lerobot(
    logs: Sequence[RunLog], path: Path, fps: int | None = None, cameras: Sequence[DatasetCamera] = ()
) -> int:  # fmt: skip
    """Write logs as a dataset into a new folder, and return the number of frames.

    Args:
        logs: one or more logs of one hand at one control rate.
        path: folder of the dataset, which must not exist yet.
        fps: frame rate of the dataset, at most the control rate [Hz]. If ``fps`` is None, the
            control rate is used.
        cameras: cameras, each with a video for each log.

    Raises:
        ConfigError: the frame rate is out of range.
        LogError: the hand was never active in some log, the logs have different hands or control
            rates, or a video does not cover a whole episode.
        OSError: the folder already exists or cannot be written.
    """
    first_log = logs[0]
    control_rate = round(1e9 / first_log.header.period_ns)
    fps = control_rate if fps is None else fps
    if not 1 <= fps <= control_rate:
        raise ConfigError(
            f"{fps} Hz", "--fps", f"1 to {control_rate} Hz, the control rate of the log"
        )
    episodes = [_episode_of_log(log, fps) for log in logs]
    for i, (log, episode) in enumerate(zip(logs, episodes, strict=True)):
        _check_same_hand_and_rate(
            first_log, log, episodes[0].element_names == episode.element_names, f"log {i + 1}"
        )
    tasks = list(dict.fromkeys(episode.task for episode in episodes))
    scalar_features = [_scalar_features(episodes, i, tasks, fps) for i in range(len(episodes))]
    tables_of_logs = [
        {name: values for name, (_, values) in episode.vector_features.items()} | scalar_features[i]
        for i, episode in enumerate(episodes)
    ]
    joined_columns = {
        name: np.concatenate([log_tables[name] for log_tables in tables_of_logs])
        for name in tables_of_logs[0]
    }
    path.mkdir()
    videos_by_camera = {
        camera.feature_key: _write_videos(camera, episodes, path, fps) for camera in cameras
    }
    _write_parquet(
        path / DATA_PATH_PATTERN.format(chunk_index=0, file_index=0),
        _frame_table(episodes[0].element_names, joined_columns),
    )
    statistics = [
        {name: _feature_statistics(table) for name, table in log_tables.items()}
        for log_tables in tables_of_logs
    ]
    for number, statistic in enumerate(statistics):
        statistic |= {
            key: _video_statistics(files[number : number + 1])
            for key, files in videos_by_camera.items()
        }
    table = _episode_table(episodes, statistics, videos_by_camera.keys(), fps)
    _write_parquet(path / EPISODES_PATH_PATTERN.format(chunk_index=0, file_index=0), table)
    _write_parquet(path / "meta" / "tasks.parquet", _task_table(tasks))
    info_content = _info_content(first_log, fps, episodes, len(tasks), scalar_features[0])
    info_content["features"] |= {
        key: _video_feature(files, fps) for key, files in videos_by_camera.items()
    }
    info_content["video_path"] = VIDEO_PATH_PATTERN if videos_by_camera else None
    _write_json(path / "meta" / "info.json", info_content)
    video_statistics = {key: _video_statistics(files) for key, files in videos_by_camera.items()}
    _write_json(
        path / "meta" / "stats.json",
        {name: _feature_statistics(table) for name, table in joined_columns.items()}
        | video_statistics,
    )
    return sum(episode.frames for episode in episodes)


def _episode_of_log(log: RunLog, fps: int) -> _Episode:
    """Convert a log to an episode."""
    rows = _tick_indices(log, fps)
    return _Episode(
        _vector_features(log, rows),
        _task_description(log),
        len(rows),
        float(log.t_ns[rows[0]]) / 1e9,
    )


def _write_videos(
    camera: DatasetCamera, episodes: Sequence[_Episode], path: Path, fps: int
) -> list[EpisodeVideo]:
    """Write the videos of a camera, one for each episode.

    Raises:
        LogError: a video does not cover the whole episode, or the width and height of its images
            differ from those of the first video.
    """
    episode_videos = list[EpisodeVideo]()
    for number, episode in enumerate(episodes):
        target = path / VIDEO_PATH_PATTERN.format(
            video_key=camera.feature_key, **video_file_numbers(number)
        )
        episode_start_s = episode.start_s - camera.start_times_s[number]
        episode_videos.append(
            write_episode_video(
                camera.video_paths[number], target, episode_start_s, episode.frames, fps
            )
        )
        sizes = [
            f"{video.width} x {video.height}" for video in (episode_videos[0], episode_videos[-1])
        ]
        if sizes[0] != sizes[1]:
            expected = f"{sizes[0]}, as in the first video"
            raise LogError(
                f"a video of {sizes[1]} pixels", str(camera.video_paths[number]), expected
            )
    return episode_videos


def _video_statistics(episode_videos: Sequence[EpisodeVideo]) -> dict[str, list[Any]]:
    """Return the statistics over all images of the given videos."""
    histogram = np.sum([video.histogram for video in episode_videos], axis=0)
    return histogram_statistics(
        histogram, sum(video.frames for video in episode_videos), STATISTICS_PERCENTILES
    )


def _video_feature(episode_videos: Sequence[EpisodeVideo], fps: int) -> dict[str, Any]:
    """Return the entry of `meta/info.json` that declares the images of a camera."""
    height, width = episode_videos[0].height, episode_videos[0].width
    encoding = {
        "codec": "h264",
        "pix_fmt": "yuv420p",
        "is_depth_map": False,
        "fps": fps,
        "channels": 3,
    }
    encoding |= {"height": height, "width": width}
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {f"video.{name}": value for name, value in encoding.items()} | {"has_audio": False},
    }


def _check_same_hand_and_rate(
    first_log: RunLog, log: RunLog, has_same_names: bool, log_name: str
) -> None:
    """Check that a log has the same hand and the same control rate as the first log of the dataset.

    Raises:
        LogError: the log belongs to another hand or has another control rate.
    """
    hands = [
        printable_text(str(run_log.header.metadata.get("hand"))) for run_log in (first_log, log)
    ]
    if hands[0] != hands[1] or not has_same_names:
        raise LogError(
            f"a run of hand {hands[1]}", log_name, f"a run of hand {hands[0]}, as in the first log"
        )
    if first_log.header.period_ns != log.header.period_ns:
        rates = [1e9 / run_log.header.period_ns for run_log in (first_log, log)]
        raise LogError(
            f"a run at {rates[1]:g} Hz", log_name, f"a run at {rates[0]:g} Hz, as in the first log"
        )


def _tick_indices(log: RunLog, fps: int) -> NDArray[np.intp]:
    """Return, for each frame of the dataset, the index of the tick from which the frame takes its values.

    A frame takes the values of the last tick at or before the time of the frame, even if ticks are
    missing in the log.

    Raises:
        LogError: the hand was never active, or the ticks are out of order.
    """
    active = np.flatnonzero(log.mode == int(HandMode.ACTIVE))
    if len(active) < 2:
        raise LogError("the hand was never active in this log", "the log", "a run that moved")
    check_tick_times(log.t_ns, log.header.period_ns)
    start = int(log.t_ns[active[0]])
    end = int(log.t_ns[active[-1]])
    frames = (end - start) * fps // 10**9 + 1
    # The times of the frames are integers, rounded to the nearest nanosecond. With integers, the
    # times of the frames stay exact over hours.
    grid = start + (np.arange(frames) * 10**9 + fps // 2) // fps
    return np.asarray(np.searchsorted(log.t_ns, grid, "right") - 1, np.intp)


def _vector_features(log: RunLog, rows: NDArray[np.intp]) -> dict[str, tuple[list[str], Array]]:
    """Return the element names and the values (frames, n) of each vector feature."""
    header = log.header
    q = _fill_missing_values(log, "q", rows)
    tension = _fill_missing_values(log, "tension", rows)
    angle_commands = log.field("q_goal")[rows]
    tension_commands = log.field("tension_goal")[rows]
    names = list(position_names(header.joints, prismatic_joints(header)))
    names += [f"{tendon}.tension_N" for tendon in header.tendons]
    commands = np.hstack(
        [
            np.where(np.isnan(angle_commands), q, angle_commands),
            np.where(np.isnan(tension_commands), tension, tension_commands),
        ]
    )
    vector_features = {
        "observation.state": (names, np.hstack([q, tension])),
        "observation.tip_force": (
            [f"{digit}.force_N" for digit in header.digits],
            _fill_missing_values(log, "tip_force", rows),
        ),
        "action": (names, commands),
    }
    if STANDARD_DEVIATION_FIELDS[0] in log.fields:
        sigma = np.hstack(
            [_fill_missing_values(log, name, rows) for name in STANDARD_DEVIATION_FIELDS]
        )
        vector_features["observation.sigma"] = (
            [_standard_deviation_name(name) for name in names],
            sigma,
        )
    return vector_features


def _standard_deviation_name(name: str) -> str:
    """Return the name of the standard deviation of an element: `index_j1.pos_sigma_rad` for `index_j1.pos_rad`."""
    quantity, unit = name.rsplit("_", 1)
    return f"{quantity}_sigma_{unit}"


def _fill_missing_values(log: RunLog, name: str, rows: NDArray[np.intp]) -> Array:
    """Return a telemetry field (frames, n) with a number in place of each NaN.

    The last number above a NaN in the same column replaces the NaN. If there is no number above the
    NaN, the first number below the NaN replaces it. A column without any number becomes zero.
    """
    values = log.field(name)[rows]
    for column in values.T:
        finite_rows = np.flatnonzero(~np.isnan(column))
        if len(finite_rows):
            column[:] = column[
                finite_rows[
                    np.maximum(np.searchsorted(finite_rows, np.arange(len(column)), "right") - 1, 0)
                ]
            ]
    return np.nan_to_num(values)


def _scalar_features(
    episodes: Sequence[_Episode], episode_index: int, tasks: list[str], fps: int
) -> dict[str, NDArray[Any]]:
    """Return the scalar features that LeRobot requires in every frame of an episode."""
    frames_before = sum(episode.frames for episode in episodes[:episode_index])
    frames = episodes[episode_index].frames
    frame_indices = np.arange(frames)
    return {
        "timestamp": (frame_indices / fps).astype(np.float32),
        "frame_index": frame_indices,
        "episode_index": np.full(frames, episode_index, np.int64),
        "index": frames_before + frame_indices,
        "task_index": np.full(frames, tasks.index(episodes[episode_index].task), np.int64),
        "next.done": frame_indices == frames - 1,
    }


def _task_description(log: RunLog) -> str:
    """Return the description of the task that the recorded run carried out."""
    try:
        task = parse_toml(
            log.header.attachments.get("task.toml", b"").decode(), "task.toml in the log"
        )
    except (ConfigError, UnicodeDecodeError):
        task = {}
    default_description = f"run of hand {log.header.metadata.get('hand', '?')}"
    return printable_text(str(task.get("description") or task.get("name") or default_description))


def _frame_table(names: dict[str, list[str]], values: dict[str, NDArray[Any]]) -> pa.Table:
    """Return the table with one row per sampled frame. A feature in `names` is a vector, any other feature a scalar."""
    columns = {}
    for name, table in values.items():
        flat_values = pa.array(
            np.ascontiguousarray(table, np.float32 if name in names else None).ravel()
        )
        width = len(names.get(name, ()))
        columns[name] = (
            pa.FixedSizeListArray.from_arrays(flat_values, width) if width > 1 else flat_values
        )
    return pa.table(columns)


def _episode_table(
    episodes: Sequence[_Episode], statistics: Sequence[FeatureStatistics], video_keys: Iterable[str], fps: int
) -> pa.Table:  # fmt: skip
    """Return the table with all episodes of the dataset.

    The table says where the frames of each episode are, and has a column `stats/FEATURE/NAME` for
    each statistic.
    """
    count = len(episodes)
    end_indices = np.cumsum([episode.frames for episode in episodes]).tolist()
    fields: dict[str, list[Any]] = {
        "episode_index": list(range(count)),
        "tasks": [[episode.task] for episode in episodes],
        "length": [episode.frames for episode in episodes],
        "dataset_from_index": [0, *end_indices[:-1]],
        "dataset_to_index": end_indices,
    }
    columns: dict[str, list[Any]] = {
        f"stats/{feature}/{name}": [statistic[feature][name] for statistic in statistics]
        for feature, values_of in statistics[0].items()
        for name in values_of
    }
    files = [
        f"{table}/{number}"
        for table in ("data", "meta/episodes")
        for number in ("chunk_index", "file_index")
    ]
    rows = fields | columns | {name: [0] * count for name in files}
    for key in video_keys:
        video_file_places = [video_file_numbers(number) for number in range(count)]
        rows |= {
            f"videos/{key}/{name}": [file_place[name] for file_place in video_file_places]
            for name in video_file_places[0]
        }
        rows[f"videos/{key}/from_timestamp"] = [0.0] * count
        rows[f"videos/{key}/to_timestamp"] = [episode.frames / fps for episode in episodes]
    return pa.table(rows)


def _task_table(tasks: list[str]) -> pa.Table:
    """Return the table with the descriptions of all tasks.

    The column with the descriptions is the index of the table. Metadata in the schema of the table
    tell pandas to use the column with the descriptions as the index.
    """
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": tasks})
    columns = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": pandas_type,
            "numpy_type": numpy,
            "metadata": None,
        }
        for name, pandas_type, numpy in (
            ("task_index", "int64", "int64"),
            ("task", "unicode", "object"),
        )
    ]
    metadata = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": columns,
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({b"pandas": json.dumps(metadata).encode()})


def _info_content(
    log: RunLog,
    fps: int,
    episodes: Sequence[_Episode],
    task_count: int,
    scalar_features: dict[str, NDArray[Any]],
) -> dict[str, Any]:
    """Return the content of `meta/info.json`."""
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(names)], "names": names}
        for name, names in episodes[0].element_names.items()
    }
    features |= {
        name: {"dtype": str(values.dtype), "shape": [1], "names": None}
        for name, values in scalar_features.items()
    }
    return {
        "codebase_version": "v3.0",
        "robot_type": log.header.metadata.get("hand"),
        "total_episodes": len(episodes),
        "total_frames": sum(episode.frames for episode in episodes),
        "total_tasks": task_count,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": DATA_PATH_PATTERN,
        "video_path": None,
        "features": features,
    }


def _feature_statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Return the statistics of a dataset feature, computed over all given frames.

    LeRobot normalises a feature with the statistics that this function returns.
    """
    table = np.asarray(values, np.float64).reshape(len(values), -1)
    statistics = {
        "min": table.min(axis=0),
        "max": table.max(axis=0),
        "mean": table.mean(axis=0),
        "std": table.std(axis=0),
    }
    statistics |= {
        f"q{percent:02d}": np.percentile(table, percent, axis=0)
        for percent in STATISTICS_PERCENTILES
    }
    return {name: array.tolist() for name, array in statistics.items()} | {"count": [len(table)]}


def _write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table as a Parquet file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    """Write content as a JSON file."""
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
