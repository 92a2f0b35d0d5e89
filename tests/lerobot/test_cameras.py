"""Test the camera videos in an exported dataset.

The loader of LeRobot reads the exported camera videos. The tests are skipped if LeRobot is not
installed.
"""

import json
import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from handctl.core.tick_types import HandMode
from handctl.errors import LogError
from handctl.log.export.camera_video import make_cameras, write_episode_video
from handctl.log.export.lerobot import export_lerobot
from handctl.log.read.reader import RunLog

pytestmark = pytest.mark.skipif(
    find_spec("lerobot") is None, reason="needs LeRobot, see tests/lerobot/test_environment.py"
)
GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"
LOG_NAMES = ("jamia-fault.mcap", "jamia-grasp.mcap")
VIDEO_FRAMES_PER_S = 50
CAMERA_HZ = 30
IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX = 64, 48
BRIGHTNESS_PER_S = 40.0
"""Increase of the brightness in a test video per second [1/s]. The maximum brightness of an image is 255."""


@pytest.fixture(autouse=True)
def ffmpeg_on_path(tmp_path_factory, monkeypatch):
    """Add the program ffmpeg from the package imageio to PATH.

    If PATH already contains a program ffmpeg, the program in PATH has priority.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    folder = tmp_path_factory.mktemp("bin")
    (folder / "ffmpeg").symlink_to(get_ffmpeg_exe())
    monkeypatch.setenv("PATH", f"{os.environ['PATH']}{os.pathsep}{folder}")


def write_video(video_path, duration_s, width_px=IMAGE_WIDTH_PX):
    """Write a video whose images become brighter with time, and return the path of the video.

    A test can compute the time of an image in the video from the brightness of the image.
    """
    import imageio

    with imageio.get_writer(
        video_path, fps=CAMERA_HZ, macro_block_size=1, output_params=["-crf", "1"]
    ) as writer:
        for i in range(round(duration_s * CAMERA_HZ)):
            image = np.full(
                (IMAGE_HEIGHT_PX, width_px, 3),
                20 + round(BRIGHTNESS_PER_S * i / CAMERA_HZ),
                np.uint8,
            )
            image[:, : width_px // 2, 0] = 0  # the left half of the image contains no red
            writer.append_data(image)
    return video_path


def active_time_range(run_log):
    """Return the first and the last time [s] at which the hand is active in a log.

    The export makes an episode from the part of the log between the first and the last time.
    """
    active = run_log.t_ns[run_log.mode == int(HandMode.ACTIVE)] / 1e9
    return active[0], active[-1]


def brightness(image):
    """Return the mean level of green, 0 to 255, of an image from LeRobot's loader."""
    return float(image[1].mean()) * 255.0


def test_the_loader_gives_the_image_of_each_frame(tmp_path) -> None:
    torchcodec_decoders = pytest.importorskip(
        "torchcodec.decoders", reason="LeRobot needs torchcodec"
    )
    try:
        torchcodec_decoders.VideoDecoder(str(write_video(tmp_path / "any.mp4", 0.2)))
    except RuntimeError as error:  # only test_environment.py provides the FFmpeg libraries
        pytest.skip(f"torchcodec finds no FFmpeg libraries: {str(error).splitlines()[0]}")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with (
        RunLog(GOLDEN_FOLDER / LOG_NAMES[0]) as fault_log,
        RunLog(GOLDEN_FOLDER / LOG_NAMES[1]) as grasp_log,
    ):
        active_ranges_s = [active_time_range(log) for log in (fault_log, grasp_log)]
        video_start_times_s = (0.0, 0.25)
        videos = [
            write_video(tmp_path / f"{i}.mp4", active_ranges_s[i][1] - video_start_times_s[i] + 0.2)
            for i in range(2)
        ]
        cameras = make_cameras(["wrist"], [videos], video_start_times_s, 2)
        frames = export_lerobot(
            [fault_log, grasp_log], tmp_path / "data", VIDEO_FRAMES_PER_S, cameras
        )
    dataset = LeRobotDataset("me/exported", root=tmp_path / "data", video_backend="torchcodec")
    assert (dataset.num_frames, dataset.num_episodes, dataset.fps) == (
        frames,
        2,
        VIDEO_FRAMES_PER_S,
    )
    assert dataset.meta.camera_keys == ["observation.images.wrist"]
    generator = np.random.default_rng(0)
    for i in {0, frames - 1, *generator.integers(0, frames, 20).tolist()}:
        dataset_row = dataset[i]
        image = dataset_row["observation.images.wrist"]
        assert image.shape == (3, IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX)
        episode = int(dataset_row["episode_index"])
        frame_time_s = (
            active_ranges_s[episode][0]
            + float(dataset_row["timestamp"])
            - video_start_times_s[episode]
        )
        latest_camera_time_s = np.floor(frame_time_s * CAMERA_HZ + 1e-6) / CAMERA_HZ
        assert brightness(image) == pytest.approx(
            20.0 + BRIGHTNESS_PER_S * latest_camera_time_s, abs=3.0
        )
    statistics = dataset.meta.stats["observation.images.wrist"]
    assert statistics["mean"].shape == (3, 1, 1)
    assert int(statistics["count"][0]) == frames
    images = np.stack([dataset[i]["observation.images.wrist"].numpy() for i in range(frames)])
    for channel in range(3):
        values = images[:, channel]
        for name, value_of_frames in (
            ("mean", values.mean()),
            ("std", values.std()),
            ("min", values.min()),
            ("max", values.max()),
        ):
            assert float(statistics[name][channel, 0, 0]) == pytest.approx(
                float(value_of_frames), abs=0.03
            ), name


