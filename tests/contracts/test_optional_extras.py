"""Test that, if an optional package is missing, a command that needs it prints one error line before any other work."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from firmware_sim.__main__ import EXTRA_PACKAGES
from firmware_sim.__main__ import main as firmware_sim
from handctl.cli.main import VERB_HELP, VERBS_BY_FOLDER, main
from handctl.cli.parsing.optional_packages import VERBS_WITHOUT_CONTROLLER
from handctl.extras import EXTRA_BY_MODULE, MissingExtraError, missing_extra, require_extra

REPOSITORY = Path(__file__).parents[2]
PROJECT_TABLE = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
PATHS_WITH_OPTIONAL_IMPORTS = (
    "src/handctl/gym/", "src/handctl/view/", "src/handctl/log/export/", "src/handctl/replay/dataset_episode.py",
    "src/handctl/tune/search/",
)  # fmt: skip
"""Folders and files of the source that are allowed to import optional packages of extras other than ``controller``."""
PACKAGES_OF_DEPENDENCIES = {"pydantic_core"}
"""Packages that belong to a dependency of handctl and are installed with this dependency.

The dependency that installs the package also fixes the version of the package.
"""


def hide_packages_script(extra_names: set[str]) -> str:
    """Return Python code that hides the packages of some extras from a process."""
    hidden_packages = [
        package for package, extra in EXTRA_BY_MODULE.items() if extra in extra_names
    ]
    return f"import sys\nsys.modules.update(dict.fromkeys({hidden_packages}))\n"


HIDE_EXTRAS_SCRIPT = hide_packages_script(set(EXTRA_BY_MODULE.values()))
"""Python code that hides every optional package from a process."""

COMMANDS_WITH_EXTRA = [
    ("run --hand jamia --bus local:x", "numba", "run needs numba", "controller"),
    ("gains show", "numba", "gains needs numba", "controller"),
    ("config check --hand jamia", "numba", "config needs numba", "controller"),
    ("replay execute no.mcap", "numba", "replay needs numba", "controller"),
    ("demo --lockstep", "mujoco", "demo needs mujoco", "sim"),
    ("sim --hand jamia --bus local:x", "mujoco", "sim needs mujoco", "sim"),
    ("identify --hand jamia --lockstep", "mujoco", "identify needs mujoco", "sim"),
    ("fault campaign --quick", "mujoco", "fault needs mujoco", "sim"),
    ("fault sequences", "mujoco", "fault needs mujoco", "sim"),
    ("paper --results no.json", "mujoco", "paper needs mujoco", "sim"),
    ("tune search --hand jamia", "optuna", "tune needs optuna", "tune"),
    (
        "tune search --hand jamia --scheduler tcp://h:1",
        "distributed",
        "tune needs distributed",
        "dask",
    ),
    ("tune verify g.toml --hand jamia --lockstep", "mujoco", "tune needs mujoco", "sim"),
    ("view no.mcap", "rerun", "view needs rerun", "view"),
    ("run --hand jamia --bus local:x --view", "rerun", "run needs rerun", "view"),
    ("log export no.mcap --parquet", "pyarrow", "log needs pyarrow", "export"),
    ("log export no.mcap --lerobot", "pyarrow", "log needs pyarrow", "export"),
    ("log export no.mcap --rrd", "rerun", "log needs rerun", "view"),
]


@pytest.mark.parametrize(
    ("words", "package_name", "command_text", "extra_name"),
    COMMANDS_WITH_EXTRA,
    ids=[row[0] for row in COMMANDS_WITH_EXTRA],
)
def test_a_missing_extra_is_one_line_that_names_it(
    words: str,
    package_name: str,
    command_text: str,
    extra_name: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setitem(sys.modules, package_name, None)
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    assert capsys.readouterr() == (
        "",
        f"handctl: {command_text}: pip install 'handctl[{extra_name}]'\n",
    )
    assert list(tmp_path.iterdir()) == []


def test_the_simulator_names_its_extra_as_well() -> None:
    code = (
        f"{HIDE_EXTRAS_SCRIPT}from firmware_sim.__main__ import main\n"
        "sys.exit(main(['--hand', 'jamia', '--bus', 'local:x']))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    expected = "firmware_sim: a simulated hand needs mujoco: pip install 'handctl[sim]'\n"
    assert (result.returncode, result.stderr) == (2, expected)
    assert {EXTRA_BY_MODULE[package] for package in EXTRA_PACKAGES} == {"sim"}
    assert callable(firmware_sim)


def test_the_api_names_the_extra_of_the_simulated_hand() -> None:
    code = (
        f"{hide_packages_script({'sim'})}from handctl.session.lockstep_simulation import SimulatorSettings\n"
        "SimulatorSettings('jamia').check_hand_constructible()"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.stderr.splitlines()[-1].endswith(
        "the simulated hand needs mujoco: pip install 'handctl[sim]'"
    )


def test_an_import_that_fails_in_the_middle_is_translated_as_well() -> None:
    extra_error = missing_extra("log", ModuleNotFoundError("no", name="pyarrow.parquet"))
    assert str(extra_error) == "log needs pyarrow: pip install 'handctl[export]'"
    assert missing_extra("log", ModuleNotFoundError("no", name="numpy")) is None


def test_an_import_that_fails_within_a_verb_names_the_verb(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("handctl.cli.main.optional_packages", lambda verb, args: ())
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.chdir(tmp_path)
    assert main(["-q", "tune", "search", "--hand", "jamia"]) == 2
    assert capsys.readouterr() == ("", "handctl: tune needs optuna: pip install 'handctl[tune]'\n")


def test_what_is_installed_is_not_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    require_extra("view", *EXTRA_BY_MODULE)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError):
        require_extra("view", "pyarrow", "rerun")


def test_the_doctor_names_what_is_installed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun_cli", None)
    main(["doctor", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["extras"] == {
        "controller": True,
        "sim": True,
        "view": False,
        "export": True,
        "tune": True,
        "dask": True,
        "gym": True,
    }
    assert {"version", "python", "platform"} <= report.keys()
    main(["doctor"])
    assert "not installed: view\n" in capsys.readouterr().out


@pytest.mark.parametrize("has_controller_extra", [True, False])
def test_no_verb_s_help_or_module_needs_an_extra(has_controller_extra: bool) -> None:
    modules = [
        f"handctl.cli.{folder}.{verb}"
        for folder, verbs in VERBS_BY_FOLDER.items()
        for verb in verbs
        if has_controller_extra or verb in VERBS_WITHOUT_CONTROLLER
    ]
    missing = set(EXTRA_BY_MODULE.values()) - ({"controller"} if has_controller_extra else set())
    code = (
        f"{hide_packages_script(missing)}import importlib\nfrom handctl.cli.main import main\n"
        f"for name in {list(VERB_HELP)}:\n    try:\n        main([name, '--help'])\n    except SystemExit:\n"
        "        pass\n"
        f"for name in {modules}:\n    importlib.import_module(name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


CLIENT_SCRIPT = """
import handctl, handctl.client, handctl.log.read.reader as reader
from handctl.compiled import NUMBA_INSTALLED, compile_kernels, square
from handctl.extras import MissingExtraError
assert not NUMBA_INSTALLED and square(3.0) == 9.0
with reader.RunLog(sys.argv[1]) as log:
    assert len(list(log.ticks())) > 300
