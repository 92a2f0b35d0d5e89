"""Test that, after wrong input, every command prints one error line and exits with code 2 before it opens a bus.

No other process uses the bus of these tests. If a command tried to open the bus, the command would
exit with code 1 instead of 2.
"""

import socket
import tomllib

import pytest

from handctl.cli.main import VERB_HELP, main
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand, packaged_hands
from handctl.runtime.socket_paths import mailbox_path
from tests.cli.command_refusals import refusal_line

ABSENT_BUS_OPTION = ("--bus", "local:does-not-exist")
GRASP_TASK_OPTION = ("--task", "grasp.toml")
BUS_COMMANDS = {"run": GRASP_TASK_OPTION, "commission": (), "jog": ("index", "--tension", "8")}
"""Commands that open a bus, with their necessary arguments."""


@pytest.fixture(autouse=True)
def refuse_to_open_buses(monkeypatch):
    def fail_on_open(*command_words, **options):
        raise AssertionError("a bus was opened")

    monkeypatch.setattr("handctl.session.run.open_bus", fail_on_open)
    monkeypatch.setattr("handctl.session.run.Mailbox", fail_on_open)
    monkeypatch.setattr("handctl.cli.runs.demo.running_simulator", fail_on_open)


def jamia_hand_content():
    return hand_content("jamia")


def add_nan_mass(hand_content):
    hand_content["digit"][0]["link_mass_kg"][1] = float("nan")


def add_negative_mass(hand_content):
    hand_content["digit"][0]["link_mass_kg"][1] = -0.003


def add_unknown_key(hand_content):
    hand_content["digit"][0]["link_lenght_m"] = [0.03, 0.015, 0.01]


def repeat_node_number(hand_content):
    hand_content["motor"][1]["node_id"] = hand_content["motor"][0]["node_id"]


def exceed_tension_limit(hand_content):
    hand_content["tendon"][0]["tension_max_N"] = 700.0


REFUSAL_BY_MISTAKE = {
    add_nan_mass: ("link_mass_kg", "nan"),
    add_negative_mass: ("link_mass_kg", "-0.003"),
    add_unknown_key: ("link_lenght_m", "unknown key"),
    repeat_node_number: ("node_id", "index_motor"),
    exceed_tension_limit: ("tension_max_N", "700"),
}


@pytest.mark.parametrize("cli_verb", ["config", "demo", "sim", *BUS_COMMANDS])
@pytest.mark.parametrize("add_mistake", REFUSAL_BY_MISTAKE, ids=lambda spoil: spoil.__name__)
def test_a_wrong_hand_file_is_refused(work_folder, capsys, add_mistake, cli_verb):
    content = jamia_hand_content()
    add_mistake(content)
    (work_folder / "hand.toml").write_text(toml_text(content))
    words = {"config": ("check",), "demo": (), "sim": ABSENT_BUS_OPTION}.get(cli_verb) or (
        *ABSENT_BUS_OPTION,
        *BUS_COMMANDS.get(cli_verb, ()),
    )
    line = refusal_line(
        capsys, cli_verb, *(() if cli_verb == "demo" else words), "--hand", "hand.toml"
    )
    for word in REFUSAL_BY_MISTAKE[add_mistake]:
        assert word in line
    assert "expected" in line


@pytest.mark.parametrize("cli_verb", ["config", "demo", "sim", *BUS_COMMANDS])
def test_missing_hand_file_is_refused(capsys, cli_verb):
    words = (
        {"config": ("show",), "demo": (), "sim": ABSENT_BUS_OPTION}[cli_verb]
        if cli_verb not in BUS_COMMANDS
        else (*ABSENT_BUS_OPTION, *BUS_COMMANDS[cli_verb])
    )
    assert "one of jamia" in refusal_line(capsys, cli_verb, *words, "--hand", "jama")


@pytest.mark.parametrize("cli_verb", BUS_COMMANDS)
@pytest.mark.parametrize("rate_text", ["0", "-500", "nan", "inf", "5", "600", "5000"])
def test_rate_above_bus_or_drive_limit_is_refused(capsys, cli_verb, rate_text):
    line = refusal_line(
        capsys, cli_verb, *ABSENT_BUS_OPTION, *BUS_COMMANDS[cli_verb], f"--rate={rate_text}"
    )
    assert line.startswith("handctl: --rate: ")
    assert "at most 500" in line or "at least 40" in line


