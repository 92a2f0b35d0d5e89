"""Meshes on the command line: one line for each mistake, exports, and runs that go on without a mesh."""

import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from handctl.cli.main import main
from handctl.cli.runs.other_protocol import hand_in_protocol
from handctl.hand.load import PACKAGED_HANDS_FOLDER, load_hand
from handctl.hand.meshes import mesh_mistakes
from handctl.log.attached_meshes import MAX_BYTES
from handctl.session.plan import Choice, make_plan
from tests.cli.refused import refused, refused_lines

LINK_LINE = 'link_mesh = ["t42/inner.stl", "t42/outer.stl"]'
"""Line of t42.toml with the meshes of both fingers."""


@pytest.fixture
def own(place: Path) -> Path:
    """Write the hand t42 with its meshes as mine/hand.toml."""
    (place / "mine").mkdir()
    shutil.copytree(PACKAGED_HANDS_FOLDER / "t42", place / "mine" / "t42")
    shutil.copy(PACKAGED_HANDS_FOLDER / "t42.toml", place / "mine" / "hand.toml")
    return place / "mine" / "hand.toml"


def changed(path: Path, old: str, new: str) -> None:
    """Replace a part of a file that occurs once."""
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "line"),
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
            LINK_LINE,
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
    own: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, line: str
) -> None:
    text = own.read_text()
    own.write_text(text.replace(old, new, 1))
    assert own.read_text() != text
    lines = refused_lines(capsys, "config", "check", "--hand", "mine/hand.toml")
    assert line in lines[0]
    # Both links of the fingers have the wrong scale.
    assert len(lines) == (2 if new == "link_mesh_scale = 1" else 1), lines


def test_a_mesh_that_is_no_mesh_is_refused_and_a_run_begins_without_it(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (own.parent / "t42" / "outer.stl").write_text("solid outer\n" * 20)
    right = 'link_mesh[1]: "t42/outer.stl": an STL in text form; expected a binary STL, which MuJoCo reads as well'
    assert refused(capsys, "config", "check", "--hand", str(own)).endswith(
        f"default.digit.{right}\n"
    )
    told: list[str] = []
    plan = make_plan(Choice(own), tell=told.append)
    assert told == [f"handctl: caution: digit[{digit}].{right}" for digit in ("left", "right")]
    assert sorted(plan.attachments) == ["mesh/t42/inner.stl", "mesh/t42/palm.stl"]


def test_meshes_too_large_for_a_log_are_told_before_the_run(own: Path) -> None:
    with (own.parent / "t42" / "outer.stl").open("r+b") as large:
        large.truncate(MAX_BYTES)
    told: list[str] = []
    plan = make_plan(Choice(own), tell=told.append)
    assert not plan.attachments
    (line,) = told
    assert line.startswith(
        "handctl: caution: the meshes have 4.3 MB, more than 4.2 MB, and are not stored in the log"
    )


def test_a_plan_of_a_packaged_hand_has_its_meshes() -> None:
    assert sorted(make_plan(Choice("t42")).attachments) == [
        f"mesh/t42/{one}.stl" for one in ("inner", "outer", "palm")
    ]
    assert not make_plan(Choice("jamia")).attachments


def test_exports_name_meshes_relative_to_their_own_folder(own: Path) -> None:
    Path("out").mkdir()
    words = ["config", "export", "--hand", str(own)]
    assert main([*words, "--urdf", "--output", "out/hand.urdf"]) == 0
    assert main([*words, "--mjcf", "--output", "mine/hand.xml"]) == 0
    urdf = {mesh.get("filename") for mesh in ET.parse("out/hand.urdf").iter("mesh")}
    mjcf = {mesh.get("file") for mesh in ET.parse("mine/hand.xml").iter("mesh")}
    names = ("palm.stl", "inner.stl", "outer.stl")
    assert urdf == {f"../mine/t42/{name}" for name in names}
    assert mjcf == {f"t42/{name}" for name in names}


def test_a_hand_in_another_protocol_keeps_its_meshes(own: Path) -> None:
    from argparse import Namespace

    args = Namespace(hand=str(own), protocol="odrive")
    with hand_in_protocol(args):
        assert args.hand != str(own)
        assert not list(mesh_mistakes(load_hand(args.hand), Path(args.hand).parent))
