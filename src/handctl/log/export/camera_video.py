"""Videos of the cameras in a LeRobot dataset, and statistics of their images.

A video has one image for each frame of an episode. The program ``ffmpeg`` decodes and encodes the
videos. A frame of the dataset gets the last image that the camera recorded before or at the time of
the frame. Source of the layout of the video files: LeRobot 0.4, ``datasets/lerobot_dataset.py`` and
``video_utils.py``. Each episode has its own video file. The statistics of the images are computed
for each colour channel. The values of a colour channel are from 0 to 1.
"""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.errors import ConfigError, LogError
from handctl.printing import printable_text

VIDEO_PATH_PATTERN = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
FILES_PER_CHUNK = 1000
"""Largest number of videos in one folder. LeRobot calls a folder of videos a chunk."""
MAX_MISSING_VIDEO_S = 0.5
"""Longest accepted time without camera frames at the start or end of an episode [s].

The first or last camera frame fills the time without camera frames.
"""
STATISTICS_WIDTH = 160
"""Largest width of the images from which statistics are computed [pixels].

Images that are wider than this limit are scaled down for the statistics.
"""
PIXEL_VALUE_COUNT = 256
"""Number of different values that a colour channel can have."""


class DatasetCamera(NamedTuple):
    """Camera of a LeRobot dataset.

    Attributes:
        name: name of the camera, such as ``wrist``.
        video_paths: video file that the camera recorded, for each episode.
        start_times_s: time from the start of the run to the first image of the video [s], for each
            episode.
    """

    name: str
    video_paths: tuple[Path, ...]
    start_times_s: tuple[float, ...]

    @property
    def feature_key(self) -> str:
        """Return the name of the camera's feature in the dataset."""
        return f"observation.images.{self.name}"


class EpisodeVideo(NamedTuple):
    """Video of one episode in a dataset.

    Attributes:
        height: height of an image of the video [pixels].
        width: width of an image of the video [pixels].
        frames: number of images in the video.
        histogram: (3, 256) number of pixels with each value, for red, green and blue.
    """

    height: int
    width: int
    frames: int
    histogram: NDArray[np.int64]


def make_cameras(
    names: Sequence[str],
    paths_by_camera: Sequence[Sequence[Path]],
    start_times_s: Sequence[float],
    logs: int,
) -> tuple[DatasetCamera, ...]:
    """Check the names, files and times given for cameras, and return the cameras.

    Args:
        names: name of each camera.
        paths_by_camera: video files of each camera, one for each log.
        start_times_s: time from the start of each run to the first frame of its video [s]. A single
            time applies to all runs.
        logs: number of logs.

    Raises:
        ConfigError: a name is wrong, the number of videos or times is wrong, a video does not
            exist, or ffmpeg is not installed.
    """
    start_times = tuple(start_times_s) * (logs if len(start_times_s) == 1 else 1)
    if len(start_times) != logs or not np.isfinite(start_times).all():
        raise ConfigError(
            f"{len(start_times_s)} times", "--camera-start", f"one, or {logs} finite times [s]"
        )
    for name, files in zip(names, paths_by_camera, strict=True):
        if not name.isidentifier() or not name.isascii() or list(names).count(name) > 1:
            raise ConfigError(
                repr(name), "--camera", "a name of letters and digits, each camera once"
            )
        if len(files) != logs:
            raise ConfigError(
                f"{len(files)} videos for {logs} logs", f"--camera {name}", "one video for each log"
            )
        for path in files:
            if not path.is_file():
                raise ConfigError("no such file", str(path), "a video")
    if names and shutil.which("ffmpeg") is None:
        raise ConfigError(
            "no program ffmpeg", "--camera", "ffmpeg installed, for example by apt install ffmpeg"
        )
    return tuple(
        DatasetCamera(name, tuple(files), start_times)
        for name, files in zip(names, paths_by_camera, strict=True)
    )


