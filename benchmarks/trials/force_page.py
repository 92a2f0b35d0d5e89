"""Write the section on the force step of ``docs/evidence/control.md``."""

from typing import Any

from trials.control_page import markdown_table

COLUMN_BY_FIGURE = {
    "rmse_N": "RMSE [N]",
    "overshoot_N": "overshoot [N]",
    "settling_s": "settled within 2 N after [s]",
    "steady_N": "steady error [N]",
    "ripple_N": "ripple [N]",
}


def page_section(result: dict[str, Any]) -> str:
    """Convert a result of ``force_step.measure_force`` to the Markdown text of the section."""
    paragraphs = ["## A step of force", ""]
    paragraphs += [
        "`python benchmarks/control.py --parts force --page` writes this section. The digits hold a cylinder "
        "with 15 N per tendon. The command then steps to 40 N (limited to 5000 N/s) and back to 15 N. The "
        "error is the true tension at the load cell minus the command, during both steps. The table shows means "
        "over all seeds and all tendons whose digit touches the cylinder.",
        "",
        "In the row *set-point alone* there is no feedback: the motor makes the commanded force. The two rows"
        " with a loop use the same gains, which were not tuned for this test. *overshoot* is the largest "
        "distance by which the tension exceeds the command, noise included.",
    ]
    for hand, plants in result["hands"].items():
        rows = [_loop_row(loop_name, row) for loop_name, row in plants.get("as known", {}).items()]
        paragraphs += ["", markdown_table([hand, *COLUMN_BY_FIGURE.values(), "seeds"], rows)]
        other_plants = [plant for plant in plants if plant != "as known"]
        if other_plants:
            loop_names = list(plants["as known"])
            column_titles = [f"{hand}, wrong parameter, RMSE (steady error) [N]", *loop_names]
            paragraphs += [
                "",
                markdown_table(
                    column_titles,
                    [
                        [
                            plant,
                            *[_rmse_cell(plants[plant].get(loop_name)) for loop_name in loop_names],
                        ]
                        for plant in other_plants
                    ],
                ),
            ]
    return "\n".join([*paragraphs, "", _conclusion_text(result)])


def _loop_row(loop_name: str, row: dict[str, Any]) -> list[str]:
    cells = [f"{row[name]:.2f}" for name in COLUMN_BY_FIGURE]
    cells[0] += f" ± {row['rmse_spread_N']:.2f}"
    return [
        loop_name,
        *cells,
        f"{row['seeds']}" + (f", {row['ended']} ended early" if row["ended"] else ""),
    ]


def _rmse_cell(row: dict[str, Any] | None) -> str:
    return "-" if row is None else f"{row['rmse_N']:.2f} ({row['steady_N']:.2f})"


def _conclusion_text(result: dict[str, Any]) -> str:
    """Return the conclusion that the section on the force step draws from the numbers in a result."""
    texts = []
    for hand, plants in result["hands"].items():
        without_estimate, raw_row, estimate_row = plants["as known"].values()
        margin = raw_row["rmse_N"] - estimate_row["rmse_N"]
        rmse_sigma = max(raw_row["rmse_spread_N"], estimate_row["rmse_spread_N"])
        comparison_text = (
            "better than"
            if margin > 2 * rmse_sigma
            else "worse than"
            if margin < -2 * rmse_sigma
            else "no better than"
        )
        texts.append(
            f"{hand}: the loop on the estimate is {comparison_text} the loop on the raw sensor (RMSE "
            f"{estimate_row['rmse_N']:.2f} and "
            f"{raw_row['rmse_N']:.2f} N, spread {rmse_sigma:.2f} N). The error of the loop on the estimate is "
            f"{without_estimate['rmse_N'] / estimate_row['rmse_N']:.1f} "
            f"times smaller than without a loop. The loop on the estimate overshoots the step of 25 N by "
            f"{estimate_row['overshoot_N']:.1f} N, "
            f"and its steady error is {estimate_row['steady_N']:.2f} N. The ripple of this loop is "
            f"{estimate_row['ripple_N']:.2f} N, "
            f"compared with {raw_row['ripple_N']:.2f} N of the loop on the raw sensor."
        )
    end_reasons = sorted(
        {
            w
            for plants in result["hands"].values()
            for row_by_loop in plants.values()
            for r in row_by_loop.values()
            for w in r["why"]
        }
    )
    texts += [f"These faults ended runs early: {'; '.join(end_reasons)}."] if end_reasons else []
    texts.append(
        "A bias of the load cell is an error of the true tension as well, and no loop can remove this error."
    )
    return "\n\n".join(texts)
