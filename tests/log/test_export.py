"""Test the exports of a log.

Readers of other projects must find the values of the log in the exported files.
"""

import ast
import csv
import inspect
import re
from pathlib import Path

import can
import numpy as np
import pyarrow.parquet as pq
import pytest

from handctl.core import tick_types
from handctl.core.tick_types import TELEMETRY_FIELDS
from handctl.drives.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.log.export.csv_and_candump import (
    INTEGER_COLUMNS,
    TEXT_COLUMNS,
    _candump_line,
    column_names,
    column_title,
    column_unit,
    export_candump,
    export_csv,
)
from handctl.log.export.parquet import export_parquet
from handctl.log.read.reader import RunLog
from handctl.safety.safety_action import SafetyAction

GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"


@pytest.fixture
def golden_log():  # type: ignore[no-untyped-def]
    with RunLog(GOLDEN_FOLDER / "jamia-fault.mcap") as opened_log:
        yield opened_log


def telemetry_array(golden_log: RunLog) -> np.ndarray:
    return np.array([np.frombuffer(row, "<f8") for row in golden_log.packed_telemetry()])


def test_parquet_reads_back_bit_for_bit(golden_log: RunLog, tmp_path: Path) -> None:
    assert export_parquet(golden_log, tmp_path / "x.parquet") == len(golden_log)
    table = pq.read_table(tmp_path / "x.parquet")
    assert table.schema.metadata[b"handctl.hand"] == b"jamia"
    np.testing.assert_array_equal(table["t_ns"].to_numpy(), golden_log.t_ns)
    numbers = np.column_stack([table[name].to_numpy() for name in column_names(golden_log)])
    assert numbers.tobytes() == np.ascontiguousarray(telemetry_array(golden_log)).tobytes()
    np.testing.assert_array_equal(
        table["tension/ring_tendon"].to_numpy(), golden_log.field("tension")[:, 2]
    )
    assert [tick.phase for tick in golden_log.ticks()] == table["phase"].to_pylist()
    assert [SafetyAction(value).name for value in golden_log.action] == table["action"].to_pylist()


def test_csv_reads_back_bit_for_bit(golden_log: RunLog, tmp_path: Path) -> None:
    assert export_csv(golden_log, tmp_path / "x.csv") == len(golden_log)
    with (tmp_path / "x.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    numbers = np.array(
        [
            [float(row[column_title(name)] or "nan") for name in column_names(golden_log)]
            for row in rows
        ]
    )
    np.testing.assert_array_equal(numbers, telemetry_array(golden_log))
    assert [int(row["k"]) for row in rows] == golden_log.k.tolist()
    assert rows[-1]["mode"] == "DONE"


def test_units_are_those_that_the_telemetry_declares() -> None:
    """The units in the exported files equal the units in the class `Telemetry`.

    In the class `Telemetry`, the docstring of a field with a unit ends with the unit in brackets.
    """
    source = ast.parse(inspect.getsource(tick_types))
    (telemetry,) = (
        node for node in source.body if isinstance(node, ast.ClassDef) and node.name == "Telemetry"
    )
    names = [node.target.id for node in telemetry.body if isinstance(node, ast.AnnAssign)]
    texts = [node.value.value for node in telemetry.body if isinstance(node, ast.Expr)][1:]
    assert tuple(names) == TELEMETRY_FIELDS
    for name, text in zip(names, texts, strict=True):
        unit_match = re.search(r"\[([^\]]*)\]\.$", text)
        assert column_unit(f"{name}/x") == (
            unit_match[1].removesuffix(" at the spool") if unit_match else "1"
        ), name


def test_every_column_says_its_unit(golden_log: RunLog, tmp_path: Path) -> None:
    export_parquet(golden_log, tmp_path / "x.parquet")
    for field in pq.read_schema(tmp_path / "x.parquet"):
        assert field.name in TEXT_COLUMNS or field.metadata == {
            b"unit": column_unit(field.name).encode()
        }, field.name
    export_csv(golden_log, tmp_path / "x.csv")
    with (tmp_path / "x.csv").open(newline="") as file:
        titles = next(csv.reader(file))
    assert titles == [*INTEGER_COLUMNS, *TEXT_COLUMNS, *map(column_title, column_names(golden_log))]
    assert {
        "q/index_j1 [rad]",
        "tension_raw/thumb_tendon [N]",
        "motor_temperature/index_motor [degC]",
    } <= {*titles}


