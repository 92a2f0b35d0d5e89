"""Write the section on tracking of ``docs/evidence/control.md``, and draw its picture."""

import numpy as np

from handctl.output_files import save_figure
from trials.control_page import FIGURES_FOLDER, markdown_table

RUN_ENDED_TEXT = "ended"
FAULT_TEXTS = {
    "N04": "with such soft weights, friction may stop a motor while its setpoint moves, which looks like a "
    "stuck encoder",
    "T02b": "a tendon stayed slack",
    "T01": "a tendon paid out without tension, which looks like a snapped tendon",
}
"""Explanation of each fault that ended runs of the benchmark."""
MIN_SHOWN_ERROR_DEG = 0.03
"""Smallest error on the logarithmic axis of the picture [deg]."""


def page_section(result: dict, compared_law_names: tuple[str, str, str, str]) -> str:
    """Convert a result of ``tracking.measure_tracking`` to the Markdown text of the section.

    Args:
        result: result of ``tracking.measure_tracking``.
        compared_law_names: names of four control laws: PD alone, springs and gravity, the complete law, and the
            misprinted equations.
    """
    paragraphs = ["## Tracking: benefit of each part of the control law", ""]
    paragraphs += [
        "`python benchmarks/control.py --parts tracking --page` writes this section. The benchmark moves "
        "every digit from 0 to 60 degrees and back at three speeds: slow (1.5 s), medium (0.5 s) and fast "
        "(0.15 s). Each row of a table adds one part to the control law of the row before. The error is the "
        "difference of the mean joint angle of a digit from its setpoint, measured in the plant.",
        "",
        "The columns *slow*, *medium* and *fast* have the root mean square error (RMSE) during the motion, "
        "with its spread over the seeds. The columns *peak*, *steady* and *settled* belong to the fast "
        "motion. A motion has settled when the error stays below one degree, and the time counts from the end"
        " of the motion. *ended* counts the runs that a fault or the controller ended early. All other "
        "columns contain only the remaining runs.",
        "",
        "Every control law, PD included, has two feedback weights. The benchmark tried the same sixteen pairs of "
        "weights with each control law. The table uses, for each control law, the pair with the smallest error in the "
        "fast motion. The pairs were compared on the nominal plant with another seed (`--tune`, results in "
        "`benchmarks/trials/tuned.json`).",
        "",
        "The best weights give the stiffest control loop that does not oscillate. On jamia, the weight of a position "
        "error of 0.02 mm then equals the weight of a force of 20 N. The control loop has a gain margin of only 2 dB "
        "and a phase margin of 15 degrees. The simulated plant tolerates such small margins and a real hand does "
        "not. With such stiff weights, feedback alone removes most of the error.",
        "",
        "Therefore a second table for each hand compares the control laws with other weights. With the "
        "other weights, the control loop keeps a gain margin of 6 dB and a phase margin of 45 degrees on random plants "
        "around the hand file. The packaged gains must keep the same margins. From the sixteen pairs of weights, the "
        "second table uses the best pair that keeps these margins. The plants with wrong parameters in the third "
        "table are run with these weights, too.",
    ]
    for hand, plants in result["hands"].items():
        rows_by_law = plants["as known"]
        paragraphs += [
            "",
            _laws_table(hand, rows_by_law),
            "",
            _conclusion_text(rows_by_law, compared_law_names),
        ]
        rows_with_margins = result["careful"].get(hand, {})
        if "as known" in rows_with_margins:
            nominal = rows_with_margins["as known"]
            heading = f"{hand}, weights that keep their margins"
            paragraphs += [
                "",
                _laws_table(heading, nominal),
                "",
                _comparison_of_laws(nominal, compared_law_names) + ".",
            ]
        if len(rows_with_margins) > 1:
            paragraphs += ["", _plant_mismatch_table(hand, rows_with_margins, compared_law_names)]
    paragraphs += [
        "",
        "![Tracking error at the fast motion, by law](../figures/control-tracking.png)",
    ]
    return "\n".join(paragraphs)


def _laws_table(title: str, rows_by_law: dict) -> str:
    """Return a Markdown table with a row for each control law."""
    speeds = list(next(iter(rows_by_law.values())))
    column_titles = [
        title,
        *[f"{speed} [deg]" for speed in speeds],
        "peak [deg]",
        "steady [deg]",
        "settled [s]",
        "seeds",
    ]
    rows = []
    for law, row in rows_by_law.items():
        fast_row = row["fast"]
        cells = [_rmse_cell(row[speed]) for speed in speeds]
        numbers = [_number_text(fast_row[k]) for k in ("peak_deg", "steady_deg", "settling_s")]
        rows.append([law, *cells, *numbers, str(fast_row["seeds"])])
    return markdown_table(column_titles, rows)


