"""Write the section on the tension estimate of ``docs/evidence/control.md``, and draw its picture."""

import numpy as np

from handctl.output_files import save_figure
from trials.control_page import FIGURES_FOLDER, markdown_table

KEY_BY_COLUMN = {
    "at the sample: filter": "filtered",
    "load cell": "raw",
    "reference": "limit",
    "filter / reference": "filtered / limit",
    "filter / load cell": "filtered / raw",
    "at present: filter": "estimate",
    "load cell at present": "raw now",
    "average": "average",
    "cell alone": "cell alone",
    "reference at present": "limit now",
    "filter / reference at present": "estimate / limit now",
    "filter / load cell at present": "estimate / raw now",
    "NIS": "nis",
    "whiteness": "whiteness",
}
"""Dictionary from the heading of each table column to the key of the column's values in a result."""
FIGURE_LEGEND = (
    "In the figure, *raw* and *filtered* are the load cell and the filter at the sample. *raw now*, *reference now* "
    "and *estimate* (of the filter) are the values at present."
)
PLANT_MISMATCH_RATIOS = ("filtered / raw", "estimate / raw now")
MAX_ERROR_RATIO = 1.3
NIS_RANGE = (0.8, 1.3)


def page_section(result: dict) -> str:
    """Convert a result of ``estimation.measure_estimators`` to the Markdown text of the section."""
    paragraphs = ["## The tension estimate", ""]
    min_seed_count = min(result["seeds"].values())
    max_seed_count = max(result["seeds"].values())
    seeds = (
        max_seed_count
        if min_seed_count == max_seed_count
        else f"{min_seed_count} to {max_seed_count}"
    )
    paragraphs += [
        "`python benchmarks/estimation.py --page` writes this section. The error is the estimated "
        "minus the true tension at the load cell. All numbers are root mean square "
        "errors (RMSE) "
        f"in newtons over all tendons, unless the column is a ratio. Seeds: {seeds}. A sample of the load cell "
        f"is one "
        "control period old when the controller uses it (2 ms on jamia, 5 ms on jamia11).",
        "",
        "- *at the sample*: errors at the instant of the sample. The estimate of the filter for this instant is "
        "compared with the reading of the load cell.",
        "- *at present*: errors at the instant at which the control loop needs the tension. The filter predicts the "
        "tension at this instant. The reading of the load cell, which is one period old, is used as it is.",
        "- *average*: the best exponential average of the load cell, at present. *cell alone*: the best filter that "
        "uses only the load cell, at present. For each regime, the average and the "
        "filter with the smallest error were chosen after the measurement.",
        "- *reference*: the error of a filter that is optimal for a fixed noise model (motor 10 mN m, joint 5 mN m, "
        "unknown offset, drift of the load cell). The reference is no lower bound. Where a digit moves freely the "
        "simulated hand has less noise than this model, and the filter of the controller also knows the "
        "planned change "
        "of tension. The error of the filter can therefore be smaller than the reference.",
        "- *NIS*: normalized innovation squared per degree of freedom. NIS is 1 if the noise model is right.",
        "- *whiteness*: correlation of consecutive innovations. The correlation is 0 if the model is right.",
    ]
    for hand, plants in result["hands"].items():
        rows = [
            [regime, *(f"{row[c]:.2f}" for c in KEY_BY_COLUMN.values())]
            for regime, row in plants["as known"].items()
        ]
        paragraphs += ["", markdown_table([hand, *KEY_BY_COLUMN], rows)]
        other_plants = [plant for plant in plants if plant != "as known"]
        if other_plants:
            regimes = [
                r
                for r in ("free", "reversal", "impact", "hold", "slack")
                if r in plants["as known"]
            ]
            columns = [
                f"{regime}: error at present, ratios at the sample and at present"
                for regime in regimes
            ]
            column_titles = [f"{hand}, wrong parameter", *columns, "NIS free", "NIS hold"]
            paragraphs += [
                "",
                markdown_table(
                    column_titles,
                    [_plant_mismatch_row(plant, plants[plant], regimes) for plant in other_plants],
                ),
            ]
    paragraphs += [
        "",
        _conclusion_text(result),
        "",
        FIGURE_LEGEND,
        "",
        "![Tension errors by regime](../figures/control-estimation.png)",
    ]
    return "\n".join(paragraphs)


