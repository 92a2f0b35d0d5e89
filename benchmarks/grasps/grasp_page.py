"""Write the results of the grasp benchmark as text, Markdown page and picture."""

from pathlib import Path
from typing import Any

import numpy as np

from grasps import payload, slip_reaction
from grasps.grasp_objects import MAX_OBJECT_MOTION_M
from handctl.output_files import save_figure

DOCS_FOLDER = Path(__file__).parents[2] / "docs"
PAGE_FILE = DOCS_FOLDER / "evidence" / "control-grasps.md"
PICTURE_FILE = DOCS_FOLDER / "figures" / "grasps.png"
TABLE_COMMENT_TEMPLATES = "<!-- {}: written by benchmarks/grasp.py -->", "<!-- end of {} -->"


def tables_text(result: dict[str, Any]) -> str:
    """Return all tables as text."""
    return "\n\n".join(
        write(result[key]) for key, write in TABLE_FUNCTION_BY_KEY.items() if result.get(key)
    )


def _markdown_table(column_titles: list[str], rows: list[list[str]]) -> str:
    lines = [
        "| " + " | ".join(row) + " |"
        for row in [column_titles, ["---"] * len(column_titles), *rows]
    ]
    return "\n".join(lines)


def _group_rows(
    rows: list[dict[str, Any]], *group_keys: str
) -> dict[tuple[str, ...], list[dict[str, Any]]]:
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in group_keys), []).append(row)
    return groups


def _success_table(rows: list[dict[str, Any]]) -> str:
    hands = list(dict.fromkeys(row["hand"] for row in rows))
    table = []
    for (grasp, grasped_object), trial_rows in _group_rows(rows, "grasp", "object").items():
        cells = []
        for hand in hands:
            hand_rows = [row for row in trial_rows if row["hand"] == hand]
            largest_motions_mm = [max(row["motion_mm"]) for row in hand_rows if row["motion_mm"]]
            largest_motion_text = (
                f", {min(max(largest_motions_mm), 99.0):.1f} mm" if largest_motions_mm else ""
            )
            cells.append(
                f"{sum(row['ok'] for row in hand_rows)} of {len(hand_rows)}{largest_motion_text}"
                if hand_rows
                else "-"
            )
        table.append([grasp, grasped_object, *cells])
    total_row = []
    for grasp in dict.fromkeys(row["grasp"] for row in rows):
        for hand in hands:
            hand_rows = [row for row in rows if row["hand"] == hand and row["grasp"] == grasp]
            total_row.append(
                f"{hand} {grasp} {100 * np.mean([row['ok'] for row in hand_rows]):.0f} % of {len(hand_rows)}"
            )
    failures = []
    for (hand, grasp, grasped_object), failed_rows in _group_rows(
        [row for row in rows if row["why"]], "hand", "grasp", "object"
    ).items():
        rows_by_reason = _group_rows(failed_rows, "why")
        reasons = [
            f"{reason} (seed {', '.join(str(row['seed']) for row in selected)})"
            for (reason,), selected in rows_by_reason.items()
        ]
        failures.append(f"* {hand}, {grasp}, {grasped_object}: {'; '.join(reasons)}")
    failures_text = "\n\nFailed runs:\n\n" + "\n".join(failures) if failures else "\n\nNo failures."
    column_titles = [
        "grasp",
        "object",
        *[f"{hand}: objects held, largest motion" for hand in hands],
    ]
    fractions = f"Fraction of the runs in which the hand held the object: {'; '.join(total_row)}."
    return f"{_markdown_table(column_titles, table)}\n\n{fractions}{failures_text}"


def _payload_table(rows: list[dict[str, Any]]) -> str:
    table = []
    for (hand, direction), group_rows in _group_rows(rows, "hand", "direction").items():
        masses = [row["mass_kg"] for row in group_rows]
        mean_normal_forces = np.mean([row["normal_N"] for row in group_rows], axis=0)
        prefix_text = "" if all(row["slid"] for row in group_rows) else "over "
        table.append([
            hand, direction, f"{prefix_text}{min(masses):.2f}", f"{np.mean(masses):.2f}", str(len(group_rows)),
            " / ".join(f"{value:.1f}" for value in mean_normal_forces),
            f"{np.mean([row['coulomb_kg'] for row in group_rows]):.2f}",
        ])  # fmt: skip
    column_titles = ["hand", "load", "smallest payload, kg", "mean payload, kg", "seeds",
    "normal forces before the load, N",
            "friction x sum of the normal forces, kg"]  # fmt: skip
    paper_statement = (
        f"The paper states {payload.PAPER_PAYLOAD_KG} kg at 6 N per finger and friction 0.5."
    )
    return f"{_markdown_table(column_titles, table)}\n\n{paper_statement}"


def _tip_force_table(rows: list[dict[str, Any]]) -> str:
    table = []
    for (hand, digit, command), group_rows in _group_rows(rows, "hand", "digit", "asked").items():
        true_force, estimated = (
            np.array([row[name] for row in group_rows]) for name in ("felt", "told")
        )
        error = estimated - true_force
        table.append([
            hand, digit, f"{command:g}", f"{true_force.mean():.2f} ± {true_force.std():.2f}", f"{estimated.mean():.2f}",
            f"{np.sqrt((error**2).mean()):.2f}", f"{np.mean([row['noise'] for row in group_rows]):.2f}",
            str(len(group_rows)),
        ])  # fmt: skip
    column_titles = ["hand", "digit", "command, N", "true force, N", "estimate, N", "error of the estimate, RMS, N",
            "noise of the estimate, N", "runs"]  # fmt: skip
    return _markdown_table(column_titles, table)