@pytest.mark.parametrize("cli_verb", BUS_COMMANDS)
@pytest.mark.parametrize(
    "time_scale_options",
    [
        ("--time-scale", "0"),
        ("--time-scale", "1e-300"),
        ("--time-scale", "nan"),
        ("--time-scale", "101"),
    ],
)
def test_a_time_scale_out_of_range_is_refused(capsys, cli_verb, time_scale_options):
    assert "--time-scale" in refusal_line(
        capsys, cli_verb, *ABSENT_BUS_OPTION, *BUS_COMMANDS[cli_verb], *time_scale_options
    )


@pytest.mark.parametrize("cli_verb", BUS_COMMANDS)
@pytest.mark.parametrize(
    "gain_text", ["schema = 1\n[motion]\nforce_N = -1\n", "[motion]\nforce = 1\n", "a = = b", None]
)
def test_bad_gains_are_refused(work_folder, capsys, cli_verb, gain_text):
    if gain_text is not None:
        (work_folder / "gains.toml").write_text(gain_text)
    assert "gains.toml" in refusal_line(
        capsys, cli_verb, *ABSENT_BUS_OPTION, *BUS_COMMANDS[cli_verb], "--gains", "gains.toml"
    )


TASK_HEAD = 'schema = 1\nname = "t"\n[[phase]]\n'
WRONG_TASKS = {
    "": "schema",
    TASK_HEAD: "phase",
    TASK_HEAD + 'kind = "throw"\n': "phase",
    TASK_HEAD + 'kind = "move"\nangle_deg = 1000.0\n': "angle_deg",
    TASK_HEAD + 'kind = "move"\nangle_deg = nan\n': "angle_deg",
    TASK_HEAD + 'kind = "move"\nangle_deg = { pinky = 3.0 }\n': "pinky",
    TASK_HEAD + 'kind = "hold"\ntension_N = 111.0\n': "tension",
    TASK_HEAD
    + 'kind = "hold"\ntension_N = { index = -1.0, ring = 5.0 }\n': "tension_N.index: -1.0",
    TASK_HEAD
    + 'kind = "move"\nangle_deg = { index = [0.0, inf, 1.0] }\n': "angle_deg.index[1]: inf",
    TASK_HEAD + 'kind = "hold"\ntension_N = 5.0\nspeed = 3.0\n': "unknown key",
    "schema = 2\n" + TASK_HEAD[11:] + 'kind = "release"\n': "schema",
    "\x00": "TOML",
}


@pytest.mark.parametrize("cli_verb", ["run", "demo", "config"])
@pytest.mark.parametrize(("task_text", "expected_key"), WRONG_TASKS.items())
def test_a_bad_task_is_refused(work_folder, capsys, cli_verb, task_text, expected_key):
    (work_folder / "task.toml").write_text(task_text)
    words = {"run": ABSENT_BUS_OPTION, "demo": (), "config": ("check",)}[cli_verb]
    line = refusal_line(capsys, cli_verb, *words, "--task", "task.toml")
    assert "task.toml" in line
    assert expected_key in line


UNDATED_CALIBRATION = (
    'schema = 1\nhand = "jamia"\nidentity = "0"\nmade = "yesterday"\ntendon = {}\n'
)


@pytest.mark.parametrize("cli_verb", ["run", "jog"])
@pytest.mark.parametrize(
    "calibration_text", ["", "schema = 1\nhand = 3\n", UNDATED_CALIBRATION, "\x00"]
)
def test_unusable_calibration_is_refused(work_folder, capsys, cli_verb, calibration_text):
    (work_folder / "c.toml").write_text(calibration_text)
    assert "c.toml" in refusal_line(
        capsys, cli_verb, *ABSENT_BUS_OPTION, *BUS_COMMANDS[cli_verb], "--calibration", "c.toml"
    )


@pytest.mark.parametrize("cli_verb", BUS_COMMANDS)
@pytest.mark.parametrize("log_name", ["no-folder/run.mcap", "there.mcap", "."])
def test_existing_log_is_not_overwritten(work_folder, capsys, cli_verb, log_name):
    (work_folder / "there.mcap").write_bytes(b"of another run")
    assert "--log" in refusal_line(
        capsys, cli_verb, *ABSENT_BUS_OPTION, *BUS_COMMANDS[cli_verb], "--log", log_name
    )
    assert (work_folder / "there.mcap").read_bytes() == b"of another run"


