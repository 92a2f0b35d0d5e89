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
TABLE_MARKS = "<!-- {}: written by benchmarks/grasp.py -->", "<!-- end of {} -->"


def tables_text(result: dict[str, Any]) -> str:
    """Return all tables as text."""
    return "\n\n".join(
        write(result[key]) for key, write in TABLE_FUNCTIONS.items() if result.get(key)
    )


def _markdown_table(column_titles: list[str], rows: list[list[str]]) -> str:
    lines = [
        "| " + " | ".join(row) + " |"
        for row in [column_titles, ["---"] * len(column_titles), *rows]
    ]
    return "\n".join(lines)


def _grouped_rows(
    rows: list[dict[str, Any]], *group_keys: str
) -> dict[tuple[str, ...], list[dict[str, Any]]]:
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in group_keys), []).append(row)
    return groups


def _success_table(rows: list[dict[str, Any]]) -> str:
    hands = list(dict.fromkeys(row["hand"] for row in rows))
    table = []
    for (grasp, thing), tried in _grouped_rows(rows, "grasp", "object").items():
        cells = []
        for hand in hands:
            selected = [row for row in tried if row["hand"] == hand]
            moved = [max(row["motion_mm"]) for row in selected if row["motion_mm"]]
            worst = f", {min(max(moved), 99.0):.1f} mm" if moved else ""
            cells.append(
                f"{sum(row['ok'] for row in selected)} of {len(selected)}{worst}"
                if selected
                else "-"
            )
        table.append([grasp, thing, *cells])
    totals = []
    for grasp in dict.fromkeys(row["grasp"] for row in rows):
        for hand in hands:
            selected = [row for row in rows if row["hand"] == hand and row["grasp"] == grasp]
            totals.append(
                f"{hand} {grasp} {100 * np.mean([row['ok'] for row in selected]):.0f} % of {len(selected)}"
            )
    failures = []
    for (hand, grasp, thing), failed_rows in _grouped_rows(
        [row for row in rows if row["why"]], "hand", "grasp", "object"
    ).items():
        by_reason = _grouped_rows(failed_rows, "why")
        reasons = [
            f"{reason} (seed {', '.join(str(row['seed']) for row in selected)})"
            for (reason,), selected in by_reason.items()
        ]
        failures.append(f"* {hand}, {grasp}, {thing}: {'; '.join(reasons)}")
    named = "\n\nFailed runs:\n\n" + "\n".join(failures) if failures else "\n\nNo failures."
    head = ["grasp", "object", *[f"{hand}: objects held, largest motion" for hand in hands]]
    fractions = f"Fraction of the runs in which the hand held the object: {'; '.join(totals)}."
    return f"{_markdown_table(head, table)}\n\n{fractions}{named}"


def _payload_table(rows: list[dict[str, Any]]) -> str:
    table = []
    for (hand, direction), selected in _grouped_rows(rows, "hand", "direction").items():
        masses = [row["mass_kg"] for row in selected]
        normal = np.mean([row["normal_N"] for row in selected], axis=0)
        over = "" if all(row["slid"] for row in selected) else "over "
        table.append([
            hand, direction, f"{over}{min(masses):.2f}", f"{np.mean(masses):.2f}", str(len(selected)),
            " / ".join(f"{value:.1f}" for value in normal), f"{np.mean([row['coulomb_kg'] for row in selected]):.2f}",
        ])  # fmt: skip
    head = ["hand", "load", "smallest payload, kg", "mean payload, kg", "seeds", "normal forces before the load, N",
            "friction x sum of the normal forces, kg"]  # fmt: skip
    paper = f"The paper states {payload.PAPER_PAYLOAD_KG} kg at 6 N per finger and friction 0.5."
    return f"{_markdown_table(head, table)}\n\n{paper}"


def _tip_force_table(rows: list[dict[str, Any]]) -> str:
    table = []
    for (hand, digit, command), selected in _grouped_rows(rows, "hand", "digit", "asked").items():
        true, estimated = (np.array([row[name] for row in selected]) for name in ("felt", "told"))
        error = estimated - true
        table.append([
            hand, digit, f"{command:g}", f"{true.mean():.2f} ± {true.std():.2f}", f"{estimated.mean():.2f}",
            f"{np.sqrt((error**2).mean()):.2f}", f"{np.mean([row['noise'] for row in selected]):.2f}",
            str(len(selected)),
        ])  # fmt: skip
    head = ["hand", "digit", "command, N", "true force, N", "estimate, N", "error of the estimate, RMS, N",
            "noise of the estimate, N", "runs"]  # fmt: skip
    return _markdown_table(head, table)