def _contact_table(rows: list[dict[str, Any]]) -> str:
    table = [
        [row["hand"], str(row["contacts"]), f"{100 * row['within_20_ms']:.0f} %", f"{100 * row['before_1_N']:.0f} %",
         f"{row['p95_ms']:.0f} ms", f"{row['worst_ms']:.0f} ms", f"{row['free_minutes']:.1f}", str(row["false_alarms"])]
        for row in rows
        if row["contacts"]
    ]  # fmt: skip
    column_titles = [
        "hand",
        "contacts",
        "detected at most 20 ms after 1 N",
        "detected before 1 N",
        "delay of 95 % at most",
        "longest delay",
        "minutes of free motion",
        "false alarms",
    ]
    return _markdown_table(column_titles, table)


def _slip_table(rows: list[dict[str, Any]]) -> str:
    table = []
    for (hand, has_slip_reaction), trial_rows in _group_rows(rows, "hand", "answered").items():
        loss_forces = [row["lost_at_N"] for row in trial_rows if row["lost_at_N"] is not None]
        detection_motions_mm = [
            row["first_event_mm"] for row in trial_rows if row["first_event_mm"] is not None
        ]
        table.append([
            hand, f"up to {slip_reaction.SLIP_LIMIT_N:g} N" if has_slip_reaction else "no",
            f"{len(loss_forces)} of {len(trial_rows)}" + (f", from {min(loss_forces):.1f} N" if loss_forces else ""),
            _range_text([min(row["motion_mm"], 99.0) for row in trial_rows], 1),
            _range_text(detection_motions_mm, 2) or "never",
            _range_text([row["tension_end_N"] for row in trial_rows], 0),
        ])  # fmt: skip
    load = max(row["load_end_N"] for row in rows)
    column_titles = [
        "hand",
        "tension raised",
        "object lost",
        f"motion at {load:.0f} N, mm",
        "motion at the first slip event, mm",
        "tension at the end, N",
    ]
    return _markdown_table(column_titles, table)


def _range_text(values: list[float], decimals: int) -> str:
    """Format the range of values.

    If the smallest and the largest value are equal after rounding, return only one of the two
    values.
    """
    limit_texts = [f"{end:.{decimals}f}" for end in (min(values), max(values))] if values else []
    return " to ".join(dict.fromkeys(limit_texts))


TABLE_FUNCTION_BY_KEY = {
    "success": _success_table,
    "payload": _payload_table,
    "contact": _contact_table,
    "tip": _tip_force_table,
    "slip": _slip_table,
}
"""For each part of the benchmark, the function that writes its table."""


def write_page(result: dict[str, Any]) -> None:
    """Write the tables of the result into the page.

    In the page, each table is between two comments that name the table.

    If the result has the results of grasps (``success``), also call ``draw_picture``.
    """
    page = PAGE_FILE.read_text("utf-8")
    for key, table in TABLE_FUNCTION_BY_KEY.items():
        if result.get(key):
            start = TABLE_COMMENT_TEMPLATES[0].format(key)
            end = TABLE_COMMENT_TEMPLATES[1].format(key)
            page_start, _, page_rest = page.partition(start)
            _, _, page_end = page_rest.partition(end)
            page = f"{page_start}{start}\n{table(result[key])}\n{end}{page_end}"
    PAGE_FILE.write_text(page, "utf-8")
    if result.get("success"):
        draw_picture(result)


def draw_picture(result: dict[str, Any]) -> None:
    """Draw the largest motion of each object.

    In a second diagram, draw the motion of the cylinder with and without the reaction to slip.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left_axes, right_axes) = plt.subplots(
        1, 2, figsize=(11, 5), width_ratios=(3, 2), layout="constrained"
    )
    names = list(dict.fromkeys(f"{row['grasp']}: {row['object']}" for row in result["success"]))
    for hand, marker, shift in (("jamia", "o", -0.15), ("jamia11", "s", 0.15)):
        rows = [row for row in result["success"] if row["hand"] == hand and row["motion_mm"]]
        x = [min(max(row["motion_mm"]), 50.0) for row in rows]
        y = [names.index(f"{row['grasp']}: {row['object']}") + shift for row in rows]
        left_axes.scatter(x, y, marker=marker, s=22, label=hand, alpha=0.8)
        failed_rows = [i for i, row in enumerate(rows) if not row["ok"]]
        left_axes.scatter(
            [x[i] for i in failed_rows],
            [y[i] for i in failed_rows],
            marker="x",
            color="black",
            s=40,
            zorder=3,
        )
    left_axes.axvline(1e3 * MAX_OBJECT_MOTION_M, color="grey", ls="--")
    left_axes.set(
        xscale="log", xlabel="largest motion in 5 s, of three orientations with a push of 1 N [mm]"
    )
    left_axes.set_yticks(range(len(names)), names, fontsize=8)
    left_axes.invert_yaxis()
    left_axes.legend(title="x: no success", loc="upper right", fontsize=8)
    for row in result.get("slip", ()):
        if row["seed"] == 0:
            style = "-" if row["answered"] else ":"
            line_colour = "C0" if row["hand"] == "jamia" else "C1"
            label = f"{row['hand']}, {'force raised on slip' if row['answered'] else 'no answer'}"
            right_axes.plot(*row["curve"], style, color=line_colour, label=label)
    right_axes.set(
        xlabel="pull out of the palm [N]", ylabel="motion of the cylinder [mm]", ylim=(0, 12)
    )
    right_axes.legend(fontsize=8, loc="upper left")
    PICTURE_FILE.parent.mkdir(exist_ok=True)
    save_figure(figure, PICTURE_FILE)
    plt.close(figure)