def video_file_numbers(episode: int) -> dict[str, int]:
    """Return the chunk number and the file number under which the dataset stores an episode's video."""
    return {"chunk_index": episode // FILES_PER_CHUNK, "file_index": episode % FILES_PER_CHUNK}


def write_episode_video(
    source_video: Path, target: Path, episode_start_s: float, frame_count: int, fps: int
) -> EpisodeVideo:
    """Write the video of an episode for the dataset.

    Args:
        source_video: video file that the camera recorded.
        target: video file to write.
        episode_start_s: time in the source video at which the episode begins [s]. If the time is negative,
            the source video begins after the start of the episode.
        frame_count: number of frames of the episode.
        fps: frame rate of the dataset [Hz].

    Raises:
        LogError: the source is not a video or does not cover the whole episode.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if episode_start_s < -MAX_MISSING_VIDEO_S:
        late_start_text = (
            f"the video begins {-episode_start_s:.2f} s after the start of the episode"
        )
        raise LogError(late_start_text, str(source_video), "a video of the whole run")
    video_filters = [
        f"setpts=PTS-STARTPTS-({episode_start_s:.9f}/TB)",
        f"fps=fps={fps}:start_time=0:round=up",
        f"tpad=stop_mode=clone:stop_duration={MAX_MISSING_VIDEO_S:g}",
        "scale=trunc(iw/2)*2:trunc(ih/2)*2",
    ]
    encode = [
        "-an",
        "-vf",
        ",".join(video_filters),
        "-frames:v",
        str(frame_count),
        "-c:v",
        "libx264",
        "-g",
        "2",
        "-crf",
        "23",
    ]
    _run_ffmpeg(source_video, *encode, "-pix_fmt", "yuv420p", str(target))
    width, height, _ = next(_video_frames(target, "null"))
    scaled = f"scale=min({STATISTICS_WIDTH}\\,iw):-2"
    histogram = np.zeros((3, PIXEL_VALUE_COUNT), np.int64)
    count = 0
    for _, _, pixels in _video_frames(target, scaled):
        histogram += [
            np.bincount(channel, minlength=PIXEL_VALUE_COUNT) for channel in pixels.reshape(-1, 3).T
        ]
        count += 1
    if count < frame_count:
        missing_time_s = (frame_count - count) / fps + MAX_MISSING_VIDEO_S
        early_end_text = f"the video ends {missing_time_s:.2f} s before the end of the episode"
        raise LogError(early_end_text, str(source_video), "a video of the whole run")
    return EpisodeVideo(height, width, count, histogram)


def _run_ffmpeg(source_video: Path, *arguments: str) -> None:
    """Run ffmpeg with a video file as input and the given arguments.

    Raises:
        LogError: ffmpeg reports an error.
    """
    command = ["ffmpeg", "-nostdin", "-v", "error", "-y", "-i", str(source_video), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if result.returncode != 0:
        raise _unreadable_video_error(source_video, result.stderr)


def _unreadable_video_error(source_video: Path, stderr: str) -> LogError:
    """Return the error that is raised if ffmpeg cannot read a video."""
    reason = printable_text((stderr.strip().splitlines() or ["no reason"])[-1])
    return LogError(f"ffmpeg: {reason}", str(source_video), "a video that ffmpeg reads")


def _video_frames(source: Path, filter_text: str) -> Any:
    """Yield the width, the height and the pixels (height * width * 3,) of every image of a video.

    Raises:
        LogError: the video contains no image.
    """
    command = ["ffmpeg", "-nostdin", "-v", "error", "-i", str(source), "-vf", filter_text]
    command += ["-fps_mode", "passthrough", "-f", "image2pipe", "-c:v", "ppm", "-"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        number = 0
        try:
            while (image := _read_ppm(process.stdout)) is not None:
                number += 1
                yield image
        finally:
            process.kill()
        if number == 0:
            raise _unreadable_video_error(source, process.stderr.read().decode(errors="replace"))


def _read_ppm(stream: IO[bytes]) -> tuple[int, int, NDArray[np.uint8]] | None:
    """Return width, height and pixels of the next image (netpbm P6) in a stream, or None at the end of the stream."""
    if stream.readline() != b"P6\n":
        return None
    width, height = map(int, stream.readline().split())
    stream.readline()
    return width, height, np.frombuffer(stream.read(width * height * 3), np.uint8)


def histogram_statistics(
    histogram: NDArray[np.int64], frames: int, percentiles: Sequence[int]
) -> dict[str, list[Any]]:
    """Return the statistics of the images of a video.

    Each statistic has the shape (3, 1, 1), with a value from 0 to 1 for each colour channel.

    Args:
        histogram: (3, 256) number of pixels with each value, for each colour channel.
        frames: number of images.
        percentiles: percentiles to compute.
    """
    values = np.arange(PIXEL_VALUE_COUNT) / (PIXEL_VALUE_COUNT - 1)
    total = histogram.sum(axis=1)
    mean = histogram @ values / total
    standard_deviation = np.sqrt(np.maximum(histogram @ values**2 / total - mean**2, 0.0))
    present_levels = [np.flatnonzero(channel) for channel in histogram]
    cumulative_fractions = np.cumsum(histogram, axis=1) / total[:, None]
    statistics = {
        "min": values[[pixel_values[0] for pixel_values in present_levels]],
        "max": values[[pixel_values[-1] for pixel_values in present_levels]],
        "mean": mean,
        "std": standard_deviation,
    }
    for percent in percentiles:
        pixel_values = [
            int(np.searchsorted(channel, percent / 100.0)) for channel in cumulative_fractions
        ]
        statistics[f"q{percent:02d}"] = values[pixel_values]
    return {name: statistic.reshape(3, 1, 1).tolist() for name, statistic in statistics.items()} | {
        "count": [frames]
    }
