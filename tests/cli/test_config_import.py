"""Test ``handctl config init --urdf`` and ``--mjcf``.

The options ``--urdf`` and ``--mjcf`` import the links from a robot description. Some values are
missing in the resulting hand file. Until a user has added the missing values, handctl refuses the
hand file.
"""

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from handctl.cli.main import main
from handctl.hand.description import Hand
from handctl.hand.file.toml_text import toml_text
from handctl.hand.formats.link_meshes import with_meshes_from
from handctl.hand.hand_loading import (
    hand_content,
    hand_from_content,
    hand_path,
    inspect_hand_content,
    load_hand,
    packaged_hands,
)
from handctl.hand.link_geometry import centre_of_mass, joint_axes, link_inertia, link_placement
from handctl.hand.link_tree import LinkTree
from tests.cli.command_refusals import refusal_line, refusal_lines
from tests.conftest import NIGHTLY

TRIPOD_URDF = Path(__file__).with_name("tripod.urdf")
"""Description of the tripod: a hand with unusual frames, missing meshes, and joints that flex to negative angles."""
IMPORT_OPTIONS = [
    "--tendons",
    "one",
    "--pulley",
    "6",
    "--spool",
    "8",
    "--tension",
    "80",
    "--strength",
    "600",
]
IMPORT_OPTIONS += ["--cells", "all", "--encoders", "none", "--protocol", "mit", "--first-node", "1"]
MEASURED_VALUES = {
    "gravity_m_s2": "[0.0, 0.0, -9.81]",
    "tension_noise_N": "0.4",
    "tension_bias_drift_N": "0.8",
    "joint_damping_N_m_s_per_rad": "5e-4",
    "joint_armature_kg_m2": "1e-6",
    "spring_stiffness_N_m_per_rad": "0.06",
    "spring_preload_rad": "0.6",
    "coupling": "[[1.0], [1.0]]",
    "stiffness_N_per_m": "1e5",
    "damping_N_s_per_m": "30.0",
    "knee_N": "200.0",
    "stiffness_beyond_ratio": "0.5",
    "knee_width_m": "0.3e-3",
    "friction_coefficient": "0.08",
    "wrap_angle_rad": "1.57",
    "inertia_kg_m2": "1.3e-4",
    "viscous_N_m_s_per_rad": "1e-3",
    "coulomb_N_m": "0.015",
    "torque_constant_N_m_per_A": "0.26",
    "torque_peak_N_m": "1.0",
    "position_range_rad": "12.5",
    "velocity_range_rad_s": "50.0",
}
"""Values of the tripod that must be measured, because neither its description nor an option contains these values."""
JOINT_KEYS = ("joint_armature_kg_m2", "spring_stiffness_N_m_per_rad", "spring_preload_rad")
"""Keys of a digit that a hand file contains, but that an exported URDF does not contain."""
FILE_BY_OPTION = {"--urdf": "hand.urdf", "--mjcf": "hand.xml"}


def replace_todo_values(hand_file_text: str) -> str:
    """Replace each TODO in the text of a hand file by a value, and return the new text."""
    return re.sub(
        r'^(\w+) = "TODO".*$',
        lambda line: f"{line[1]} = {MEASURED_VALUES[line[1]]}",
        hand_file_text,
        flags=re.MULTILINE,
    )


def import_description(
    format_option: str, description_file: Path | str, *other_options: str
) -> str:
    """Import a robot description into the hand file mine.toml, and return the text of this hand file."""
    Path("mine.toml").unlink(missing_ok=True)
    assert (
        main(
            [
                "config",
                "init",
                "--yes",
                format_option,
                str(description_file),
                *other_options,
                "--output",
                "mine.toml",
            ]
        )
        == 0
    )
    return Path("mine.toml").read_text()


