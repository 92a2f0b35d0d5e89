"""Markdown tables and sections for the documents, generated from the declarations of faults."""

from handctl.drives.motor_description import PROTOCOL_TRAITS, VERIFIABLE_PROTOCOLS
from handctl.safety.faults.fault import CHECKED_BY_FAULT_TABLE, CatalogueRow, Fault
from handctl.safety.faults.host import ON_HARDWARE
from handctl.safety.faults.table import FAULT_CATALOGUE, FAULT_TABLE

CATALOGUE_PERIOD_MS = 5.0
"""Control period that the project's fault catalogue assumes [ms]."""
CATALOGUE_RATE_HZ = 500.0
"""Control rate for which the catalogue states reaction times [Hz].

The packaged hand with one motor per digit has a control rate of 500 Hz.
"""


def fault_table_markdown(table: tuple[Fault, ...] = FAULT_TABLE) -> str:
    """Return the fault table as Markdown, with one row per fault."""
    title_lines = ["| id | fault | what happens | action | cleared |", "|---|---|---|---|---|"]
    rows = [
        f"| {f.id} | {f.title} | {f.detection} | {f.reaction_name} | {f.cleared_by} |"
        for f in table
    ]
    return "\n".join([*title_lines, *rows])


def fault_sections(table: tuple[Fault, ...] = FAULT_TABLE) -> str:
    """Return one Markdown section per fault, with its condition, causes, reaction and remedy."""
    return "\n\n".join(
        f"### {f.id}: {f.title}\n\n"
        f"- **What happened:** {f.detection}.\n"
        f"- **Why:** {f.cause}\n"
        f"- **Reaction:** {f.reaction_name}, cleared {f.cleared_by}.\n"
        f"- **What to do:** {f.remedy}"
        for f in table
    )


def catalogue_markdown(rows: tuple[CatalogueRow, ...] = FAULT_CATALOGUE) -> str:
    """Return the fault catalogue as Markdown.

    For each failure and each drive protocol, the table states how well handctl can see the failure.
    With some protocols, handctl detects the failure directly. With other protocols, handctl detects
    only a weaker sign of the failure (``replaced``), or cannot detect the failure (``lost``).
    """
    names = [PROTOCOL_TRAITS[protocol].title for protocol in VERIFIABLE_PROTOCOLS]
    columns = ["id", "fault", "judged by", *names, "latest reaction", "tested by"]
    return "\n".join(
        [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *map(_catalogue_row, rows)]
    )


def _catalogue_row(row: CatalogueRow) -> str:
    # The faults that belong to a row of the catalogue are the stages of the row. A row that the
    # controller does not check in each tick has no faults.
    condition_text = (
        ", ".join(f"{f.id} {f.action.name}" for f in FAULT_TABLE if f.row == row.id)
        or row.checked_by
    )
    latest_reaction_text = (
        f"{row.max_reaction_time_ms(CATALOGUE_RATE_HZ):g} ms, {_max_reaction_ticks(row)} ticks"
    )
    latest_reaction_text += (
        f", ODrive {row.odrive_extra_ms:g} ms more" if row.odrive_extra_ms else ""
    )
    latest_reaction_text += f", after {row.reaction_time_start}" if row.reaction_time_start else ""
    latest_reaction_text = (
        latest_reaction_text
        if row.ticks or row.ms
        else "before torque"
        if row.checked_by != CHECKED_BY_FAULT_TABLE
        else "1 tick"
    )
    return (
        f"| {row.id} | {row.title} | {condition_text} | {' | '.join(map(row.visibility, VERIFIABLE_PROTOCOLS))} | "
        f"{latest_reaction_text} "
        f"| {row.tested_by} |"
    )


def _max_reaction_ticks(row: CatalogueRow) -> int:
    return round(row.max_reaction_time_ms(CATALOGUE_RATE_HZ) * CATALOGUE_RATE_HZ / 1e3)


def reacts_too_late(row: CatalogueRow) -> bool:
    """Return True if the reaction to a failure can take more ticks than the project's fault catalogue requires.

    If the project's fault catalogue requires no reaction time for the failure, the result is False.
    """
    return 0 < row.required_ticks < _max_reaction_ticks(row)


def late_reactions_markdown(catalogue_rows: tuple[CatalogueRow, ...] = FAULT_CATALOGUE) -> str:
    """Return a Markdown table of the failures to which handctl can react later than required.

    The project's fault catalogue states the required reaction time of each failure. The table
    states the reason for each late reaction.
    """
    table_rows = [
        f"| {row.id} | {row.title} | {row.required_ticks} | {_max_reaction_ticks(row)} "
        f"| {row.required_ticks * CATALOGUE_PERIOD_MS:g} ms "
        f"| {row.max_reaction_time_ms(CATALOGUE_RATE_HZ):g} ms | {row.why} |"
        for row in catalogue_rows
        if reacts_too_late(row)
    ]
    title_line = "| id | fault | required, ticks | at 500 Hz, ticks | required | takes | why |"
    return "\n".join([title_line, "|---|---|---|---|---|---|---|", *table_rows])


def hardware_checklist() -> str:
    """Return the list of tests on hardware as Markdown."""
    rows = [f"| {id_} | {text} |" for id_, text in ON_HARDWARE]
    return "\n".join(["| id | what to do |", "|---|---|", *rows])
