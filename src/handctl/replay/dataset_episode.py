"""Episode of a LeRobot dataset as a program for a hand.

The joint angles in the actions of the episode must pass the same checks as a trajectory file.

The dataset must have the file layout of LeRobot's codebase version 3.0. An action has an element
such as `index_j1.pos_rad` for every hinge of the hand, and `jaw_j1.pos_m` for every prismatic
joint. The plug-in `lerobot_robot_handctl` and the command `log export --lerobot` write elements
with these names. Elements of an action that are not joint positions, such as tensions, are ignored.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.log.export.element_names import position_names
from handctl.printing import printable_text
from handctl.programs.playback import RecordedGoals
from handctl.programs.task import FOLLOW_SPEED_DEG_S

Array = NDArray[np.float64]

VERSION_PREFIX = "v3."
"""Beginning of the codebase version that a dataset must have."""
MAX_CLIP_DISTANCE_DEG = 3.0
"""Largest distance of an angle from its joint's range at which the angle is moved to the nearer limit [deg].

An angle that is farther outside of the range is refused. The estimated angle of a joint at its
mechanical stop can lie slightly outside of the joint's range.
"""
FRAME_RATE_RANGE_HZ = (1.0, 1000.0)
"""Lowest and highest accepted frame rate of a dataset [Hz]."""
MAX_EPISODE_S = 3600.0
"""Longest accepted episode [s]. The limit of the duration of a trajectory file is the same."""
MAX_INFO_BYTES = 1 << 24
"""Largest accepted size of `info.json` [bytes]."""


def find_episode(
    dataset_folder: Path,
    episode_index: int,
    hand: Hand,
    period: float,
    speed_deg_s: float | None = None,
) -> RecordedGoals:
    """Return the motion of an episode as a smooth curve of joint angles, sampled in each control period.

    Args:
        dataset_folder: folder of the dataset, with `meta` and `data`.
        episode_index: number of the episode, from 0.
        hand: hand that will follow the episode.
        period: control period of the hand [s].
        speed_deg_s: limit of the speed of each joint from frame to frame [deg/s]. Higher speeds of
            a joint are reduced to this limit. If ``speed_deg_s`` is None, an episode in which a
            joint is too fast is refused.

    Raises:
        ConfigError: the dataset or the episode does not exist, the episode contains no angles for
            a joint of the hand, or an angle or a speed is out of range.
    """
    dataset_info = _read_info(dataset_folder)
    rate = dataset_info.get("fps")
    if (
        not isinstance(rate, int | float)
        or not FRAME_RATE_RANGE_HZ[0] <= rate <= FRAME_RATE_RANGE_HZ[1]
    ):
        raise ConfigError(
            _value_text(rate),
            f"{_info_path(dataset_folder)}: fps",
            f"{FRAME_RATE_RANGE_HZ[0]:g} to {FRAME_RATE_RANGE_HZ[1]:g} Hz",
        )
    where = f"{dataset_folder}: episode {episode_index}"
    actions = _read_actions(dataset_folder, dataset_info, episode_index)
    if not 2 <= len(actions) <= MAX_EPISODE_S * rate:
        raise ConfigError(f"{len(actions)} frames", where, f"2 to {MAX_EPISODE_S * rate:.0f}")
    angles = _clip_to_range(_joint_angles(actions, dataset_info, hand, dataset_folder), hand, where)
    if speed_deg_s is not None:
        if not 0.0 < speed_deg_s <= FOLLOW_SPEED_DEG_S:
            raise ConfigError(
                f"{speed_deg_s:g} deg/s", "--speed", f"above 0, at most {FOLLOW_SPEED_DEG_S:g}"
            )
        units = hand.display_units
        unit_scale = np.where(units.is_prismatic, units.scale, 1.0)
        angles = _limit_angle_steps(angles, np.radians(speed_deg_s) * unit_scale / rate)
    return _smooth_curve(angles, float(rate), hand, period, where)


def _info_path(dataset_folder: Path) -> Path:
    """Return the path of `info.json`, the file that describes a dataset."""
    return dataset_folder / "meta" / "info.json"


def _read_info(dataset_folder: Path) -> Mapping[str, Any]:
    """Read the description of a dataset from the file `info.json`.

    Raises:
        ConfigError: the file does not describe a dataset of codebase version 3.
    """
    path = _info_path(dataset_folder)
    expected = "a LeRobot dataset (3.0)"
    try:
        if path.stat().st_size > MAX_INFO_BYTES:
            raise ConfigError("too large", str(path), expected)
        dataset_info = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", str(path), expected) from None
    except (ValueError, RecursionError):
        raise ConfigError("is no JSON", str(path), expected) from None
    version = dataset_info.get("codebase_version") if isinstance(dataset_info, dict) else None
    if not isinstance(version, str) or not version.startswith(VERSION_PREFIX):
        raise ConfigError(f"version {_value_text(version)}", str(path), expected)
    return dict(dataset_info)


def _read_actions(
    dataset_folder: Path, dataset_info: Mapping[str, Any], episode_index: int
) -> Array:
    """Return the actions (frames, n) of an episode, in the order of the episode's frames.

    Raises:
        ConfigError: the dataset does not have the episode, or a file of the dataset is damaged.
    """
    episodes = _read_episodes(dataset_folder)
    episode_indices = episodes["episode_index"].to_pylist()
    if episode_index not in episode_indices:
        expected_text = (
            f"{min(episode_indices)} to {max(episode_indices)}"
            if episode_indices
            else "a recorded episode"
        )
        raise ConfigError(f"no episode {episode_index}", str(dataset_folder), expected_text)
    at = episode_indices.index(episode_index)
    file_indices = {
        name: episodes[f"data/{name}"][at].as_py() for name in ("chunk_index", "file_index")
    }
    try:
        path = dataset_folder / str(dataset_info["data_path"]).format(**file_indices)
    except (KeyError, ValueError, IndexError, AttributeError):
        raise ConfigError(
            _value_text(dataset_info.get("data_path")),
            f"{_info_path(dataset_folder)}: data_path",
            "a path",
        ) from None
    table = _read_table(path, ["episode_index", "frame_index", "action"])
    table = table.filter(pa.compute.equal(table["episode_index"], episode_index)).sort_by(
        "frame_index"
    )
    length = len(table)
    if table["frame_index"].to_pylist() != list(range(length)):
        raise ConfigError(
            f"frames of episode {episode_index} are missing", str(path), "frames 0, 1, 2 ..."
        )
    try:
        values = np.array(table["action"].to_pylist(), np.float64)
    except (ValueError, TypeError):
        raise ConfigError(
            f"actions of episode {episode_index}", str(path), "vectors of one length"
        ) from None
    return values.reshape(length, -1)


def _read_episodes(dataset_folder: Path) -> pa.Table:
    """Return the table of all episodes of a dataset.

    Raises:
        ConfigError: the table is missing or damaged.
    """
    paths = sorted((dataset_folder / "meta" / "episodes").glob("*/*.parquet"))
    if not paths:
        raise ConfigError(
            "no table of episodes",
            str(dataset_folder / "meta" / "episodes"),
            "chunk-000/file-000.parquet",
        )
    columns = ["episode_index", "data/chunk_index", "data/file_index"]
    return pa.concat_tables([_read_table(path, columns) for path in paths])


def _read_table(path: Path, columns: list[str]) -> pa.Table:
    """Read the given columns of a Parquet file.

    Raises:
        ConfigError: the file is missing, is damaged, or lacks one of the columns.
    """
    try:
        table = pq.read_table(path, columns=columns)
    except (OSError, pa.ArrowException, ValueError) as error:
        reason = printable_text(str(error).splitlines()[0]) if str(error) else type(error).__name__
        raise ConfigError(
            f"cannot be read: {reason}", str(path), "a table of a LeRobot dataset"
        ) from None
    if missing := [name for name in columns if name not in table.column_names]:
        raise ConfigError(f"no column {missing[0]}", str(path), "a table of a LeRobot dataset")
    return table


def _joint_angles(
    actions: Array, dataset_info: Mapping[str, Any], hand: Hand, dataset_folder: Path
) -> Array:
    """Return the joint angles (frames, J) [rad] that the actions contain, in the order of the hand's joints.

    Raises:
        ConfigError: the actions lack a joint of the hand.
    """
    where = f"{_info_path(dataset_folder)}: features.action.names"
    expected_names = position_names(hand.joints, hand.prismatic_joints)
    try:
        names = list(dataset_info["features"]["action"]["names"])
    except (KeyError, TypeError):
        raise ConfigError("no names", where, f"{expected_names[0]} and so on") from None
    if len(names) != actions.shape[1]:
        raise ConfigError(
            f"{len(names)} names for {actions.shape[1]} values", where, "a name for each value"
        )
    if missing := [name for name in expected_names if name not in names]:
        raise ConfigError(f"no {missing[0]}", where, f"an angle for each joint of {hand.name}")
    return actions[:, [names.index(name) for name in expected_names]]


def _clip_to_range(angles_of_frames: Array, hand: Hand, episode_name: str) -> Array:
    """Limit angles (frames, J) to the ranges of the joints, and return the result.

    An angle up to ``MAX_CLIP_DISTANCE_DEG`` outside the range of its joint is set to the nearer
    limit of the range.

    Raises:
        ConfigError: an angle is not finite or lies far outside the range of the joint.
    """
    low, high = hand.joint_limits
    units = hand.display_units
    distance_beyond_range = units.to_display_units(
        np.maximum(low - angles_of_frames, angles_of_frames - high)
    )
    # The negated comparison is also true for NaN.
    is_beyond_limit = ~(distance_beyond_range <= MAX_CLIP_DISTANCE_DEG)
    if is_beyond_limit.any():
        frame, joint = (int(index) for index in np.argwhere(is_beyond_limit)[0])
        unit = units.names[joint]
        angle = units.to_display_units(angles_of_frames[frame])[joint]
        lower_limit, upper_limit = units.to_display_units(hand.joint_limits)[:, joint]
        problem = f"{angle:.6g} {unit} for {hand.joints[joint]} in frame {frame}"
        raise ConfigError(problem, episode_name, f"{lower_limit:g} to {upper_limit:g} {unit}")
    return np.clip(angles_of_frames, low, high)


def _limit_angle_steps(angles: Array, max_step: Array) -> Array:
    """Limit the change of joint angles from frame to frame.

    The returned angles (frames, J) follow the given angles, but change by at most `max_step` (J,)
    [rad] per frame.
    """
    limited_angles = angles.copy()
    for i in range(1, len(limited_angles)):
        limited_angles[i] = limited_angles[i - 1] + np.clip(
            angles[i] - limited_angles[i - 1], -max_step, max_step
        )
    return limited_angles


def _smooth_curve(
    angles: Array, rate: float, hand: Hand, period: float, episode_name: str
) -> RecordedGoals:
    """Return a smooth curve through the given angles, sampled in each control period.

    The curve begins and ends at rest.

    Raises:
        ConfigError: a joint moves too fast on the curve.
    """
    times = np.arange(len(angles)) / rate
    curve = CubicSpline(times, angles, bc_type="clamped")
    at = np.arange(round(times[-1] / period) + 1) * period
    units = hand.display_units
    rates = units.to_display_units(np.abs(curve(at, 1))) / units.displayed_per_degree
    if rates.max() > FOLLOW_SPEED_DEG_S:
        tick, joint = np.unravel_index(int(rates.argmax()), rates.shape)
        unit, displayed_per_degree = units.names[joint], units.displayed_per_degree[joint]
        max_speed = displayed_per_degree * rates.max()
        problem = f"{hand.joints[joint]} with {max_speed:.0f} {unit}/s after {at[tick]:.2f} s"
        limit = f"{displayed_per_degree * FOLLOW_SPEED_DEG_S:.4g}"
        raise ConfigError(problem, episode_name, f"at most {limit} {unit}/s, or a limit by --speed")
    return RecordedGoals(
        curve(at), curve(at, 1), curve(at, 2), np.zeros((len(at), len(hand.tendon)))
    )


def _value_text(value: object) -> str:
    """Return an invalid value of a dataset as text for an error message."""
    return printable_text(repr(value))[:40]