def _plant_mismatch_row(plant_name: str, regimes_table: dict, regimes: list[str]) -> list[str]:
    cells = [
        f"{row['estimate']:.2f} N, {' and '.join(f'{row[ratio]:.2f}' for ratio in PLANT_MISMATCH_RATIOS)}"
        for row in (regimes_table[regime] for regime in regimes)
    ]
    return [
        plant_name,
        *cells,
        f"{regimes_table['free']['nis']:.2f}",
        f"{regimes_table['hold']['nis']:.2f}",
    ]


def _conclusion_text(result: dict) -> str:
    """Return the conclusion that the section on the tension estimate draws from the numbers in a result."""
    passing_cases = []
    failing_cases = []
    prediction_ratios = []
    for hand, plants in result["hands"].items():
        for regime in [regime for regime in ("free", "hold") if regime in plants["as known"]]:
            row = plants["as known"][regime]
            ratio = row["filtered / limit"]
            nis = row["nis"]
            is_within_limits = ratio <= MAX_ERROR_RATIO and NIS_RANGE[0] <= nis <= NIS_RANGE[1]
            (passing_cases if is_within_limits else failing_cases).append(
                f"{hand} {regime}: {ratio:.2f} times the reference, NIS {nis:.2f}"
            )
            prediction_ratios.append(f"{hand} {regime}: {row['estimate / limit']:.2f}")
    text = (
        f"At the sample, the error of the filter must be at most {MAX_ERROR_RATIO} times the reference, and NIS must "
        f"be between "
        f"{NIS_RANGE[0]} and {NIS_RANGE[1]}. "
    )
    text += f"Cases that meet both requirements: {'; '.join(passing_cases) or 'none'}. "
    text += f"Cases that miss one of them: {'; '.join(failing_cases)}. " if failing_cases else ""
    text += (
        "\n\nA stricter comparison divides the error of the prediction for the present by the reference at the "
        "sample, "
        f"although the two errors belong to different instants. The ratios are: {', '.join(prediction_ratios)}. "
    )
    raw_text = "\n".join(
        f"- {_regimes_where_load_cell_is_better(result, ratio)}" for ratio in INSTANT_TEXT_BY_RATIO
    )
    heading = "Comparison of the filter with the load cell alone:"
    paragraphs = (text.strip(), heading, raw_text, _plant_mismatch_text(result), *EXPLANATION_TEXTS)
    return "\n\n".join(paragraph for paragraph in paragraphs if paragraph)


EXPLANATION_TEXTS = (
    "The prediction of the filter and the reading of the load cell come from the same sample, which is one "
    "period old. "
    "Prediction and reading are compared with the true tension at present, because a control loop without a filter "
    "would use the old "
    "reading as it is. While NIS shows that the model does not fit, the filter gives its model less weight "
    "(`innovation.py`, `caution`).",
    "When a tendon reverses its motion, the friction changes sign and the tension changes by twice the friction. The "
    "filter predicts this change from the speed of the tendon. When a digit hits an object (regime *impact*), "
    "the first "
    "two samples after the impact determine the error, and every filter that averages samples is late. "
    "jamia11 gains "
    "least from the filter in this regime.",
    "While a tendon is taut, no measurement distinguishes an error of the load cell from tension. A bias of the load "
    "cell is therefore an error of the estimate as well, and can be detected only while the tendon is slack. "
    "The parameters "
    "of the columns *average* and *cell alone* were chosen for each regime after the measurement. In a few regimes, "
    "*average* or *cell alone* therefore has a smaller error than the filter.",
)
INSTANT_TEXT_BY_RATIO = {
    "filtered / raw": "At the sample",
    "estimate / raw now": "At present",
    "estimate / raw": "When the filter is judged at present and the load cell at the sample,",
}


