"""Test the meshes in a Rerun recording.

If a link has a mesh, the viewer draws the mesh instead of a capsule, with the right pose, scale and
colour.
"""

from pathlib import Path

import numpy as np
import pytest
import synthetic_run
from rrd_entities import RecordingEntity, entities_of_file, run_info_of

from handctl.cli.main import main
from handctl.hand.formats.link_meshes import meshes_of_hand
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.link_frames import quaternion_of_rotation
from handctl.log.attached_meshes import mesh_attachments
from handctl.log.header import RunHeader
from handctl.view.rerun_conversion import write_rrd
from handctl.view.scene.geometry import MESH_MEDIA_TYPES, link_colour
from tests.hand.mesh_files import hand_with_meshes, write_meshes


@pytest.fixture(scope="module")
def mesh_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the log of a hand with meshes on some links, and return its path.

    When the log is complete, delete the mesh files. Without mesh files, the log is the only source
    of the meshes, as on another machine.
    """
    folder = tmp_path_factory.mktemp("meshes")
    files = folder / "files"
    files.mkdir()
    write_meshes(files)
    hand = hand_with_meshes("jamia")
    attachments, _ = mesh_attachments(hand, files)
    attachments["hand.urdf"] = urdf_text(hand).encode()
    header = RunHeader.from_hand(
        hand.to_toml(), 10_000_000, attachments=attachments, deterministic=True
    )
    synthetic_run.write_synthetic_run(folder / "run.mcap", header, 0.5)
    for file in files.rglob("*.*"):
        file.unlink()
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def recorded_entities(mesh_log: Path) -> dict[str, RecordingEntity]:
    recording_path = mesh_log.with_suffix(".rrd")
    write_rrd(mesh_log, run_info_of(mesh_log), recording_path)
    return entities_of_file(recording_path)


def test_each_mesh_is_an_asset_in_the_frame_of_its_link(
    recorded_entities: dict[str, RecordingEntity], mesh_log: Path
) -> None:
    run = run_info_of(mesh_log)
    assert run.missing_mesh_note == ""
    for mesh in meshes_of_hand(run.hand):
        mesh_values = recorded_entities[f"/hand/{mesh.link}/mesh"].static_values
        assert mesh_values["CoordinateFrame:frame"] == [mesh.link]
        assert (
            bytes(np.array(mesh_values["Asset3D:blob"][0], np.uint8)) == run.meshes[mesh.link].data
        )
        assert mesh_values["Asset3D:media_type"] == [MESH_MEDIA_TYPES[mesh.suffix]]
        red, green, blue, *_ = link_colour(mesh.link, run)
        assert mesh_values["Asset3D:albedo_factor"] == [
            (red << 24) | (green << 16) | (blue << 8) | 255
        ]
        assert mesh_values["InstancePoses3D:translations"] == [
            pytest.approx(mesh.position, rel=1e-6)
        ]
        assert mesh_values["InstancePoses3D:quaternions"] == [
            pytest.approx(quaternion_of_rotation(mesh.rotation), abs=1e-6)
        ]
        assert mesh_values["InstancePoses3D:scales"] == [pytest.approx(mesh.scale, rel=1e-6)]


def test_a_link_has_a_mesh_or_capsules(
    recorded_entities: dict[str, RecordingEntity], mesh_log: Path
) -> None:
    hand = run_info_of(mesh_log).hand
    meshed_links = {mesh.link for mesh in meshes_of_hand(hand)}
    links = {"palm"} | {
        f"{digit.name}_link{i + 1}" for digit in hand.digit for i in range(len(digit.joints))
    }
    assert meshed_links < links
    for link in links:
        shape_kinds = {
            path.split("/")[3] for path in recorded_entities if path.startswith(f"/hand/{link}/")
        }
        assert (
            shape_kinds == {"mesh"}
            if link in meshed_links
            else "mesh" not in shape_kinds and shape_kinds
        ), link


def test_the_live_view_sends_the_same_meshes(
    mesh_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from handctl.view import log_follower

    sent: list[str] = []
    monkeypatch.setattr(
        log_follower.rr,
        "send_chunks",
        lambda chunks, recording: sent.extend(chunk.entity_path for chunk in chunks),
    )
    monkeypatch.setattr(log_follower, "FLUSH_TIMEOUT_S", 0.05)  # no viewer listens to the follower
    run = run_info_of(mesh_log)
    follower = log_follower.LogFollower(mesh_log, run, "rerun+http://127.0.0.1:1/proxy")
    follower.close()
    links = {path.split("/")[2] for path in sent if path.endswith("/mesh")}
    assert links == {mesh.link for mesh in meshes_of_hand(run.hand)}


def test_a_log_without_its_meshes_shows_capsules_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, recording_path = tmp_path / "run.mcap", tmp_path / "run.rrd"
    synthetic_run.write_synthetic_run(log, synthetic_run.synthetic_header("t42", 100), 0.3)
    assert main(["view", str(log), "--save", str(recording_path)]) == 0
    text = "capsules are drawn for palm, left_link1 and 3 more: the log does not have the meshes"
    assert f"handctl: caution: {log}: {text}\n" in capsys.readouterr().err
    paths = entities_of_file(recording_path)
    assert "/hand/left_link1/visual_0" in paths
    assert not [path for path in paths if path.endswith("/mesh")]


def test_the_page_of_a_run_draws_meshes(mesh_log: Path, tmp_path: Path) -> None:
    log_without_meshes = tmp_path / "bare.mcap"
    synthetic_run.write_synthetic_run(
        log_without_meshes, synthetic_run.synthetic_header("jamia", 100), 0.5
    )
    pictures = []
    for log in (mesh_log, log_without_meshes):
        page = tmp_path / f"{log.stem}.html"
        assert main(["report", str(log), "--output", str(page)]) == 0
        poses = page.read_text().split("The hand in each phase")[1].split("</section>")[0]
        pictures.append(poses.count("data:image/png"))
    assert pictures[0] > 0
    assert pictures[1] == 0