def test_the_page_has_the_units() -> None:
    """The table in docs/how-to/logs.md contains the unit of every exported quantity."""
    page = (GOLDEN_FOLDER.parents[1] / "docs" / "how-to" / "logs.md").read_text(encoding="utf-8")
    listed = {
        name: row[2]
        for row in re.findall(r"^\| (`[^|]*) \| ([^|]+) \| ([^|]+) \|", page, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row[0])
    }
    for name in (*INTEGER_COLUMNS, *TELEMETRY_FIELDS):
        assert listed[name] == (
            column_unit(name) if name in INTEGER_COLUMNS else column_unit(f"{name}/x")
        ), name


def test_python_can_reads_the_candump(golden_log: RunLog, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    assert export_candump(golden_log, path) == sum(
        len(t.frames) + len(t.tick_in.frames) for t in golden_log.ticks()
    )
    messages = list(can.CanutilsLogReader(path))
    expected = [
        (frame, tick.tick_in.t_ns if direction == "T" else frame.t_ns, direction == "R")
        for tick in golden_log.ticks()
        for direction, frames in (("R", tick.tick_in.frames), ("T", tick.frames))
        for frame in frames
    ]
    assert len(messages) == len(expected) > 5000
    for message, (frame, t_ns, received) in zip(messages, expected, strict=True):
        assert (message.arbitration_id, bytes(message.data)) == (frame.can_id, frame.data)
        assert message.timestamp == pytest.approx(max(t_ns, 0) / 1e9, abs=1.1e-6)
        assert (message.channel, message.is_rx) == ("main", received)


def test_time_stamps_of_the_candump_rise(
    golden_log: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a local bus, the time stamp of a frame is the time at which the frame is read.

    The time stamp of a frame can therefore be later than the start of the tick that reads the
    frame. In the exported file, the frames that a tick sends follow the frames that the tick has
    read. The time stamps of the sent frames must not be earlier than those of the read frames.
    """
    path = tmp_path / "x.log"
    ticks = [tick for tick, _ in zip(golden_log.ticks(), range(500), strict=False)]
    for bus_delay in (0, 40_000):
        late_ticks = [
            tick._replace(
                tick_in=tick.tick_in._replace(
                    frames=[
                        frame._replace(
                            t_ns=tick.tick_in.t_ns
                            + tick.tick_in.late_ns
                            + 50_000
                            - bus_delay * (i % 2)
                        )
                        for i, frame in enumerate(tick.tick_in.frames)
                    ]
                )
            )
            for tick in ticks
        ]
        monkeypatch.setattr(golden_log, "ticks", lambda late=late_ticks: iter(late))
        count = export_candump(golden_log, path)
        stamps = [message.timestamp for message in can.CanutilsLogReader(path)]
        assert len(stamps) == count > 3000
        assert stamps == sorted(stamps)
        path.unlink()


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x123 | EXTENDED_FLAG, b"\x01\x02", 0, 0),
        Frame(0x7FF | REMOTE_FLAG, b"", 0, 0),
        Frame(0x12, bytes(range(64)), FDF | BRS, 0),
        Frame(ERROR_FLAG | 0x80, bytes(8), 0, 0),
    ],
    ids=["extended", "remote", "FD", "error"],
)
def test_python_can_reads_every_kind_of_frame(frame: Frame, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text(_candump_line(frame, 1_234_567_890_123_456_789, ("b",), "R"))
    (message,) = can.CanutilsLogReader(path)
    assert message.is_fd == bool(frame.flags & FDF)
    assert message.bitrate_switch == bool(frame.flags & BRS)
    assert message.is_remote_frame == bool(frame.can_id & REMOTE_FLAG)
    assert message.is_error_frame == bool(frame.can_id & ERROR_FLAG)
    if not message.is_error_frame:
        assert message.arbitration_id == frame.can_id & 0x1FFF_FFFF
        assert message.is_extended_id == bool(frame.can_id & EXTENDED_FLAG)
        assert bytes(message.data) == frame.data


def test_nothing_is_overwritten(golden_log: RunLog, tmp_path: Path) -> None:
    path = tmp_path / "there"
    path.write_text("mine")
    for export in (export_csv, export_candump, export_parquet):
        with pytest.raises(FileExistsError, match="there"):
            export(golden_log, path)
    assert path.read_text() == "mine"