try:
    compile_kernels()
except MissingExtraError as error:
    print(error)
"""
"""Text of a client program that a test runs in an environment without extras."""


def test_a_client_and_a_reader_of_logs_need_no_extra() -> None:
    """Without numba, Python interprets the kernels.

    Clients, and programs that read logs, also work with interpreted kernels. Only a controller
    needs compiled kernels.
    """
    log = REPOSITORY / "logs" / "golden" / "jamia-grasp.mcap"
    completed_process = subprocess.run(
        [sys.executable, "-c", HIDE_EXTRAS_SCRIPT + CLIENT_SCRIPT, str(log)],
        capture_output=True,
        text=True,
        check=False,
    )
    expected = "a controller needs numba: pip install 'handctl[controller]'\n"
    assert (completed_process.stdout, completed_process.returncode) == (expected, 0), (
        completed_process.stderr
    )


COMMANDS_WITHOUT_EXTRA = [
    ("log info {log}", 0, "hand.toml"),
    ("log export {log} --csv --output {folder}/rows", 0, ""),
    ("doctor", None, "not installed: controller, sim"),
    ("bus plan --hand jamia", 2, "handctl: bus needs numba: pip install 'handctl[controller]'"),
    ("scan --bus local:no-such-bus", 1, "no simulator serves this bus"),
]
"""Command lines for an environment without extras, each with its exit code and a part of its output."""


@pytest.mark.parametrize(("words", "exit_code", "text"), COMMANDS_WITHOUT_EXTRA)
def test_verbs_for_logs_and_buses_need_no_controller(
    words: str, exit_code: int | None, text: str, tmp_path: Path
) -> None:
    """The exit code of ``doctor`` depends on the machine, so the test does not check this exit code."""
    log = REPOSITORY / "logs" / "golden" / "jamia-grasp.mcap"
    code = f"{HIDE_EXTRAS_SCRIPT}from handctl.cli.main import main\nsys.exit(main(sys.argv[1:]))"
    command = words.format(log=log, folder=tmp_path).split()
    completed_process = subprocess.run(
        [sys.executable, "-c", code, *command], capture_output=True, text=True, check=False
    )
    assert exit_code in (None, completed_process.returncode), completed_process.stderr
    assert text in completed_process.stdout + completed_process.stderr


def test_each_extra_installs_what_it_is_named_for() -> None:
    extras = PROJECT_TABLE["optional-dependencies"]
    distributions_by_package = packages_distributions()
    for package, extra in EXTRA_BY_MODULE.items():
        names = {re.split(r"[=<>\[]", line)[0] for line in extras[extra]}
        assert names & set(distributions_by_package[package]), f"{extra} does not install {package}"
    listed = set(re.split(r"[\[\],]", extras["all"][0])[1:-1])
    assert listed == set(extras) - {"all"}


def test_optional_packages_are_imported_in_few_places_and_nothing_else_is_undeclared() -> None:
    extras = PROJECT_TABLE["optional-dependencies"]
    lines = PROJECT_TABLE["dependencies"] + extras["controller"]
    declared_packages = {re.split(r"[=<>]", line)[0] for line in lines}
    distributions_by_package = packages_distributions()
    for path in sorted((REPOSITORY / "src").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in imported_packages(node):
                if name in {*sys.stdlib_module_names, *PACKAGES_OF_DEPENDENCIES, "handctl"}:
                    continue
                relative_path = str(path.relative_to(REPOSITORY))
                if EXTRA_BY_MODULE.get(name, "controller") != "controller":
                    assert relative_path.startswith(PATHS_WITH_OPTIONAL_IMPORTS), (
                        f"{relative_path} imports {name}"
                    )
                else:
                    assert declared_packages & set(distributions_by_package[name]), (
                        f"{relative_path} imports {name}, which is not a dependency"
                    )


def imported_packages(node: ast.AST) -> list[str]:
    """Return the top-level packages that a node of a syntax tree imports."""
    match node:
        case ast.Import(names=aliases):
            return [alias.name.partition(".")[0] for alias in aliases]
        case ast.ImportFrom(module=str(module), level=0):
            return [module.partition(".")[0]]
    return []