def write_hand_on_two_buses():
    """Write a hand file of jamia in which the thumb's drive is on a second bus."""
    content = jamia_hand_content()
    content["bus"].append({"name": "thumb", "bitrate": 1_000_000})
    content["motor"][3]["bus"] = "thumb"
    return content


BAD_BUSES = [
    ("local:a",),
    ("main=local:a",),
    ("main=local:a", "main=local:b"),
    ("main=local:a", "second=local:b"),
    ("main=local:a", "thumb="),
    ("main=local:a", "thumb=local:b", "third=local:c"),
]


@pytest.mark.parametrize("bus_options", BAD_BUSES, ids=" ".join)
@pytest.mark.parametrize("cli_verb", BUS_COMMANDS)
def test_bus_names_of_another_hand_are_refused(work_folder, capsys, cli_verb, bus_options):
    (work_folder / "two.toml").write_text(toml_text(write_hand_on_two_buses()))
    words = [word for bus in bus_options for word in ("--bus", bus)]
    line = refusal_line(capsys, cli_verb, "--hand", "two.toml", *words, *BUS_COMMANDS[cli_verb])
    assert "thumb=SPEC" in line


@pytest.mark.parametrize("cli_verb", BUS_COMMANDS)
@pytest.mark.parametrize("bus_option", ["other=local:a", "main="])
def test_unknown_bus_name_is_refused_for_one_bus(capsys, cli_verb, bus_option):
    assert "main=SPEC" in refusal_line(
        capsys, cli_verb, "--bus", bus_option, *BUS_COMMANDS[cli_verb]
    )


def test_buses_may_be_given_in_any_order(work_folder, capsys):
    (work_folder / "two.toml").write_text(toml_text(write_hand_on_two_buses()))
    words = ("--bus", "thumb=local:t", "--bus", "main=local:m", "--dry-run", "--json")
    assert main(["run", "--hand", "two.toml", *GRASP_TASK_OPTION, *words]) == 0
    assert '"local:m",\n    "local:t"' in capsys.readouterr().out


INVALID_JOG_ARGUMENTS = [
    ("pinky", "--tension", "8"),
    ("index", "--tension", "nan"),
    ("index", "--tension=-1"),
    ("index", "--tension", "111"),
    ("index", "--angle", "inf"),
    ("index", "--angle", "151"),
    ("index", "--angle", "10", "--for", "0"),
    ("index", "--angle", "10", "--for", "nan"),
]


@pytest.mark.parametrize("command_words", INVALID_JOG_ARGUMENTS, ids=" ".join)
def test_a_bad_jog_is_refused(capsys, command_words):
    refusal_line(capsys, "jog", *command_words, *ABSENT_BUS_OPTION)


@pytest.mark.parametrize(
    "command_words", [("--lockstep",), ("--lockstep", "--dry-run"), ("--dry-run",)], ids=" ".join
)
@pytest.mark.parametrize("scene_name", ["nosuch", "cylinder:-3", "nosuch.toml"])
def test_invalid_scene_is_refused(capsys, command_words, scene_name):
    main(["demo", "--scene", scene_name, *command_words])
    lines = [
        line
        for line in capsys.readouterr().err.splitlines()
        if not line.startswith("commissioning")
    ]
    assert len(lines) == 1
    assert lines[0].startswith("handctl: ")
    assert "scene" in lines[0]


