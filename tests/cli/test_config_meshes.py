"""Test the commands with meshes.

For each mistake in a mesh, the command prints one error line. The tests also cover the export of
meshes, and runs in which a mesh is missing.
"""

import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from firmware_sim.description.model_file import read_model_file
from handctl.cli.checks.config_import import read_hand_description
from handctl.cli.main import main
from handctl.cli.runs.protocol_hand_file import use_protocol_hand_file
from handctl.hand.formats.link_meshes import LinkMesh, mesh_mistakes, meshes_of_hand
from handctl.hand.hand_loading import (
    PACKAGED_HANDS_FOLDER,
    hand_content,
    hand_from_content,
    load_hand,
    packaged_hands,
)
from handctl.log.attached_meshes import MAX_MESH_BYTES
from handctl.session.run_plan import RunOptions, make_plan
from tests.cli.command_refusals import refusal_line, refusal_lines
from tests.cli.test_config_import import TRIPOD_URDF
from tests.hand.mesh_files import (
    assert_same_corners,
    corners_of_hand,
    hand_with_meshes,
    tetrahedron_triangles,
    write_meshes,
)
from tools.meshes.solids import stl

LINK_MESH_LINE = 'link_mesh = ["t42/inner.stl", "t42/outer.stl"]'
"""Line of t42.toml with the mesh files of a finger's two links. Both fingers use this line of t42.toml."""


@pytest.fixture
def copy_t42_with_meshes(work_folder: Path) -> Path:
    """Copy the hand file t42.toml with its meshes to mine/hand.toml, and return the path of the copy."""
    (work_folder / "mine").mkdir()
    shutil.copytree(PACKAGED_HANDS_FOLDER / "t42", work_folder / "mine" / "t42")
    shutil.copy(PACKAGED_HANDS_FOLDER / "t42.toml", work_folder / "mine" / "hand.toml")
    return work_folder / "mine" / "hand.toml"


def replace_once(text_file: Path, original_text: str, replacement_text: str) -> None:
    """Replace a text that occurs exactly once in a file."""
    text = text_file.read_text()
    assert text.count(original_text) == 1
    text_file.write_text(text.replace(original_text, replacement_text))


@pytest.mark.parametrize(
    ("original_text", "replacement_text", "expected_message"),
    [
        (
            "t42/palm.stl",
            "t42/plam.stl",
            'mount.palm_mesh: "t42/plam.stl": no such file; expected a file,',
        ),
        (
            "palm_mesh_scale = 0.001",
            "",
            'mount.palm_mesh: "t42/palm.stl": 74 m long; expected at most 1 m; palm_mesh_scale = 0.001 if the mesh',
        ),
        (
            "t42/inner.stl",
            "t42.stl",
            'default.digit.link_mesh[0]: "t42.stl": no such file; expected a file,',
        ),
        (
            "t42/inner.stl",
            "inner.glb",
            'default.digit.link_mesh[0]: "inner.glb"; expected a file of type .stl or .obj',
        ),
        (
            LINK_MESH_LINE,
            'link_mesh = ["t42/inner.stl"]',
            "link_mesh: 1 values; expected 2, one per link_length_m",
        ),
        (
            "link_mesh_scale = 0.001",
            "link_mesh_scale = 1",
            'default.digit.link_mesh[0]: "t42/inner.stl": 76.6 m long; expected at most 1 m; link_mesh_scale = 0.001',
        ),
        (
            "link_mesh_scale",
            "link_mesh_scales",
            "digit.link_mesh_scales: unknown key; expected link_mesh_scale",
        ),
    ],
)
def test_each_mistake_is_one_line_that_names_the_key(
    copy_t42_with_meshes: Path,
    capsys: pytest.CaptureFixture[str],
    original_text: str,
    replacement_text: str,
    expected_message: str,
) -> None:
    text = copy_t42_with_meshes.read_text()
    copy_t42_with_meshes.write_text(text.replace(original_text, replacement_text, 1))
    assert copy_t42_with_meshes.read_text() != text
    lines = refusal_lines(capsys, "config", "check", "--hand", "mine/hand.toml")
    assert expected_message in lines[0]
    # A wrong scale of the meshes counts as two mistakes, because each finger has two links with
    # meshes.
    assert len(lines) == (2 if replacement_text == "link_mesh_scale = 1" else 1), lines