def _number_text(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else RUN_ENDED_TEXT


def _rmse_cell(row: dict[str, float]) -> str:
    is_finite = np.isfinite(row["rmse_deg"])
    spread_text = f" ± {row['rmse_spread_deg']:.3f}" if row["seeds"] > 1 else ""
    ended_text = f" ({row['ended']} of {row['seeds']} ended)" if row["ended"] else ""
    return f"{row['rmse_deg']:.3f}{spread_text}{ended_text}" if is_finite else RUN_ENDED_TEXT


def _conclusion_text(rows_by_law: dict, compared_law_names: tuple[str, str, str, str]) -> str:
    """Return the conclusion of the page's section on tracking, with the numbers of a benchmark result."""
    best_row, printed_row = (rows_by_law[name]["fast"] for name in compared_law_names[2:])
    return (
        f"{_comparison_of_laws(rows_by_law, compared_law_names)}. {_misprint_effect(printed_row, best_row)}\n\n"
        "Each entry is the error of "
        f"the row before minus the error of this row, at the fast motion, with the spread of the "
        f"difference:\n\n{_gain_by_law(rows_by_law)}"
    )


def _comparison_of_laws(rows_by_law: dict, compared_law_names: tuple[str, str, str, str]) -> str:
    """Compare the tracking error of the complete control law with the tracking errors of two other control laws.

    The complete control law is compared with PD without feedforward, and with PD whose feedforward
    contains only springs and gravity.
    """
    pd_row, springs_row, best = (rows_by_law[name]["fast"] for name in compared_law_names[:3])
    ratio = pd_row["rmse_deg"] / best["rmse_deg"]
    gain = springs_row["rmse_deg"] - best["rmse_deg"]
    error_sigma = max(best["rmse_spread_deg"], springs_row["rmse_spread_deg"])
    gain_text = (
        f"The error of the whole control law is {gain:.3f} deg smaller than with springs and gravity alone"
        + _error_reduction_text(gain, error_sigma, best["seeds"])
    )
    if not np.isfinite(gain):
        gain_text = "With springs and gravity alone, no run completes the motions"
    return f"{_comparison_with_pd(ratio)}. {gain_text}"


def _comparison_with_pd(ratio: float) -> str:
    """Return a text that compares the tracking error of the complete control law with the tracking error of PD."""
    if not np.isfinite(ratio):
        return "The motions follow each other, from slow to fast. With PD alone, no run completes the fast motion"
    return (
        f"At the fast motion, the error of the whole control law (row '+ force loop, estimate') is "
        f"{ratio:.1f} times smaller than that of PD alone"
    )


def _error_reduction_text(error_reduction: float, error_sigma: float, seed_count: int) -> str:
    """Return a text that states the ratio of ``error_reduction`` to the standard deviation ``error_sigma``.

    Both arguments are in degrees. The standard deviation of the tracking error is computed over the
    seeds of the benchmark runs. With a single seed, the text states that there is no standard
    deviation.
    """
    return (
        f", which is {error_reduction / max(error_sigma, 1e-9):.0f} times the spread"
        if seed_count > 1
        else " (one seed: no spread)"
    )


def _gain_by_law(rows_by_law: dict) -> str:
    """Return a text that states by how much each control law reduces the error of the preceding control law [deg].

    The change of the error differs between the seeds. The text states whether the mean change is
    larger than two standard deviations.
    """
    texts = []
    old_row = rows_by_law[next(iter(rows_by_law))]["fast"]
    for law in list(rows_by_law)[1:-1]:
        new_row = rows_by_law[law]["fast"]
        if not np.isfinite(new_row["rmse_deg"]):
            texts.append(
                f"'{law}': a fault ends {new_row['ended']} of {new_row['seeds']} runs ({'; '.join(new_row['why'])})"
            )
            continue
        ended_text = f", a fault ended {new_row['ended']} of {new_row['seeds']} runs ({'; '.join(new_row['why'])})"
        shown_text = ended_text if new_row["ended"] else ""
        if not np.isfinite(old_row["rmse_deg"]):
            error = f"an error of {new_row['rmse_deg']:.3f} deg"
            texts.append(f"'{law}': {error}. All runs of the rows before ended early{shown_text}")
            old_row = new_row
            continue
        gain = old_row["rmse_deg"] - new_row["rmse_deg"]
        error_sigma = float(np.hypot(old_row["rmse_spread_deg"], new_row["rmse_spread_deg"]))
        significance_text = (
            ""
            if gain > 2 * error_sigma
            else " (worse)"
            if gain < -2 * error_sigma
            else " (within the spread)"
        )
        texts.append(f"'{law}': {gain:+.3f} ± {error_sigma:.3f} deg{significance_text}{shown_text}")
        old_row = new_row
    return "\n".join(f"- {line}" for line in texts)


def _misprint_effect(misprinted_row: dict, best_row: dict) -> str:
    """Return a text that states by how much the misprinted equations raise the tracking error."""
    if not misprinted_row["ended"]:
        return (
            f"Eq. 10-12 as printed: {misprinted_row['rmse_deg'] / best_row['rmse_deg']:.1f} "
            "times the error of the correct ones."
        )
    reason = "; ".join(misprinted_row["why"])
    return (
        f"With Eq. 10-12 of the source paper as printed, "
        f"{misprinted_row['ended']} of {misprinted_row['seeds']} runs end "
        f"early: {reason}."
    )


def _plant_mismatch_table(
    hand_name: str, plants: dict, compared_law_names: tuple[str, str, str, str]
) -> str:
    """Return a Markdown table of tracking errors for simulated hands that differ from the controller's model."""
    speeds = list(plants["as known"][compared_law_names[2]])
    speed_columns = [f"{compared_law_names[2]}, {speed}" for speed in speeds]
    column_titles = [
        f"{hand_name}, RMSE [deg]",
        f"{compared_law_names[0]}, fast",
        f"{compared_law_names[1]}, fast",
        *speed_columns,
        "PD / whole control law",
        "seeds",
    ]
    rows = []
    for plant, rows_by_law in plants.items():
        if not all(name in rows_by_law for name in compared_law_names[:3]):
            continue
        pd_row, springs, best = (rows_by_law[name]["fast"] for name in compared_law_names[:3])
        rmse_cells = [_rmse_cell(rows_by_law[compared_law_names[2]][speed]) for speed in speeds]
        ratio = _number_text(pd_row["rmse_deg"] / best["rmse_deg"])
        rows.append(
            [plant, _rmse_cell(pd_row), _rmse_cell(springs), *rmse_cells, ratio, str(best["seeds"])]
        )
    return "\n".join(
        (
            markdown_table(column_titles, rows),
            "",
            _error_increase_text(plants, compared_law_names[2]),
            _end_reasons(plants),
        )
    )


def _error_increase_text(plants: dict, law_name: str) -> str:
    """List by how much each change of the simulated hand raises the tracking error of a control law.

    The tracking error is the root mean square error during the fast motion, the fastest of three
    test motions. The list begins with the change that raises the error most.
    """
    nominal = plants["as known"][law_name]["fast"]["rmse_deg"]
    error_rise_by_plant = {
        plant: rows_by_law[law_name]["fast"]["rmse_deg"] - nominal
        for plant, rows_by_law in plants.items()
        if law_name in rows_by_law
    }
    costly_plants = sorted(
        (plant for plant in error_rise_by_plant if plant != "as known"),
        key=lambda plant: -error_rise_by_plant[plant],
    )
    costs = ", ".join(f"{plant} {error_rise_by_plant[plant]:+.2f} deg" for plant in costly_plants)
    return f"Additional error of the whole control law at the fast motion, compared with the plant *as known*: {costs}."


def _end_reasons(plants: dict) -> str:
    """List for each control law the reasons why runs ended early."""
    texts: dict[str, set[str]] = {}
    for rows_by_law in plants.values():
        for law, speeds in rows_by_law.items():
            faults = {
                word
                for row in speeds.values()
                for reason in row["why"]
                for word in reason.split()
                if word in FAULT_TEXTS
            }
            texts.setdefault(law, set()).update(faults)
    return " ".join(
        f"Fault {fault} ended runs of '{law}': {FAULT_TEXTS[fault]}."
        for law, faults in texts.items()
        for fault in sorted(faults)
    )


def draw_picture(result: dict) -> None:
    """Draw the tracking errors of the fast motion as bars."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    hands = result["hands"]
    figure, axes = plt.subplots(
        1, len(hands), figsize=(5.8 * len(hands), 4.4), sharey=True, squeeze=False
    )
    for axis, (hand, plants) in zip(axes[0], hands.items(), strict=True):
        rows_by_law = plants["as known"]
        rows_with_margins = result["careful"].get(hand, {}).get("as known", {})
        bar_positions = np.arange(len(rows_by_law))
        for rows, shift, colour, label in (
            (rows_by_law, -0.2, "#4477aa", "best weights"),
            (rows_with_margins, 0.2, "#cc6677", "best weights that keep margins"),
        ):
            values = [
                (list(rows_by_law).index(law) + shift, row["fast"]) for law, row in rows.items()
            ]
            finite_rows = [
                (bar_position, row) for bar_position, row in values if np.isfinite(row["rmse_deg"])
            ]
            mean, error_sigma = (
                [row[key] for _, row in finite_rows] for key in ("rmse_deg", "rmse_spread_deg")
            )
            axis.barh(
                [p for p, _ in finite_rows],
                mean,
                0.38,
                xerr=error_sigma,
                color=colour,
                label=label,
                capsize=2,
            )
            for bar_position, row in values:
                value = row["rmse_deg"]
                text = f"{value:.2f}" if np.isfinite(value) else RUN_ENDED_TEXT
                end = value + row["rmse_spread_deg"] if np.isfinite(value) else MIN_SHOWN_ERROR_DEG
                axis.annotate(text, (end, bar_position), (4, -3),
                              textcoords="offset points", fontsize=8)  # fmt: skip
        axis.set_yticks(bar_positions, list(rows_by_law))
        axis.set_xscale("log")
        axis.set_xlim(MIN_SHOWN_ERROR_DEG, 30.0)
        axis.set_xlabel("RMSE, 0 to 60 deg in 0.15 s [deg]")
        axis.set_title(hand)
    axes[0][0].invert_yaxis()
    axes[0][-1].legend(fontsize=8, loc="lower right")
    figure.tight_layout()
    FIGURES_FOLDER.mkdir(exist_ok=True)
    save_figure(figure, FIGURES_FOLDER / "control-tracking.png")
