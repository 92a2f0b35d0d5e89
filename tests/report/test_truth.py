"""Test the reader of truth files with complete files, missing files, and files that are cut off after any byte."""

import json
from pathlib import Path

import numpy as np
import pytest

from handctl.errors import LogError
from handctl.report.truth_record import TruthRecord, copy_truth, read_truth
from handctl.session.lockstep_simulation import SimulatorSettings
from tests.report.generated_run import JAMIA_HAND, set_truth_column, write_truth, zero_truth_record


@pytest.fixture
def truth_record() -> TruthRecord:
    rng = np.random.default_rng(1)
    return TruthRecord(
        {}, np.arange(6) * 1_000_000 + 2**60, rng.normal(size=(6, 3)), ("a", "b/c", "d")
    )


def test_a_written_truth_file_is_read(truth_record: TruthRecord, tmp_path: Path) -> None:
    path = tmp_path / "t.truth"
    write_truth(path, truth_record)
    loaded_truth = read_truth(path)
    np.testing.assert_array_equal(loaded_truth.t_ns, truth_record.t_ns)
    np.testing.assert_array_equal(loaded_truth.values, truth_record.values)
    assert loaded_truth.columns == truth_record.columns
    assert loaded_truth.has_column("b/c")
    assert not loaded_truth.has_column("x")


def test_the_simulators_own_file_is_read(tmp_path: Path) -> None:
    from firmware_sim.lockstep_hand import LockstepHand

    path = tmp_path / "t.truth"
    rig = LockstepHand("jamia", scene="cylinder", truth_path=str(path), period_ns=2_000_000)
    for k in range(10):
        rig.step(k * 2_000_000, [])
    rig.close()
    truth = read_truth(path)
    names = {f"tension/{name}" for name in JAMIA_HAND.tendon_names} | {
        f"q/{name}" for name in JAMIA_HAND.joints
    }
    names |= {
        f"contact_force/{name}/{axis}" for name in JAMIA_HAND.digit_names for axis in "xyz"
    } | {"object/x"}
    assert names <= set(truth.columns)
    np.testing.assert_array_equal(np.diff(truth.t_ns), 1_000_000)


@pytest.mark.parametrize("period_ns", [2_000_000, 2_500_000, 5_000_000])
def test_true_values_once_per_tick_are_those_of_a_complete_file(
    tmp_path: Path, period_ns: int
) -> None:
    truths = []
    for is_once_per_tick in (False, True):
        path = tmp_path / f"{is_once_per_tick}.truth"
        settings = SimulatorSettings(
            "jamia", "cylinder", seed=3, truth=path, is_truth_once_per_tick=is_once_per_tick
        )
        with settings.simulated_hand(period_ns) as simulated_hand:
            for k in range(200):
                simulated_hand.step(k * period_ns, [])
        truths.append(read_truth(path))
    complete, at_ticks = truths
    np.testing.assert_array_equal(at_ticks.t_ns, np.arange(200) * period_ns)
    is_at_tick = np.isin(complete.t_ns, at_ticks.t_ns)
    assert is_at_tick.sum() >= 100
    np.testing.assert_array_equal(
        at_ticks.values[np.isin(at_ticks.t_ns, complete.t_ns)], complete.values[is_at_tick]
    )
    assert np.ptp(at_ticks.values, axis=0).any()


def test_a_file_cut_at_any_byte_gives_a_prefix_or_a_one_line_error(
    truth_record: TruthRecord, tmp_path: Path
) -> None:
    path = tmp_path / "t.truth"
    write_truth(path, truth_record)
    complete_content = path.read_bytes()
    header_size = complete_content.index(b"\n") + 1
    for file_size in range(len(complete_content)):
        path.write_bytes(complete_content[:file_size])
        row_count = max(0, file_size - header_size) // 32
        if row_count:
            truth = read_truth(path)
            np.testing.assert_array_equal(truth.values, truth_record.values[:row_count])
        else:
            with pytest.raises(LogError) as caught:
                read_truth(path)
            assert "\n" not in str(caught.value)
            assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "file_content",
    [
        b"", b"\n", b"{}\n", b"[]\n", b"null\n", b'{"columns": 3}\n', b'{"columns": null}\n', b'{"columns": []}\n',
        b"\xff\xfe\n" + bytes(100), b"{" * 100_000 + b"\n", b"x" * 1000, bytes(1000),
    ],
)  # fmt: skip
def test_another_file_gives_a_one_line_error(tmp_path: Path, file_content: bytes) -> None:
    path = tmp_path / "t.truth"
    path.write_bytes(file_content)
    with pytest.raises(LogError, match="truth"):
        read_truth(path)