def reimport_packaged_hand(format_option: str, hand_name: str) -> Hand:
    """Export a packaged hand, import it again, and return the resulting hand.

    The resulting hand has the tendons, springs and buses of the packaged hand.
    """
    exported_file = Path(FILE_BY_OPTION[format_option])
    exported_file.unlink(missing_ok=True)
    assert (
        main(
            ["config", "export", format_option, "--hand", hand_name, "--output", str(exported_file)]
        )
        == 0
    )
    import_description(format_option, exported_file)
    packaged_content = with_meshes_from(load_hand(hand_name).content, hand_path(hand_name).parent)
    digits = []
    for digit, packaged_digit in zip(
        hand_content("mine.toml")["digit"], packaged_content["digit"], strict=True
    ):
        missing_keys = {key for key, value in digit.items() if value == "TODO"}
        assert missing_keys <= {*JOINT_KEYS, "coupling"}
        digits.append(
            digit
            | {
                key: packaged_digit[key]
                for key in (*JOINT_KEYS, "coupling")
                if key in packaged_digit
            }
        )
    content = packaged_content | {"digit": digits}
    Path("mine.toml").write_text(toml_text(content))
    return hand_from_content(content, "mine.toml")


@pytest.mark.parametrize("format_option", FILE_BY_OPTION)
@pytest.mark.parametrize("hand_name", packaged_hands())
def test_an_exported_hand_is_imported_unchanged(
    work_folder: Path, hand_name: str, format_option: str
) -> None:
    hand, packaged_content = reimport_packaged_hand(format_option, hand_name), load_hand(hand_name)
    assert hand.digit_names == packaged_content.digit_names
    for digit, packaged_digit in zip(hand.digit, packaged_content.digit, strict=True):
        assert digit.mount_on == packaged_digit.mount_on
        assert digit.link_length_m == pytest.approx(packaged_digit.link_length_m, abs=1e-9)
        assert digit.link_radius_m == pytest.approx(packaged_digit.link_radius_m)
        assert digit.joint_min_deg == pytest.approx(packaged_digit.joint_min_deg, abs=1e-6)
        assert digit.joint_max_deg == pytest.approx(packaged_digit.joint_max_deg, abs=1e-6)
        assert digit.joint_damping_N_m_s_per_rad == pytest.approx(
            packaged_digit.joint_damping_N_m_s_per_rad
        )
        assert joint_axes(digit) == pytest.approx(joint_axes(packaged_digit), abs=1e-9)
        for i in range(len(digit.joints)):
            assert np.hstack(
                [np.ravel(vector_or_matrix) for vector_or_matrix in link_placement(digit, i)]
            ) == pytest.approx(
                np.hstack(
                    [
                        np.ravel(vector_or_matrix)
                        for vector_or_matrix in link_placement(packaged_digit, i)
                    ]
                ),
                abs=1e-8,
            )
            assert digit.link_mass_kg[i] == pytest.approx(packaged_digit.link_mass_kg[i], rel=1e-6)
            assert centre_of_mass(digit, i) == pytest.approx(
                centre_of_mass(packaged_digit, i), abs=1e-9
            )
            assert link_inertia(digit, i) == pytest.approx(
                link_inertia(packaged_digit, i),
                abs=1e-6 * np.trace(link_inertia(packaged_digit, i)),
            )
    assert not inspect_hand_content(hand.content).mistakes
    if NIGHTLY or hand_name in ("t42", "orca_like"):
        assert main(["config", "check", "--hand", "mine.toml"]) == 0


def test_moment_arms_and_springs_of_a_model_are_imported(work_folder: Path) -> None:
    assert main(["config", "export", "--mjcf", "--hand", "n_plus_1", "--output", "hand.xml"]) == 0
    import_description("--mjcf", "hand.xml")
    content = hand_content("mine.toml")
    known_hand = load_hand("n_plus_1")
    assert [tendon["name"] for tendon in content["tendon"]] == list(known_hand.tendon_names)
    assert [tendon["motor"] for tendon in content["tendon"]] == list(known_hand.motor_names)
    assert [tendon["moment_arm_m"] for tendon in content["tendon"]] == [
        tendon.moment_arm_m for tendon in known_hand.tendon
    ]
    assert content["tendon"][0]["tension_max_N"] == known_hand.tendon[0].tension_max_N
    assert content["mount"]["gravity_m_s2"] == list(known_hand.mount.gravity_m_s2)