def test_videos_that_do_not_cover_an_episode_are_refused(tmp_path) -> None:
    source = write_video(tmp_path / "one.mp4", 1.0)
    with pytest.raises(
        LogError, match=r"one.mp4: the video ends 1.\d\d s before the end of the episode"
    ):
        write_episode_video(
            source, tmp_path / "a.mp4", 0.0, 2 * VIDEO_FRAMES_PER_S, VIDEO_FRAMES_PER_S
        )
    with pytest.raises(LogError, match=r"the video begins 1.00 s after the start of the episode"):
        write_episode_video(
            source, tmp_path / "a.mp4", -1.0, VIDEO_FRAMES_PER_S, VIDEO_FRAMES_PER_S
        )
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(LogError, match=r"text.mp4: ffmpeg: .*; expected a video that ffmpeg reads"):
        write_episode_video(
            tmp_path / "text.mp4", tmp_path / "a.mp4", 0.0, VIDEO_FRAMES_PER_S, VIDEO_FRAMES_PER_S
        )


def test_videos_of_different_sizes_are_refused(tmp_path) -> None:
    with (
        RunLog(GOLDEN_FOLDER / LOG_NAMES[0]) as fault_log,
        RunLog(GOLDEN_FOLDER / LOG_NAMES[1]) as grasp_log,
    ):
        active_end_times_s = [active_time_range(log)[1] for log in (fault_log, grasp_log)]
        videos = [
            write_video(tmp_path / f"{i}.mp4", active_end_times_s[i] + 0.2, IMAGE_WIDTH_PX + 16 * i)
            for i in range(2)
        ]
        cameras = make_cameras(["wrist"], [videos], (0.0,), 2)
        with pytest.raises(LogError, match=r"1.mp4: a video of 80 x 48 pixels; expected 64 x 48"):
            export_lerobot([fault_log, grasp_log], tmp_path / "data", VIDEO_FRAMES_PER_S, cameras)


def test_the_description_is_that_of_lerobot(tmp_path) -> None:
    from lerobot.datasets.video_utils import get_video_info

    with RunLog(GOLDEN_FOLDER / LOG_NAMES[0]) as log:
        video = write_video(tmp_path / "one.mp4", active_time_range(log)[1] + 0.2)
        export_lerobot(
            [log],
            tmp_path / "data",
            VIDEO_FRAMES_PER_S,
            make_cameras(["wrist"], [[video]], (0.0,), 1),
        )
    dataset_info = json.loads((tmp_path / "data" / "meta" / "info.json").read_text())
    key = "observation.images.wrist"
    path = (
        tmp_path
        / "data"
        / dataset_info["video_path"].format(video_key=key, chunk_index=0, file_index=0)
    )
    video_info = get_video_info(path)
    assert {name: dataset_info["features"][key]["info"][name] for name in video_info} == video_info