def test_a_missing_file_and_a_folder_give_a_one_line_error(tmp_path: Path) -> None:
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(LogError, match="cannot be read"):
            read_truth(path)


def test_values_are_interpolated_between_rows_and_nan_outside() -> None:
    truth = zero_truth_record(JAMIA_HAND, 10, offset_ns=2**61)
    set_truth_column(truth, "object/x", np.arange(10.0))
    t_ns = 2**61 + np.array([-(10**9), 0, 5_000_000, 25_000_000, 10**12])
    np.testing.assert_allclose(
        truth.interpolated_column("object/x", t_ns), [np.nan, 0.0, 0.5, 2.5, np.nan]
    )
    assert truth.interpolated_columns(["object/x", "object/y"], t_ns).shape == (5, 2)


def test_a_column_that_is_not_there_is_named() -> None:
    with pytest.raises(LogError, match="no column 'tension/pinky'"):
        zero_truth_record(JAMIA_HAND, 3).interpolated_column("tension/pinky", np.array([0]))


def test_the_header_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "t.truth"
    path.write_bytes(json.dumps({"columns": ["a"], "seed": 7}).encode() + b"\n" + bytes(16))
    assert read_truth(path).header["seed"] == 7


@pytest.mark.parametrize(
    ("start_row", "end_row", "expected_rows"),
    [(0, 99, range(100)), (3, 5, range(3, 6)), (-9, 2, range(3))],
)
def test_a_copy_has_the_rows_between_two_times(
    tmp_path: Path, start_row: int, end_row: int, expected_rows: range
) -> None:
    """Reproduce a defect: each run copied and read all truth rows since the start of the simulator.

    The simulator writes 1.6 GB of truth rows per hour.
    """
    truth = zero_truth_record(JAMIA_HAND, 96)
    values = np.arange(truth.values.size, dtype=np.float64).reshape(truth.values.shape)
    complete_truth = TruthRecord({}, truth.t_ns + 10**15, values, truth.columns)
    write_truth(tmp_path / "whole", complete_truth)
    with (tmp_path / "whole").open("ab") as file:
        file.write(b"an incomplete row")
    first_ns, step = (
        int(complete_truth.t_ns[0]),
        int(complete_truth.t_ns[1] - complete_truth.t_ns[0]),
    )
    copied_row_count = copy_truth(
        tmp_path / "whole",
        tmp_path / "part",
        first_ns + step * start_row,
        first_ns + step * end_row,
    )
    assert copied_row_count == len(expected_rows)
    copied_truth = read_truth(tmp_path / "part")
    assert copied_truth.columns == complete_truth.columns
    np.testing.assert_array_equal(
        copied_truth.t_ns, complete_truth.t_ns[expected_rows.start : expected_rows.stop]
    )
    np.testing.assert_array_equal(
        copied_truth.values, values[expected_rows.start : expected_rows.stop]
    )


def test_a_copy_without_rows_is_no_file(tmp_path: Path, truth_record: TruthRecord) -> None:
    write_truth(tmp_path / "whole", truth_record)
    time_after_end = int(truth_record.t_ns[-1]) + 1
    assert (
        copy_truth(tmp_path / "whole", tmp_path / "part", time_after_end, time_after_end + 10**9)
        == 0
    )
    assert not (tmp_path / "part").exists()
    (tmp_path / "other").write_bytes(b"no truth")
    with pytest.raises(LogError, match="is not a truth file"):
        copy_truth(tmp_path / "other", tmp_path / "part", 0, 1)
