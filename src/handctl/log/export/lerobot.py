"""Export of a log as a LeRobot dataset of one episode: the active part of the run, on an exact time grid.

Layout: codebase version 3.0, without video. `observation.state` holds joint angles [rad] and
estimated tensions [N]. `action` holds commanded joint angles and tensions. For a digit under
tension control, the commanded angle is set to the estimated angle.

Names of vector elements end in their unit: `index_j1.pos_rad`, `index_tendon.tension_N`.

Statistics of the whole dataset are in `meta/stats.json`, those of each episode in columns of
`meta/episodes`. LeRobot uses the statistics per episode when splitting a dataset or deleting
episodes.

Source: LeRobot 0.4 and 0.6, `datasets/utils.py` and `dataset_metadata.py`: paths and fields.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray

from handctl.core.types import Mode
from handctl.errors import ConfigError, LogError
from handctl.hand.load import parse_toml
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import check_order
from handctl.printing import printable

DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
QUANTILES = (1, 10, 50, 90, 99)
"""Percentiles in the statistics."""

SIGMA = ("q_sigma", "tension_sigma")
"""Telemetry fields with the standard deviations of `observation.state`.

Logs of version 0.1 lack `q_sigma`.
"""

Array = NDArray[np.float64]
Statistics = dict[str, dict[str, list[float]]]
"""Values of each statistic, by feature and by name of the statistic."""


def export_lerobot(log: RunLog, path: Path) -> int:
    """Write the dataset into a new folder, and return the number of frames.

    Raises:
        LogError: the hand was never active.
        OSError: the folder exists already or cannot be written.
    """
    fps = round(1e9 / log.header.period_ns)
    rows = _rows(log, fps)
    vectors = _vectors(log, rows)
    scalars = _scalars(len(rows), fps)
    task = _task(log)
    path.mkdir()
    _write(path / DATA.format(chunk_index=0, file_index=0), _frames(vectors, scalars))
    values = {name: table for name, (_, table) in vectors.items()} | scalars
    statistics = {name: _statistics(table) for name, table in values.items()}
    _write(path / EPISODES.format(chunk_index=0, file_index=0), _episodes(len(rows), task, statistics))
    _write(path / "meta" / "tasks.parquet", _tasks(task))
    named = {name: names for name, (names, _) in vectors.items()}
    _json(path / "meta" / "info.json", _info(log, fps, len(rows), named, scalars))
    _json(path / "meta" / "stats.json", statistics)
    return len(rows)


def _rows(log: RunLog, fps: int) -> NDArray[np.intp]:
    """Return the index of the tick for each frame of the time grid.

    Each frame gets the latest tick before the frame's time, also where ticks are missing.

    Raises:
        LogError: the hand was never active, or the ticks are out of order.
    """
    active = np.flatnonzero(log.mode == int(Mode.ACTIVE))
    if len(active) < 2:
        raise LogError("the hand was never active in it", "the log", "a run that moved")
    check_order(log.t_ns, log.header.period_ns)
    start = int(log.t_ns[active[0]])
    end = int(log.t_ns[active[-1]])
    frames = (end - start) * fps // 10**9 + 1
    # Integer arithmetic with rounding to the nearest nanosecond keeps the grid exact over hours.
    grid = start + (np.arange(frames) * 10**9 + fps // 2) // fps
    return np.asarray(np.searchsorted(log.t_ns, grid, "right") - 1, np.intp)


def _vectors(log: RunLog, rows: NDArray[np.intp]) -> dict[str, tuple[list[str], Array]]:
    """Return names and values (frames, n) of each vector-valued feature."""
    header = log.header
    q = _without_nan(log, "q", rows)
    tension = _without_nan(log, "tension", rows)
    angle_commands = log.field("q_goal")[rows]
    tension_commands = log.field("tension_goal")[rows]
    names = [f"{joint}.pos_rad" for joint in header.joints]
    names += [f"{tendon}.tension_N" for tendon in header.tendons]
    commands = np.hstack(
        [
            np.where(np.isnan(angle_commands), q, angle_commands),
            np.where(np.isnan(tension_commands), tension, tension_commands),
        ]
    )
    vectors = {
        "observation.state": (names, np.hstack([q, tension])),
        "observation.tip_force": (
            [f"{digit}.force_N" for digit in header.digits],
            _without_nan(log, "tip_force", rows),
        ),
        "action": (names, commands),
    }
    if SIGMA[0] in log.fields:
        sigma = np.hstack([_without_nan(log, name, rows) for name in SIGMA])
        vectors["observation.sigma"] = ([_sigma_name(name) for name in names], sigma)
    return vectors


def _sigma_name(name: str) -> str:
    """Return the name of an element's standard deviation, `index_j1.pos_sigma_rad` for `index_j1.pos_rad`."""
    quantity, unit = name.rsplit("_", 1)
    return f"{quantity}_sigma_{unit}"


