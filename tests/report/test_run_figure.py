"""The figure of a run can be drawn even if the run is incomplete."""

from pathlib import Path

import numpy as np
import pytest

from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.report.run_figure import MARK_WIDTH_FRACTION, _mark_positions, draw_run
from handctl.report.truth_record import TruthRecord
from tests.report.invented_run import InventedLog, zero_truth


def run_of(name: str, lively: bool) -> InventedLog:
    log = InventedLog(load_hand(name), 120, {0: "silent", 40: "hold", 80: "done"})
    if lively:
        rng = np.random.default_rng(2)
        for field in log.fields.values():
            field[:] = rng.normal(size=field.shape)
        log.fields["tension"][::7] = np.nan
    else:
        log.mode[:] = int(HandMode.SILENT)
    return log


@pytest.mark.parametrize("name", ["jamia", "jamia11"])
@pytest.mark.parametrize("with_truth", [True, False])
@pytest.mark.parametrize("lively", [True, False])
def test_a_png_is_written(name: str, with_truth: bool, lively: bool, tmp_path: Path) -> None:
    truth: TruthRecord | None = zero_truth(load_hand(name), 120) if with_truth else None
    path = tmp_path / "run.png"
    draw_run(path, run_of(name, lively), load_hand(name), truth, 0, "a title")  # type: ignore[arg-type]
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    assert width > 800
    assert height > 600


def test_figure_depends_on_the_run(tmp_path: Path) -> None:
    paths = [tmp_path / f"{i}.png" for i in range(2)]
    for path, lively in zip(paths, (True, False), strict=True):
        draw_run(path, run_of("jamia", lively), load_hand("jamia"), None, 0, "t")  # type: ignore[arg-type]
    assert paths[0].read_bytes() != paths[1].read_bytes()


def test_hidden_values_do_not_affect_the_height(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = run_of("jamia", True)
    log.mode[60:] = int(HandMode.DONE)
    log.fields["q"][:], log.fields["q_goal"][:] = 0.1, np.nan
    log.fields["q"][:60] = np.linspace(0.0, 0.5, 60)[:, None]
    log.fields["q"][90:] = -9.0
    drawn = []
    monkeypatch.setattr(
        "handctl.report.run_figure.save_figure", lambda figure, path: drawn.append(figure)
    )
    draw_run(tmp_path / "x.png", log, load_hand("jamia"), None, 0, "t")  # type: ignore[arg-type]
    low, high = drawn[0].axes[0].get_ylim()
    assert -5.0 < low < 0.0
    assert np.degrees(0.5) < high < 35.0


@pytest.mark.parametrize("seed", range(5))
def test_names_of_phases_do_not_overlap_and_are_not_cut_off(seed: int) -> None:
    """Reproduce a defect: the texts "release" and "open" overlapped, and the end of the axis cut off the text "end"."""
    limits = (0.4, 9.4)
    width = MARK_WIDTH_FRACTION * (limits[1] - limits[0])
    times = [0.65, 1.0, 3.0, 8.0, 8.1, 9.35, 9.39, 12.0]
    times += np.random.default_rng(seed).uniform(*limits, size=8).tolist()
    positions = _mark_positions(times, limits)
    assert positions[0] is not None
    assert positions[7] is None, "outside of the axis"
    kept = [position for position in positions if position]
    assert len(kept) >= 7
    for i, (left, height) in enumerate(kept):
        assert limits[0] <= left <= limits[1] - width + 1e-9
        for other, other_height in kept[:i]:
            assert height != other_height or abs(left - other) >= width
