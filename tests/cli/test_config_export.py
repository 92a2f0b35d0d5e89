"""Test ``handctl config export``: cantools reads the DBC file of each bus, and MuJoCo reads the exported links."""

import json

import cantools
import mujoco
import pytest

from handctl.cli.main import main
from tests.cli.command_refusals import refusal_line
from tests.drives.protocol_bench import hand_file, move_to_second_bus


def message_names(dbc_file):
    """Read a DBC file with cantools in strict mode, and return the names of the messages."""
    return {message.name for message in cantools.database.load_file(dbc_file, strict=True).messages}


def test_a_hand_on_one_bus_has_one_file(work_folder, capsys):
    assert main(["config", "export", "--dbc", "--hand", "jamia"]) == 0
    assert capsys.readouterr().out == "jamia.dbc: bus main\n"
    assert {"sync", "tensions_0", "index_motor_feedback", "thumb_motor_command"} <= message_names(
        "jamia.dbc"
    )


def test_each_bus_of_a_hand_has_its_file(work_folder, capsys):
    path = move_to_second_bus(hand_file(work_folder, ["mit", "cia402"]))
    assert (
        main(["config", "export", "--dbc", "--hand", str(path), "--output", "two.dbc", "--json"])
        == 0
    )
    files = json.loads(capsys.readouterr().out)["files"]
    assert files == [
        {"bus": "main", "output": "two.main.dbc"},
        {"bus": "second", "output": "two.second.dbc"},
    ]
    assert "sync" in message_names("two.main.dbc")
    assert message_names("two.second.dbc") == {
        f"{digit_name}_motor_{pdo}"
        for digit_name in ("ring", "thumb")
        for pdo in ("tpdo1", "rpdo1")
    }


@pytest.mark.parametrize(
    ("export_format", "hand_name"), [("--urdf", "t42.urdf"), ("--mjcf", "t42.xml")]
)
def test_links_are_a_model_that_mujoco_reads(export_format, hand_name, work_folder, capsys):
    assert main(["config", "export", export_format, "--hand", "t42"]) == 0
    assert capsys.readouterr().out == f"{hand_name}: 2 digits, 4 joints\n"
    assert mujoco.MjModel.from_xml_path(str(work_folder / hand_name)).njnt == 4
    assert "not allowed with" in refusal_line(
        capsys, "config", "export", export_format, "--dbc", "--hand", "t42"
    )


def test_export_overwrites_no_file_and_refuses_foreign_options(work_folder, capsys):
    (work_folder / "jamia.dbc").write_text("mine")
    assert "is there already" in refusal_line(
        capsys, "config", "export", "--dbc", "--hand", "jamia"
    )
    assert (work_folder / "jamia.dbc").read_text() == "mine"
    assert "--dbc" in refusal_line(capsys, "config", "export", "--hand", "jamia")
    for words in (("show", "--dbc"), ("list", "--dbc"), ("check", "--output", "x.dbc")):
        assert f"config {words[0]}: unknown option '{words[1]}'" in refusal_line(
            capsys, "config", *words
        )
