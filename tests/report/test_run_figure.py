"""The figure of a run can be drawn even if the log of the run is incomplete."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.output_files import save_figure
from handctl.report.run_figure import MARK_WIDTH_FRACTION, _mark_positions, draw_run
from handctl.report.truth_record import TruthRecord
from tests.report.generated_run import GeneratedRunLog, set_truth_column, zero_truth_record


def generate_run_log(hand_name: str, has_values: bool) -> GeneratedRunLog:
    log = GeneratedRunLog(load_hand(hand_name), 120, {0: "silent", 40: "hold", 80: "done"})
    if has_values:
        rng = np.random.default_rng(2)
        for field in log.fields.values():
            field[:] = rng.normal(size=field.shape)
        log.fields["tension"][::7] = np.nan
    else:
        log.mode[:] = int(HandMode.SILENT)
    return log


@pytest.fixture
def drawn_figures(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return a list that collects every drawn figure."""
    figures: list[Any] = []
    monkeypatch.setattr(
        "handctl.report.run_figure.save_figure", lambda figure, path: figures.append(figure)
    )
    return figures


@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
@pytest.mark.parametrize("has_truth", [True, False])
@pytest.mark.parametrize("has_values", [True, False])
def test_a_png_is_written(
    hand_name: str, has_truth: bool, has_values: bool, tmp_path: Path
) -> None:
    truth: TruthRecord | None = zero_truth_record(load_hand(hand_name), 120) if has_truth else None
    path = tmp_path / "run.png"
    draw_run(
        path, generate_run_log(hand_name, has_values), load_hand(hand_name), truth, 0, "a title"
    )  # type: ignore[arg-type]
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    width, height = (int.from_bytes(content[offset : offset + 4], "big") for offset in (16, 20))
    assert width > 800
    assert height > 600


def test_labels_of_axes_are_inside_the_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect: axis numbers such as 12.5 pushed the label "tendon tension" out of the picture."""
    collected_figures = []

    def save_and_record_figure(figure: Figure, path: Path) -> None:
        save_figure(figure, path)
        collected_figures.append(figure)

    monkeypatch.setattr("handctl.report.run_figure.save_figure", save_and_record_figure)
    log = generate_run_log("jamia", True)
    log.late_ns[:] = 1000
    log.fields["tension"][:] = np.linspace(0.0, 13.0, 120)[:, None]
    log.fields["tension_goal"][:] = np.linspace(0.0, 1.0, 120)[:, None]
    log.fields["tension_sigma"][:] = 0.01
    log.fields["q"][:] = log.fields["q_goal"][:] = np.linspace(0.0, 0.7, 120)[:, None]
    draw_run(tmp_path / "x.png", log, load_hand("jamia"), None, 0, "t")  # type: ignore[arg-type]
    labels = [axes.yaxis.label for axes in collected_figures[0].axes if axes.get_ylabel()]
    assert len(labels) == 4
    assert min(label.get_window_extent().x0 for label in labels) >= 0.0


def test_figure_depends_on_the_run(tmp_path: Path) -> None:
    paths = [tmp_path / f"{i}.png" for i in range(2)]
    for path, lively in zip(paths, (True, False), strict=True):
        draw_run(path, generate_run_log("jamia", lively), load_hand("jamia"), None, 0, "t")  # type: ignore[arg-type]
    assert paths[0].read_bytes() != paths[1].read_bytes()


def test_hidden_values_do_not_affect_the_height(drawn_figures: list[Any]) -> None:
    log = generate_run_log("jamia", True)
    log.mode[60:] = int(HandMode.DONE)
    log.fields["q"][:], log.fields["q_goal"][:] = 0.1, np.nan
    log.fields["q"][:60] = np.linspace(0.0, 0.5, 60)[:, None]
    log.fields["q"][90:] = -9.0
    draw_run(Path("x.png"), log, load_hand("jamia"), None, 0, "t")  # type: ignore[arg-type]
    low, high = drawn_figures[0].axes[0].get_ylim()
    assert -5.0 < low < 0.0
    assert np.degrees(0.5) < high < 35.0


@pytest.mark.parametrize("field", ["tension", "tension_goal", "truth"])
@pytest.mark.parametrize("hand_name", ["jamia", "n_plus_1"])
def test_all_tensions_are_inside_the_plot(
    drawn_figures: list[Any], hand_name: str, field: str
) -> None:
    """Reproduce a defect: without load-cell readings, commanded and true tension were outside of the plotted range."""
    hand = load_hand(hand_name)
    log, truth = generate_run_log(hand_name, True), zero_truth_record(hand, 120)
    for field_name in ("tension", "tension_goal", "tension_sigma"):
        log.fields[field_name][:] = 0.5
    if field == "truth":
        set_truth_column(truth, f"tension/{hand.tendon_names[-1]}", 60.0)
    else:
        log.fields[field][30:90, -1] = 60.0
    draw_run(Path("x.png"), log, hand, truth, 0, "t")  # type: ignore[arg-type]
    low, high = drawn_figures[0].axes[len(hand.digit)].get_ylim()
    assert low == -2.0
    assert high == pytest.approx(69.0)


@pytest.mark.parametrize(
    ("hand_name", "axis_labels"),
    [
        ("parallel_gripper", ["mean joint position [mm]", ""]),
        ("mixed_gripper", ["mean joint position [mm]", "mean joint angle [deg]"]),
    ],
)
def test_every_unit_of_the_digits_is_named(
    drawn_figures: list[Any], hand_name: str, axis_labels: list[str]
) -> None:
    """Reproduce a defect: the axis for the joint angle of a finger had no label.

    In a figure of a gripper with a jaw and a finger, only the axis for the position of the jaw had
    a label. The label for the jaw contained the unit mm, so readers could think that the angle of
    the finger was also in mm.
    """
    hand = load_hand(Path(__file__).parents[1] / "hand" / f"{hand_name}.toml")
    log = GeneratedRunLog(hand, 120, {0: "silent"})
    draw_run(Path("x.png"), log, hand, None, 0, "t")  # type: ignore[arg-type]
    assert [axes.get_ylabel() for axes in drawn_figures[0].axes[:2]] == axis_labels


@pytest.mark.parametrize("seed", range(5))
def test_names_of_phases_do_not_overlap_and_are_not_cut_off(seed: int) -> None:
    """Reproduce a defect: the texts "release" and "open" overlapped, and the end of the axis cut off the text "end"."""
    limits = (0.4, 9.4)
    mark_width = MARK_WIDTH_FRACTION * (limits[1] - limits[0])
    times = [0.65, 1.0, 3.0, 8.0, 8.1, 9.35, 9.39, 12.0]
    times += np.random.default_rng(seed).uniform(*limits, size=8).tolist()
    positions = _mark_positions(times, limits)
    assert positions[0] is not None
    assert positions[7] is None, "outside of the axis"
    shown_positions = [position for position in positions if position]
    assert len(shown_positions) >= 7
    for i, (left_edge, height) in enumerate(shown_positions):
        assert limits[0] <= left_edge <= limits[1] - mark_width + 1e-9
        for other_left_edge, other_height in shown_positions[:i]:
            assert height != other_height or abs(left_edge - other_left_edge) >= mark_width
