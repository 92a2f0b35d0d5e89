"""Test that the recipes in CONTRIBUTING.md work, and that the files that CONTRIBUTING.md names exist."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from textwrap import dedent

import pytest

REPOSITORY = Path(__file__).parents[2]
CONTRIBUTING_PAGE = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
READ_TOPIC_SCRIPT = """
import json, sys
import varied_run
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.write.log_writer import LogWriter
from rosbags.highlevel import AnyReader
from pathlib import Path

run, path = varied_run.varied_header(), Path("run.mcap")
writer = LogWriter(path, run, lambda event, number: None, 1)
for tick in varied_run.varied_ticks(run):
    writer.add_tick(pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :])
writer.finish("finished", 0)
with AnyReader([path]) as reader:
    peaks = [reader.deserialize(raw, connection.msgtype).tension
             for connection, _, raw in reader.messages() if connection.topic == "/peak"]
print(json.dumps(len(peaks)))
"""


def test_a_topic_is_added_as_the_page_says(tmp_path: Path) -> None:
    package = tmp_path / "handctl"
    shutil.copytree(
        REPOSITORY / "src" / "handctl", package, ignore=shutil.ignore_patterns("__pycache__")
    )
    section = CONTRIBUTING_PAGE.split("## How to add a topic")[1]
    definition, module, part_line = (
        dedent(code) for code in re.findall(r"   ```python\n(.*?) *```", section, re.DOTALL)
    )
    messages = package / "log" / "message_types.py"
    insert_text(messages, "DEFINITIONS = {\n", definition)
    (package / "log" / "topics" / "peak.py").write_text(module, encoding="utf-8")
    topic_set_file = package / "log" / "topics" / "topic_set.py"
    insert_text(
        topic_set_file, "import numpy as np\n", "from handctl.log.topics.peak import PeakTopic\n"
    )
    insert_text(topic_set_file, "self._parts = (\n", part_line)
    path = os.pathsep.join(map(str, (tmp_path, REPOSITORY / "tests" / "log", REPOSITORY)))
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", READ_TOPIC_SCRIPT],
        env=os.environ | {"PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout.splitlines()[-1]) == 120


def insert_text(file_path: Path, text_before: str, inserted_text: str) -> None:
    source = file_path.read_text(encoding="utf-8")
    assert source.count(text_before) == 1, text_before
    file_path.write_text(source.replace(text_before, text_before + inserted_text), encoding="utf-8")


PAGES_WITH_FILE_NAMES = (
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CHANGELOG.md",
    "docs/reference/stability.md",
)


@pytest.mark.parametrize("page_name", PAGES_WITH_FILE_NAMES)
def test_every_file_that_a_page_names_exists(page_name: str) -> None:
    text = (REPOSITORY / page_name).read_text(encoding="utf-8")
    folder = (REPOSITORY / page_name).parent
    links = {name.partition("#")[0] for name in re.findall(r"\]\(([^)#:]+[^):]*)\)", text)}
    assert [name for name in links if not (folder / name).exists()] == []
    quoted = re.findall(r"`((?:src|tests|tools|docs|firmware_sim|benchmarks)/[\w./-]+)`", text)
    assert [
        name for name in quoted if not (REPOSITORY / name).exists() and "NAME" not in name
    ] == []


def test_the_page_s_example_of_one_test_exists() -> None:
    file, name = re.findall(r"pytest (tests/\S+)::(\w+)", CONTRIBUTING_PAGE)[0]
    assert f"def {name}(" in (REPOSITORY / file).read_text(encoding="utf-8")


def test_the_hooks_run_what_make_lint_runs() -> None:
    hooks = re.findall(
        r"entry: (.*)", (REPOSITORY / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    )
    recipe = re.findall(
        r"^lint: .*\n((?:\t.*\n)+)",
        (REPOSITORY / "Makefile").read_text(encoding="utf-8"),
        re.MULTILINE,
    )[0]
    assert hooks == [line.strip().replace("$(BIN)", ".venv/bin") for line in recipe.splitlines()]


def test_every_place_that_names_the_version_names_the_same() -> None:
    version = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    changelog = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    released_versions = re.findall(r"^## \[(\d[^\]]*)\] - (\S+)", changelog, re.MULTILINE)
    citation = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert released_versions[0] == (
        version,
        *re.findall(r"^date-released: (.*)", citation, re.MULTILINE),
    )
    assert f"\nversion: {version}\n" in citation