def _regimes_where_load_cell_is_better(result: dict, ratio_name: str) -> str:
    """List the tendon regimes in which the raw load cell is better than the filter.

    The list covers the nominal hand, and hands whose tendon stiffness differs from the hand file.
    """
    rows = [
        (row[ratio_name], f"{hand} {regime}, {plant}")
        for hand, plants in result["hands"].items()
        for plant, rows_by_regime in plants.items()
        if plant == "as known" or plant.startswith("stiffness")
        for regime, row in rows_by_regime.items()
    ]
    worse_cases = [f"{name} ({value:.2f})" for value, name in rows if value > 1.0]
    worst_ratio, name = max(rows)
    if not worse_cases:
        return (
            f"{INSTANT_TEXT_BY_RATIO[ratio_name]} the filter is never worse than the load cell, even if the "
            f"stiffness in the hand file is wrong "
            f"by 50 %. The largest ratio of the errors is {worst_ratio:.2f} ({name})."
        )
    return (
        f"{INSTANT_TEXT_BY_RATIO[ratio_name]} the filter is worse than the load cell"
        " in these cases (ratio of the errors): "
        f"{'; '.join(worse_cases)}."
    )


def _plant_mismatch_text(result: dict) -> str:
    """List the tendon regimes in which the raw load cell is better than the filter.

    The list covers hands in which a parameter other than the tendon stiffness differs from the hand
    file.
    """
    rows = [
        (row["estimate / raw now"], row["nis"], f"{hand} {regime}, {plant}")
        for hand, plants in result["hands"].items()
        for plant, rows_by_regime in plants.items()
        if plant != "as known" and not plant.startswith("stiffness")
        for regime, row in rows_by_regime.items()
    ]
    if not rows:
        return ""
    worse_cases = [f"{name} ({value:.2f})" for value, _, name in rows if value > 1.0]
    nis, name = max((nis, name) for _, nis, name in rows)
    if not worse_cases:
        return (
            "With a wrong mass, a wrong friction or a bias of the load cell, the filter at present is never "
            "worse than the load cell."
        )
    return (
        "With other wrong parameters, the filter at present is worse than the load cell in: "
        f"{'; '.join(worse_cases)}. "
        f"The innovations show this (the largest NIS is {nis:.2f}, {name}), and `handctl identify` measures "
        f"the friction "
        "within some per cent."
    )


def draw_picture(result: dict) -> None:
    """Draw the errors of the estimators as bars, by tendon regime."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    hands = result["hands"]
    figure, axes = plt.subplots(
        1, len(hands), figsize=(4.6 * len(hands), 3.4), sharey=True, squeeze=False
    )
    value_by_filter = {
        "raw": "#dddddd",
        "filtered": "#88aadd",
        "raw now": "#bbbbbb",
        "average": "#ccbb44",
        "cell alone": "#66ccee",
        "estimate": "#4477aa",
    }
    for axis, (hand, plants) in zip(axes[0], hands.items(), strict=True):
        regimes_table = plants["as known"]
        bar_positions = np.arange(len(regimes_table))
        for i, (estimator, colour) in enumerate(value_by_filter.items()):
            values = [row[estimator] for row in regimes_table.values()]
            axis.bar(bar_positions + 0.14 * (i - 2.5), values, 0.14, color=colour, label=estimator)
        for key, style, bar_offset in (("limit", "-", -0.28), ("limit now", ":", 0.14)):
            limits = [row[key] for row in regimes_table.values()]
            name = key.replace("limit", "reference")
            axis.hlines(
                limits,
                bar_positions + bar_offset - 0.16,
                bar_positions + bar_offset + 0.3,
                "#222222",
                style,
                label=name,
            )
        axis.set_xticks(bar_positions, list(regimes_table), rotation=20)
        axis.set_title(hand)
    axes[0][0].set_ylabel("RMSE of tension [N]")
    axes[0][-1].legend(fontsize=8, loc="upper left", ncols=2)
    axes[0][0].set_ylim(top=0.9)
    figure.tight_layout()
    FIGURES_FOLDER.mkdir(exist_ok=True)
    save_figure(figure, FIGURES_FOLDER / "control-estimation.png")