def test_a_motor_that_pulls_both_ways_is_imported_as_a_spool_pair(work_folder: Path) -> None:
    assert main(["config", "export", "--mjcf", "--hand", "orca_like", "--output", "hand.xml"]) == 0
    text = import_description("--mjcf", "hand.xml")
    known_hand = load_hand("orca_like")
    pair_names = {tendon.name for tendon in known_hand.tendon if tendon.pretension_N is not None}
    assert pair_names
    tendons = hand_content("mine.toml")["tendon"]
    assert {tendon["name"] for tendon in tendons if "pretension_N" in tendon} == pair_names
    assert {tendon.get("pretension_N", "TODO") for tendon in tendons} == {"TODO"}
    assert "# TODO measure: Tension of both tendons of a spool pair at rest" in text


def test_links_in_any_frames_have_the_dynamics_of_pinocchio(work_folder: Path) -> None:
    Path("full.toml").write_text(
        replace_todo_values(import_description("--urdf", TRIPOD_URDF, *IMPORT_OPTIONS))
    )
    tree = LinkTree.from_hand(load_hand("full.toml"))
    model = pinocchio.buildModelFromUrdf(str(TRIPOD_URDF))
    data = model.createData()
    # The first finger of the imported robot description flexes towards negative angles.
    signs = np.array([-1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    assert [name for name in model.names if name != "universe"][:2] == [
        "finger_a_joint_1",
        "finger_a_joint_2",
    ]
    rng = np.random.default_rng(0)
    turned_rotation = pinocchio.rpy.rpyToMatrix(*np.radians([-90.0, -90.0, 0.0]))
    for q in rng.uniform(0.0, 1.5, (10, 6)):
        expected = pinocchio.crba(model, data, signs * q)
        expected = np.triu(expected) + np.triu(expected, 1).T
        armature = 1e-6 * np.eye(6)
        assert tree.mass_matrix(q) == pytest.approx(
            signs[:, None] * expected * signs + armature, abs=1e-12
        )
        model.gravity.linear = turned_rotation @ np.array([0.0, 0.0, -9.81])
        torque = signs * pinocchio.computeGeneralizedGravity(model, data, signs * q)
        torque_at_rest = tree.inverse_dynamics(q, np.zeros(6), np.zeros(6))
        assert torque_at_rest == pytest.approx(torque, abs=1e-9)


def test_each_missing_value_is_refused_until_it_is_given(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = import_description("--urdf", TRIPOD_URDF, *IMPORT_OPTIONS)
    capsys.readouterr()
    lines = refusal_lines(capsys, "config", "check", "--hand", "mine.toml")
    keys = [re.search(r'([a-z]\w+): "TODO"; expected', line) for line in lines]
    assert all(keys)
    assert sorted(key[1] for key in keys if key) == sorted(MEASURED_VALUES), (
        "one line for each value"
    )
    assert all("# TODO" in line for line in text.splitlines() if '"TODO"' in line)
    full_text = replace_todo_values(text)
    for key, value in MEASURED_VALUES.items():
        Path("mine.toml").write_text(full_text.replace(f"{key} = {value}\n", f'{key} = "TODO"\n'))
        assert all(
            f"{key}: " in line
            for line in refusal_lines(capsys, "config", "check", "--hand", "mine.toml")
        )
    Path("mine.toml").write_text(full_text)
    assert main(["config", "check", "--hand", "mine.toml"]) == 0


def test_no_run_begins_with_a_missing_value(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import_description("--urdf", TRIPOD_URDF)
    capsys.readouterr()
    assert '"TODO"; expected' in refusal_line(capsys, "demo", "--lockstep", "--hand", "mine.toml")


def test_values_that_a_description_lacks_are_asked_for(
    work_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = itertools.chain(["each", "7", "some", "8", "90"], itertools.repeat(""))
    questions: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda text: questions.append(text) or next(answers))
    assert (
        main(
            [
                "config",
                "init",
                "--urdf",
                str(TRIPOD_URDF),
                "--cells",
                "none",
                "--output",
                "mine.toml",
            ]
        )
        == 0
    )
    content = hand_content("mine.toml")
    assert not any("Load cells" in text for text in questions), "the answer was an option"
    for question in ("Encoders", "Return springs", "Protocol"):
        assert any(question in text for text in questions)
    assert len(content["tendon"]) == 6
    assert content["tendon"][1]["moment_arm_m"] == {"finger_a_j1": 0.007, "finger_a_j2": 0.007}
    assert content["motor"][0]["torque_max_N_m"] == pytest.approx(1.4 * 90.0 * 0.008)
    assert content["motor"][0]["node_id"] == "TODO"
    assert content["sensor_node"]["tendons"] == []


INERTIAL_URDF = (
    '<inertial><mass value="0.01"/>'
    '<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def urdf_of(joint_text: str, link_text: str = INERTIAL_URDF, other_elements: str = "") -> str:
    """Return the text of a URDF that has one joint, one link, and a tip of this link."""
    return (
        f'<robot name="r"><link name="base"/><link name="a">{link_text}</link><joint name="j" {joint_text}>'
        f'<parent link="base"/><child link="a"/><axis xyz="0 0 1"/>'
        f'<limit lower="0" upper="1" effort="1" velocity="1"/></joint>{other_elements}</robot>'
    )


def mjcf_of(body_text: str, other_elements: str = "") -> str:
    """Return the MJCF text of a robot that has one body."""
    return (
        f'<mujoco><worldbody><body name="a">{body_text}</body></worldbody>{other_elements}</mujoco>'
    )


HINGE_MJCF = (
    '<joint name="j" range="0 90"/><inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/>'
)
SECOND_JOINT = (
    '<joint name="k" type="revolute"><parent link="a"/><child link="b"/><mimic joint="j" offset="0.1"/></joint>'
    f'<link name="b">{INERTIAL_URDF}</link>'
)
BAD_DESCRIPTIONS = [
    ("--urdf", "a hand", "not XML: "),
    ("--urdf", mjcf_of(HINGE_MJCF), "expected URDF, with the first element <robot>: give it with --mjcf"),
    ("--mjcf", urdf_of('type="revolute"'), "its first element is <robot>; expected MJCF"),
    ("--urdf", '<robot xmlns:xacro="http://x/xacro"><xacro:include filename="a"/></robot>', "xacro; expected the URDF"),
    ("--urdf", '<robot name="r"><link name="base"/></robot>', "no joints; expected a hand with hinges or"),
    ("--urdf", urdf_of('type="floating"'), "joint j is floating; expected revolute, continuous, prismatic, fixed"),
    ("--urdf", urdf_of('type="planar"'), "joint j is planar; expected revolute, continuous, prismatic"),
    ("--urdf", urdf_of('type="revolute"', ""), "expected a mass and an inertia for each link that moves"),
    ("--urdf", urdf_of('type="revolute"', INERTIAL_URDF, SECOND_JOINT),
     "joint k follows j with an offset; expected an angle that is proportional"),
    ("--urdf", urdf_of('type="revolute"'), "neither a frame nor a shape tells where its last link a ends"),
    ("--mjcf", mjcf_of('<freejoint/><geom size="0.01"/>'), "is a floating joint; expected hinges or"),
    ("--mjcf", mjcf_of('<joint type="ball"/><geom size="0.01"/>'), "joint_1 is a ball joint; expected hinges"),
    ("--mjcf", mjcf_of('<joint name="j"/>'), "expected a mass and an inertia for each link that moves"),
    ("--mjcf", mjcf_of(HINGE_MJCF, '<equality><joint name="e" joint1="j"/></equality>'), "the equality e closes"),
    ("--mjcf", mjcf_of(f'<joint name="k"/>{HINGE_MJCF}'), "body a has 2 joints; expected one joint for each body"),
]  # fmt: skip
"""For each text that describes no hand: the option of ``config init``, the text, and a part of the error message."""


COUPLED_JOINTS_URDF = (
    '<joint name="k" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.03 0 0"/>'
    '<axis xyz="0 0 -1"/><limit lower="-1" upper="0" effort="1" velocity="1"/>'
    '<mimic joint="j" multiplier="-0.5"/></joint>'
    f'<link name="b">{INERTIAL_URDF}</link>'
    '<joint name="m" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.03 0 0"/>'
    '<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/>'
    '<mimic joint="k" multiplier="-2"/></joint>'
    f'<link name="c">{INERTIAL_URDF}</link><link name="c_tip"/>'
    '<joint name="t" type="fixed"><parent link="c"/><child link="c_tip"/><origin xyz="0.02 0 0"/></joint>'
)
"""Two joints of a URDF: k turns against j by half the angle of j, and m turns against k by twice the angle of k.

The joint k flexes towards negative angles, so that its axis is reversed in the hand file.
"""


def test_a_joint_that_follows_another_becomes_a_coupling(work_folder: Path) -> None:
    Path("hand.urdf").write_text(urdf_of('type="revolute"', INERTIAL_URDF, COUPLED_JOINTS_URDF))
    import_description("--urdf", "hand.urdf", "--pulley", "8", "--tendons", "each")
    (digit,) = hand_content("mine.toml")["digit"]
    assert digit["coupling"] == [[1.0], [0.5], [1.0]]
    assert len(hand_content("mine.toml")["tendon"]) == 1


@pytest.mark.parametrize("format_option", FILE_BY_OPTION)
def test_an_exported_coupling_is_imported(work_folder: Path, format_option: str) -> None:
    """Reproduce a defect: `config init` refused an exported robot description with coupled spool pairs."""
    hand_file = str(Path(__file__).parents[1] / "hand" / "pairs_and_springs.toml")
    exported_file = FILE_BY_OPTION[format_option]
    words = ["config", "export", format_option, "--hand", hand_file, "--output", exported_file]
    assert main(words) == 0
    import_description(format_option, exported_file, "--tendons", "each")
    coupling = {
        digit["name"]: digit.get("coupling") for digit in hand_content("mine.toml")["digit"]
    }
    assert coupling["opposer"] == [[1.0, 0.0], [0.0, 1.0], [0.0, 0.8]]


@pytest.mark.parametrize(
    ("format_option", "description_text", "expected_message"), BAD_DESCRIPTIONS
)
def test_a_bad_description_is_one_line(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    format_option: str,
    description_text: str,
    expected_message: str,
) -> None:
    Path("bad.xml").write_text(description_text)
    line = refusal_line(
        capsys, "config", "init", "--yes", format_option, "bad.xml", "--output", "mine.toml"
    )
    assert "bad.xml: " in line
    assert expected_message in line
    assert not Path("mine.toml").exists()


@pytest.mark.parametrize(
    ("command_options", "expected_message"),
    [
        (["--urdf", "none.urdf"], "none.urdf: cannot be read: No such file or directory"),
        (
            ["--urdf", str(TRIPOD_URDF), "--fingers", "3"],
            "--fingers: given, and so is --urdf; expected one of them",
        ),
        (["--urdf", str(TRIPOD_URDF), "--first-node", "0"], "--first-node: 0; expected 1 to 127"),
        (["--urdf", str(TRIPOD_URDF), "--mjcf", "a.xml"], "not allowed with"),
        (
            ["--urdf", str(TRIPOD_URDF), "--tendons", "one", "--springs", "none"],
            "--springs: none, and one tendon cannot open a digit; expected all, or --tendons each",
        ),
    ],
)
def test_bad_options_are_refused(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    command_options: list[str],
    expected_message: str,
) -> None:
    assert expected_message in refusal_line(
        capsys, "config", "init", "--yes", *command_options, "--output", "mine.toml"
    )


def test_without_mujoco_the_extra_is_named(
    work_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    line = refusal_line(
        capsys, "config", "init", "--yes", "--urdf", str(TRIPOD_URDF), "--output", "mine.toml"
    )
    assert "needs mujoco: pip install 'handctl[sim]'" in line


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("format_option", "hand_name"),
    [("--mjcf", "t42"), ("--urdf", "jamia"), ("--mjcf", "orca_like"), ("", "")],
)
def test_an_imported_hand_grasps(
    work_folder: Path, capsys: pytest.CaptureFixture[str], format_option: str, hand_name: str
) -> None:
    if hand_name:
        reimport_packaged_hand(format_option, hand_name)
    else:
        Path("mine.toml").write_text(
            replace_todo_values(import_description("--urdf", TRIPOD_URDF, *IMPORT_OPTIONS))
        )
    capsys.readouterr()
    code = main(["demo", "--lockstep", "--hand", "mine.toml", "--log", "run.mcap", "--json"])
    out, err = capsys.readouterr()
    assert code == 0, err
    result = json.loads(out)
    assert result["table_sunk_mm"] > 50.0
    assert result["object_slid_mm"] < 5.0