def _contact_table(rows: list[dict[str, Any]]) -> str:
    table = [
        [row["hand"], str(row["contacts"]), f"{100 * row['within_20_ms']:.0f} %", f"{100 * row['before_1_N']:.0f} %",
         f"{row['p95_ms']:.0f} ms", f"{row['worst_ms']:.0f} ms", f"{row['free_minutes']:.1f}", str(row["false_alarms"])]
        for row in rows
        if row["contacts"]
    ]  # fmt: skip
    head = [
        "hand",
        "contacts",
        "detected at most 20 ms after 1 N",
        "detected before 1 N",
        "delay of 95 % at most",
        "longest delay",
        "minutes of free motion",
        "false alarms",
    ]
    return _markdown_table(head, table)


def _slip_table(rows: list[dict[str, Any]]) -> str:
    table = []
    for (hand, answered), tried in _grouped_rows(rows, "hand", "answered").items():
        lost = [row["lost_at_N"] for row in tried if row["lost_at_N"] is not None]
        noticed = [row["first_event_mm"] for row in tried if row["first_event_mm"] is not None]
        table.append([
            hand, f"up to {slip_reaction.SLIP_LIMIT_N:g} N" if answered else "no",
            f"{len(lost)} of {len(tried)}" + (f", from {min(lost):.1f} N" if lost else ""),
            _range_text([min(row["motion_mm"], 99.0) for row in tried], 1),
            _range_text(noticed, 2) or "never",
            _range_text([row["tension_end_N"] for row in tried], 0),
        ])  # fmt: skip
    load = max(row["load_end_N"] for row in rows)
    head = [
        "hand",
        "tension raised",
        "object lost",
        f"motion at {load:.0f} N, mm",
        "motion at the first slip event, mm",
        "tension at the end, N",
    ]
    return _markdown_table(head, table)


def _range_text(values: list[float], decimals: int) -> str:
    """Format the range of values.

    If the smallest and the largest value have the same text, return only one of them.
    """
    ends = [f"{end:.{decimals}f}" for end in (min(values), max(values))] if values else []
    return " to ".join(dict.fromkeys(ends))


TABLE_FUNCTIONS = {
    "success": _success_table,
    "payload": _payload_table,
    "contact": _contact_table,
    "tip": _tip_force_table,
    "slip": _slip_table,
}
"""For each part of the benchmark, the function that writes its table."""


def write_page(result: dict[str, Any]) -> None:
    """Write each table of the result into the page, between its two marks.

    If the result contains grasps, also draw the picture.
    """
    page = PAGE_FILE.read_text("utf-8")
    for key, table in TABLE_FUNCTIONS.items():
        if result.get(key):
            start = TABLE_MARKS[0].format(key)
            end = TABLE_MARKS[1].format(key)
            before, _, rest = page.partition(start)
            _, _, after = rest.partition(end)
            page = f"{before}{start}\n{table(result[key])}\n{end}{after}"
    PAGE_FILE.write_text(page, "utf-8")
    if result.get("success"):
        draw_picture(result)


def draw_picture(result: dict[str, Any]) -> None:
    """Draw the largest motion of each object.

    Also draw the motion of the cylinder with and without the reaction to slip.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 5), width_ratios=(3, 2), layout="constrained"
    )
    names = list(dict.fromkeys(f"{row['grasp']}: {row['object']}" for row in result["success"]))
    for hand, marker, shift in (("jamia", "o", -0.15), ("jamia11", "s", 0.15)):
        rows = [row for row in result["success"] if row["hand"] == hand and row["motion_mm"]]
        x = [min(max(row["motion_mm"]), 50.0) for row in rows]
        y = [names.index(f"{row['grasp']}: {row['object']}") + shift for row in rows]
        left.scatter(x, y, marker=marker, s=22, label=hand, alpha=0.8)
        bad = [i for i, row in enumerate(rows) if not row["ok"]]
        left.scatter(
            [x[i] for i in bad], [y[i] for i in bad], marker="x", color="black", s=40, zorder=3
        )
    left.axvline(1e3 * MAX_OBJECT_MOTION_M, color="grey", ls="--")
    left.set(
        xscale="log", xlabel="largest motion in 5 s, of three orientations with a push of 1 N [mm]"
    )
    left.set_yticks(range(len(names)), names, fontsize=8)
    left.invert_yaxis()
    left.legend(title="x: no success", loc="upper right", fontsize=8)
    for row in result.get("slip", ()):
        if row["seed"] == 0:
            style = "-" if row["answered"] else ":"
            color = "C0" if row["hand"] == "jamia" else "C1"
            label = f"{row['hand']}, {'force raised on slip' if row['answered'] else 'no answer'}"
            right.plot(*row["curve"], style, color=color, label=label)
    right.set(xlabel="pull out of the palm [N]", ylabel="motion of the cylinder [mm]", ylim=(0, 12))
    right.legend(fontsize=8, loc="upper left")
    PICTURE_FILE.parent.mkdir(exist_ok=True)
    save_figure(figure, PICTURE_FILE)
    plt.close(figure)