@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        (("--scene", "nothing.toml"), "no such file"),
        (("--wire", "queue=-1"), "queue"),
        (("--time-scale", "0"), "0.001"),
    ],
)
def test_a_dry_run_of_the_simulator_checks_what_only_it_knows(
    capfd, command_words, expected_message
):
    assert main(["sim", *ABSENT_BUS_OPTION, *command_words, "--dry-run", "--json"]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert expected_message in err
    assert err.count("\n") == 1


INVALID_ARGUMENTS_BY_VERB = {
    "demo": ("--seed", "x"),
    "run": (),
    "stop": (),
    "clear": ("--bus",),
    "commission": ("--bus", "local:a", "--rate", "fast"),
    "jog": ("index", *ABSENT_BUS_OPTION),
    "view": (),
    "log": ("burn", "x.mcap"),
    "sim": ("--hand", "jamia"),
    "config": ("sow",),
    "doctor": ("--heal",),
}


@pytest.mark.parametrize("cli_verb", INVALID_ARGUMENTS_BY_VERB)
def test_unknown_words_of_a_verb_are_refused(capsys, cli_verb):
    assert cli_verb in VERB_HELP
    line = refusal_line(capsys, cli_verb, *INVALID_ARGUMENTS_BY_VERB[cli_verb])
    assert line.startswith(f"handctl: {cli_verb}")
    assert "expected" in line or "choose from" in line


def test_unknown_verb_is_refused(capsys):
    assert refusal_line(capsys, "rum") == (
        "handctl: the command line: unknown verb 'rum', did you mean run?; expected one that handctl --help lists\n"
    )


REQUEST_COMMANDS = (("stop",), ("stop", "--cut"), ("clear",), ("gains", "set", "motion.force_N=20"))
"""Words of the commands that send a request to a running controller."""


@pytest.mark.parametrize("command_words", REQUEST_COMMANDS, ids=" ".join)
def test_a_local_bus_without_a_controller_needs_no_power_switch(capsys, command_words):
    """Reproduce a defect.

    If no simulator ran, the command exited with code 71 and asked the user to switch off the motor
    power, which a simulated hand does not have.
    """
    assert main([*command_words, *ABSENT_BUS_OPTION]) == 1
    assert capsys.readouterr() == (
        "",
        "handctl: bus local:does-not-exist: no controller runs on this bus; "
        "expected the first bus of a running handctl run\n",
    )


@pytest.mark.parametrize("command_words", REQUEST_COMMANDS, ids=" ".join)
@pytest.mark.parametrize(
    "controller_was_killed", [False, True], ids=["real bus", "killed controller"]
)
def test_an_unconfirmed_request_is_reported_as_failed(capsys, command_words, controller_was_killed):
    """Reproduce a defect: a command exited with code 0 before the controller had confirmed the request of the command.

    The mailbox file of a controller still exists after the controller was killed.
    """
    bus = "local:killed" if controller_was_killed else "socketcan:does-not-exist"
    if controller_was_killed:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as mailbox:
            mailbox.bind(str(mailbox_path(bus)))
    assert main([*command_words, "--bus", bus]) == 71
    out, err = capsys.readouterr()
    expected = f"handctl: bus {bus}: no confirmation from the controller: switch the power off ("
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(expected)


@pytest.mark.parametrize(
    ("log_name", "expected_problem"),
    [
        ("old.mcap", "old.mcap exists already; expected a new file ending in .mcap"),
        ("new.log", "new.log has another ending; expected a new file ending in .mcap"),
        (
            "none/new.mcap",
            "the folder none does not exist; expected a file in a folder that exists",
        ),
    ],
)
def test_the_message_about_a_log_names_the_condition(
    work_folder, capsys, log_name, expected_problem
):
    (work_folder / "old.mcap").write_text("")
    for words in (("demo", "--lockstep"), ("run", *GRASP_TASK_OPTION, *ABSENT_BUS_OPTION)):
        assert (
            refusal_line(capsys, *words, "--log", log_name)
            == f"handctl: --log: {expected_problem}\n"
        )


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_output_of_config_show_is_the_same_hand(work_folder, capsys, hand_name):
    assert main(["config", "show", "--hand", hand_name]) == 0
    text = capsys.readouterr().out
    (work_folder / "mine.toml").write_text(text)
    assert load_hand("mine.toml").content == load_hand(hand_name).content
    assert hand_from_content(tomllib.loads(text), "shown").identity == load_hand(hand_name).identity


@pytest.mark.parametrize("task_name", ["grasps/grasp.toml", "grasp.json", "pinch.v2", "grap"])
def test_a_missing_task_file_is_not_replaced_by_a_packaged_task(work_folder, capsys, task_name):
    """Reproduce a defect: if a task file was missing, ``run`` executed the packaged task of the same name."""
    words = ("demo", "--lockstep", "--dry-run", "--task")
    expected_text = (
        "expected a task file, or one of grasp.toml, hook.toml, pinch-joints.toml, pinch.toml"
    )
    assert (
        refusal_line(capsys, *words, task_name)
        == f"handctl: {task_name}: no such task; {expected_text}\n"
    )
    for packaged in ("grasp", "grasp.toml"):
        assert main([*words, packaged]) == 0
        assert "power grasp" in capsys.readouterr().out
