"""Write the results of `handctl demo` as a table into the README and the documentation site.

In a page, the table is between two marks that name the command.
"""

import math
import re
from pathlib import Path
from typing import Any

from tools.figures import runs

TABLE_PATTERN = re.compile(
    r"(<!-- measured: handctl demo --lockstep -->\n)(.*?)(<!-- end of measured -->)", re.DOTALL
)
"""Pattern of the two marks in a page, with the table of results between the marks."""


def numbers_table(demo_result: dict[str, Any]) -> str:
    """Return the Markdown table for a result that ``handctl demo --lockstep --json`` has printed."""
    rows = "\n".join(f"| {name} | {value} |" for name, value in rows_of_result(demo_result))
    return f"| `handctl demo --lockstep` prints, among others | |\n|---|---|\n{rows}\n"


def rows_of_result(demo_result: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the table: the name and the value of each result."""
    errors_deg = [angle["error_deg"] for angle in demo_result["joint_angles"].values()]
    tracking = math.degrees(demo_result["tracking_rmse_rad"])
    return [
        ("ticks, missed", f"{demo_result['ticks']} at {demo_result['rate_hz']:g} Hz, {demo_result['missed']}"),
        ("tracking error in free motion, against the plant", f"{tracking:.2f} deg rms"),
        ("tension against the plant: estimate, raw load cell",
         f"{demo_result['tension_rmse_n']:.2f} N, {demo_result['tension_raw_rmse_n']:.2f} N rms"),
        ("true tension against the command while holding", f"{demo_result['tension_hold_error_n']:.2f} N"),
        ("object moved while the table sank by "
         f"{demo_result['table_sunk_mm']:.0f} mm", f"{demo_result['object_slid_mm']:.1f} mm"),
        ("assumed joint angles of a held digit, error", f"{min(errors_deg):.1f} to {max(errors_deg):.1f} deg rms"),
    ]  # fmt: skip


def write_numbers(root: Path, folder: Path) -> None:
    """Write the table of results into every page that contains its two marks."""
    _, _, result = runs.grasp_run(folder)
    for path in (root / "README.md", *sorted((root / "docs").rglob("*.md"))):
        text = path.read_text(encoding="utf-8")
        new_text = TABLE_PATTERN.sub(
            lambda match: f"{match[1]}{numbers_table(result)}{match[3]}", text
        )
        if new_text != text:
            path.write_text(new_text, encoding="utf-8")
