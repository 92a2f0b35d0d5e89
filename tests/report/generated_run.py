"""Generate runs and true values for tests of the report.

All generated numbers are so simple that they can be checked by hand.
"""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from handctl.core.tick_types import TELEMETRY_AXES, HandMode
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.log.read.timeline import PhaseChange
from handctl.report.truth_record import TruthRecord

PERIOD_NS = 10_000_000


class GeneratedRunLog:
    """Fake log with the parts of a `RunLog` that the report uses.

    All telemetry values are NaN until a test sets them.
    """

    def __init__(self, hand: Hand, tick_count: int, phase_by_tick: dict[int, str]) -> None:
        size_by_axis = {
            "joint": len(hand.joints),
            "tendon": len(hand.tendon),
            "motor": len(hand.motor),
            "digit": len(hand.digit),
        }
        self.header = SimpleNamespace(
            period_ns=PERIOD_NS, tendons=hand.tendon_names, attachments=dict[str, bytes]()
        )
        self.k = np.arange(tick_count)
        self.late_ns = np.zeros(tick_count, np.int64)
        self.mode = np.full(tick_count, int(HandMode.ACTIVE), np.uint8)
        self.fields = {
            name: np.full((tick_count, size_by_axis[axis]), np.nan)
            for name, axis in TELEMETRY_AXES.items()
        }
        self.fields["contact"][:] = 0.0
        self.phases = [PhaseChange(k, k * PERIOD_NS, name) for k, name in phase_by_tick.items()]
        self.events: list[object] = []

    def __len__(self) -> int:
        return len(self.k)

    @property
    def t_ns(self) -> np.ndarray:
        return self.k * PERIOD_NS

    @property
    def times(self) -> np.ndarray:
        return self.t_ns * 1e-9

    def field(self, field_name: str) -> np.ndarray:
        return self.fields[field_name]


def zero_truth_record(hand: Hand, tick_count: int, offset_ns: int = 0) -> TruthRecord:
    """Create a record of a simulator's true values, all zero. The record has one row per control period.

    The record begins two rows before tick 0 of the run, and ends two rows after the last tick.
    """
    columns = [f"tension/{name}" for name in hand.tendon_names]
    columns += [f"q/{name}" for name in hand.joints]
    columns += [f"contact_force/{name}/{axis}" for name in hand.digit_names for axis in "xyz"]
    columns += ["object/x", "object/y", "object/z"]
    t_ns = offset_ns + np.arange(-2, tick_count + 2) * PERIOD_NS
    return TruthRecord({}, t_ns, np.zeros((len(t_ns), len(columns))), tuple(columns))


def set_truth_column(truth: TruthRecord, column_name: str, values: np.ndarray | float) -> None:
    """Set a column of a truth record in the ticks of the run.

    The rows before and after the run get the first and the last value of the column.
    """
    column = truth.values[:, truth.columns.index(column_name)]
    column[2:-2] = values
    column[:2], column[-2:] = column[2], column[-3]


def write_truth(truth_file: Path, truth: TruthRecord) -> None:
    """Write a truth record to a file, in the format of a simulator."""
    truth_rows = np.zeros(len(truth.t_ns), [("t_ns", "<i8"), ("v", "<f8", (len(truth.columns),))])
    truth_rows["t_ns"], truth_rows["v"] = truth.t_ns, truth.values
    truth_file.write_bytes(
        json.dumps({"columns": list(truth.columns)}).encode() + b"\n" + truth_rows.tobytes()
    )


JAMIA_HAND = load_hand("jamia")