def test_a_mesh_that_is_no_mesh_is_refused_and_a_run_begins_without_it(
    copy_t42_with_meshes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (copy_t42_with_meshes.parent / "t42" / "outer.stl").write_text("solid outer\n" * 20)
    expected_message = (
        'link_mesh[1]: "t42/outer.stl": an STL in text form; '
        "expected a binary STL, which MuJoCo reads as well"
    )
    assert refusal_line(capsys, "config", "check", "--hand", str(copy_t42_with_meshes)).endswith(
        f"default.digit.{expected_message}\n"
    )
    messages: list[str] = []
    plan = make_plan(RunOptions(copy_t42_with_meshes), show_notice=messages.append)
    assert messages == [
        f"handctl: caution: digit[{digit}].{expected_message}" for digit in ("left", "right")
    ]
    assert sorted(plan.attachments) == ["mesh/t42/inner.stl", "mesh/t42/palm.stl"]


def test_meshes_too_large_for_a_log_are_reported_before_the_run(copy_t42_with_meshes: Path) -> None:
    with (copy_t42_with_meshes.parent / "t42" / "outer.stl").open("r+b") as large_file:
        large_file.truncate(MAX_MESH_BYTES)
    messages: list[str] = []
    plan = make_plan(RunOptions(copy_t42_with_meshes), show_notice=messages.append)
    assert not plan.attachments
    (line,) = messages
    assert line.startswith(
        "handctl: caution: the meshes have 4.3 MB, more than 4.2 MB, and are not stored in the log"
    )


def test_a_plan_of_a_packaged_hand_has_its_meshes() -> None:
    assert sorted(make_plan(RunOptions("t42")).attachments) == [
        f"mesh/t42/{mesh_name}.stl" for mesh_name in ("inner", "outer", "palm")
    ]
    assert not make_plan(RunOptions("jamia")).attachments


def test_exports_name_meshes_relative_to_their_own_folder(copy_t42_with_meshes: Path) -> None:
    Path("out").mkdir()
    words = ["config", "export", "--hand", str(copy_t42_with_meshes)]
    assert main([*words, "--urdf", "--output", "out/hand.urdf"]) == 0
    assert main([*words, "--mjcf", "--output", "mine/hand.xml"]) == 0
    urdf = {mesh.get("filename") for mesh in ET.parse("out/hand.urdf").iter("mesh")}
    mjcf = {mesh.get("file") for mesh in ET.parse("mine/hand.xml").iter("mesh")}
    names = ("palm.stl", "inner.stl", "outer.stl")
    assert urdf == {f"../mine/t42/{name}" for name in names}
    assert mjcf == {f"t42/{name}" for name in names}


def test_a_hand_in_another_protocol_keeps_its_meshes(copy_t42_with_meshes: Path) -> None:
    from argparse import Namespace

    args = Namespace(hand=str(copy_t42_with_meshes), protocol="odrive", motor_type=None)
    with use_protocol_hand_file(args):
        assert args.hand != str(copy_t42_with_meshes)
        assert not list(mesh_mistakes(load_hand(args.hand), Path(args.hand).parent))


FILE_BY_OPTION = {"--urdf": "hand.urdf", "--mjcf": "hand.xml"}


@pytest.mark.parametrize("format_option", FILE_BY_OPTION)
@pytest.mark.parametrize("hand_name", packaged_hands())
def test_exported_meshes_come_back_to_their_places(
    work_folder: Path, hand_name: str, format_option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (work_folder / "hand").mkdir()
    (work_folder / "mine").mkdir()
    write_meshes(work_folder / "hand")
    hand = hand_with_meshes(hand_name)
    Path("hand/hand.toml").write_text(hand.to_toml())
    exported_file = f"hand/{FILE_BY_OPTION[format_option]}"
    assert (
        main(
            [
                "config",
                "export",
                format_option,
                "--hand",
                "hand/hand.toml",
                "--output",
                exported_file,
            ]
        )
        == 0
    )
    assert (
        main(
            ["config", "init", "--yes", format_option, exported_file, "--output", "mine/mine.toml"]
        )
        == 0
    )
    assert "warning" not in capsys.readouterr().out
    content = hand_content("mine/mine.toml")
    # The imported hand file has missing values, so it cannot be loaded. Load the packaged hand with
    # the meshes of the imported hand file instead.
    known_content = hand.content
    digits = [
        {key: value for key, value in digit.items() if "mesh" not in key}
        | {key: value for key, value in read.items() if "mesh" in key}
        for digit, read in zip(known_content["digit"], content["digit"], strict=True)
    ]
    mount = {"gravity_m_s2": known_content["mount"]["gravity_m_s2"]}
    mount |= {key: value for key, value in content["mount"].items() if "mesh" in key}
    repeated_hand = hand_from_content(known_content | {"mount": mount, "digit": digits}, hand_name)
    assert {mesh.file for mesh in meshes_of_hand(repeated_hand)} == {
        f"../hand/{file}"
        for file in ("m.stl", "sub/mm.obj", "sub/mm.stl")[: 3 if len(digits) > 1 else 2]
    }
    q = np.zeros(len(hand.joints))
    expected = corners_of_hand(hand, work_folder / "hand", q)
    assert_same_corners(corners_of_hand(repeated_hand, work_folder / "mine", q), expected)


def write_ros_package(work_folder: Path) -> Path:
    """Write a ROS package with a hand and its meshes, and return the path of its URDF."""
    folder = work_folder / "ws" / "gripper"
    (folder / "urdf").mkdir(parents=True)
    (folder / "meshes").mkdir()
    for size, name in enumerate(("base", "proximal"), 1):
        (folder / "meshes" / f"{name}.stl").write_bytes(stl(size * tetrahedron_triangles()))
    return Path(shutil.copy(TRIPOD_URDF, folder / "urdf"))


def test_meshes_of_a_package_are_imported(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = write_ros_package(work_folder)
    assert main(["config", "init", "--yes", "--urdf", str(urdf), "--output", "mine.toml"]) == 0
    assert "mesh" not in capsys.readouterr().out
    described, notes = read_hand_description(urdf, "urdf", work_folder)
    assert not notes
    assert described.palm_mesh
    assert described.palm_mesh.file == "ws/gripper/meshes/base.stl"
    # Compute the poses of the palm and of each link in the frame of the URDF, with all joints at
    # zero.
    model = read_model_file(str(urdf), "urdf")
    palm = described.palm
    (base,) = model["palm_meshes"]
    origin = np.array(base["position"]) - palm @ described.palm_mesh.position
    assert palm @ described.palm_mesh.rotation == pytest.approx(
        np.array(base["rotation"]), abs=1e-9
    )
    frames: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    places = {}
    for i, link in enumerate(model["links"]):
        position, rotation = frames.get(link["parent"], (np.zeros(3), np.eye(3)))
        frames[i] = (position + rotation @ link["position"], rotation @ link["rotation"])
        for mesh in link["meshes"]:
            mesh_pose = (
                frames[i][0] + frames[i][1] @ mesh["position"],
                frames[i][1] @ mesh["rotation"],
            )
            places[link["joint"]] = mesh_pose
    compared = 0
    for digit in described.digits:
        position, rotation = digit.position, digit.rotation
        for i, mesh in enumerate(digit.meshes):
            if i:
                position = position + rotation @ np.array([digit.lengths[i - 1], 0.0, 0.0])
                rotation = rotation @ digit.turns[i - 1]
            if mesh:
                expected_position, expected_rotation = places.pop(digit.joints[i])
                imported_position = origin + palm @ (position + rotation @ mesh.position)
                assert imported_position == pytest.approx(expected_position, abs=1e-9)
                assert palm @ rotation @ mesh.rotation == pytest.approx(expected_rotation, abs=1e-9)
                compared += 1
    assert compared
    assert not places


def test_meshes_that_a_hand_cannot_have_are_reported(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = write_ros_package(work_folder)
    meshes = urdf.parents[1] / "meshes"
    (meshes / "base.stl").write_text("solid base\n" * 20)
    (meshes / "proximal.stl").unlink()
    assert main(["config", "init", "--yes", "--urdf", str(urdf), "--output", "mine.toml"]) == 0
    lines = [
        line for line in capsys.readouterr().out.splitlines() if line.startswith("warning: mesh ")
    ]
    assert lines[-1] == (
        "warning: mesh base.stl of the palm is left out: an STL in text form; "
        "expected a binary STL, which MuJoCo reads as well"
    )
    assert all("mesh proximal.stl of " in line and "no such file" in line for line in lines[:-1])
    assert len(lines) > 1
    assert "_mesh" not in Path("mine.toml").read_text()


def test_the_largest_visual_mesh_of_a_body_is_imported_from_a_model(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_meshes(work_folder)
    (work_folder / "small.stl").write_bytes(stl(0.5 * tetrahedron_triangles()))
    body = '<body name="{0}" pos="{1} 0 0"><joint name="{0}" axis="0 0 1" range="0 90"/>'
    body += '<inertial pos="0.02 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/>'
    free = 'contype="0" conaffinity="0"'
    Path("model.xml").write_text(
        f"""<mujoco model="two"><compiler meshdir="sub"/>
        <asset><mesh name="turned" file="mm.stl" scale="0.001 0.001 0.001" refpos="3 1 2" refquat="0.8 0 0.6 0"/>
        <mesh name="small" file="../small.stl"/><mesh name="solid" file="../m.stl" scale="3 3 3"/></asset>
        <worldbody>{body.format("a_j1", 0)}<geom type="mesh" mesh="small" {free}/>
        <geom type="mesh" mesh="turned" pos="0.01 0 0.002" euler="0 40 10" {free}/><geom type="mesh" mesh="solid"/>
        {body.format("a_j2", 0.04)}<geom type="mesh" mesh="solid" pos="0 0.01 0"/>
        <site name="tip" pos="0.03 0 0"/></body></body></worldbody></mujoco>"""
    )
    assert main(["config", "init", "--yes", "--mjcf", "model.xml", "--output", "mine.toml"]) == 0
    out = capsys.readouterr().out
    assert "warning: mesh small.stl of a_j1 is left out: a link can have only one mesh\n" in out
    (digit,) = hand_content("mine.toml")["digit"]
    assert digit["link_mesh"] == ["sub/mm.stl", "m.stl"]
    assert digit["link_mesh_scale"] == [0.001, 3.0]
    model = mujoco.MjModel.from_xml_path("model.xml")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for link, geom in ((0, 1), (1, 3)):
        mesh = model.geom_dataid[geom]
        first_vertex, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        corners = (
            model.mesh_vert[first_vertex : first_vertex + count]
            @ data.geom_xmat[geom].reshape(3, 3).T
        )
        expected = corners + data.geom_xpos[geom] - data.xanchor[link]
        pose = [digit[f"link_mesh_{key}"][link] for key in ("position_m", "rpy_deg")]
        shown_mesh = LinkMesh("", "", "", (digit["link_mesh_scale"][link],) * 3, *map(tuple, pose))
        placed_triangles = shown_mesh.to_link_frame(
            (1e3 if link == 0 else 1.0) * tetrahedron_triangles()
        )
        assert_same_corners({"": expected}, {"": placed_triangles})