def _without_nan(log: RunLog, name: str, rows: NDArray[np.intp]) -> Array:
    """Return a telemetry field (frames, n) with every NaN replaced.

    A NaN is replaced by the last value before, or else by the first value after. A column of NaN
    only becomes zero.
    """
    values = log.field(name)[rows]
    for column in values.T:
        finite = np.flatnonzero(~np.isnan(column))
        if len(finite):
            column[:] = column[finite[np.maximum(np.searchsorted(finite, np.arange(len(column)), "right") - 1, 0)]]
    return np.nan_to_num(values)


def _scalars(frames: int, fps: int) -> dict[str, NDArray[Any]]:
    """Return the scalar features that LeRobot requires in every frame."""
    index = np.arange(frames)
    none = np.zeros(frames, np.int64)
    return {
        "timestamp": (index / fps).astype(np.float32),
        "frame_index": index,
        "episode_index": none,
        "index": index,
        "task_index": none,
        "next.done": index == frames - 1,
    }


def _task(log: RunLog) -> str:
    """Return the description of the task as text."""
    try:
        task = parse_toml(log.header.attachments.get("task.toml", b"").decode(), "task.toml in the log")
    except (ConfigError, UnicodeDecodeError):
        task = {}
    otherwise = f"run of hand {log.header.metadata.get('hand', '?')}"
    return printable(str(task.get("description") or task.get("name") or otherwise))


def _frames(vectors: dict[str, tuple[list[str], Array]], scalars: dict[str, NDArray[Any]]) -> pa.Table:
    """Return the table of the frames."""
    columns = {}
    for name, (names, table) in vectors.items():
        flat = pa.array(np.ascontiguousarray(table, np.float32).ravel())
        columns[name] = flat if len(names) == 1 else pa.FixedSizeListArray.from_arrays(flat, len(names))
    return pa.table(columns | {name: pa.array(values) for name, values in scalars.items()})


def _episodes(frames: int, task: str, statistics: Statistics) -> pa.Table:
    """Return the table with the episode: position of the frames, and a column `stats/FEATURE/NAME` per statistic."""
    positions = {
        f"{table}/{number}": [0] for table in ("data", "meta/episodes") for number in ("chunk_index", "file_index")
    }
    fields = {"episode_index": [0], "tasks": [[task]], "length": [frames]}
    columns = {
        f"stats/{feature}/{name}": [values]
        for feature, values_of in statistics.items()
        for name, values in values_of.items()
    }
    return pa.table(fields | {"dataset_from_index": [0], "dataset_to_index": [frames]} | columns | positions)


def _tasks(task: str) -> pa.Table:
    """Return the table with the task.

    The text is the index of the table. pandas reads this from the schema's metadata.
    """
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
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


def _info(
    log: RunLog,
    fps: int,
    frames: int,
    names: dict[str, list[str]],
    scalars: dict[str, NDArray[Any]],
) -> dict[str, Any]:
    """Return the content of `meta/info.json`."""
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(inner)], "names": inner} for name, inner in names.items()
    }
    features |= {name: {"dtype": str(values.dtype), "shape": [1], "names": None} for name, values in scalars.items()}
    return {
        "codebase_version": "v3.0",
        "robot_type": log.header.metadata.get("hand"),
        "total_episodes": 1,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": "0:1"},
        "data_path": DATA,
        "video_path": None,
        "features": features,
    }


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    """Return the statistics of a feature over all frames, for normalisation."""
    table = np.asarray(values, np.float64).reshape(len(values), -1)
    statistics = {
        "min": table.min(axis=0),
        "max": table.max(axis=0),
        "mean": table.mean(axis=0),
        "std": table.std(axis=0),
    }
    statistics |= {f"q{percent:02d}": np.percentile(table, percent, axis=0) for percent in QUANTILES}
    return {name: array.tolist() for name, array in statistics.items()} | {"count": [len(table)]}


def _write(path: Path, table: pa.Table) -> None:
    """Write a table as Parquet."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def _json(path: Path, content: dict[str, Any]) -> None:
    """Write content as a JSON file."""
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
