"""The fault table as a page, so that what the README promises is what the code does."""

from handctl.safety.fault import Fault
from handctl.safety.table import TABLE


def fault_table(table: tuple[Fault, ...] = TABLE) -> str:
    """The table in Markdown, a row a fault."""
    rows = [f"| {f.id} | {f.title} | {f.detection} | {f.action.name} | {f.clears} |" for f in table]
    return "\n".join(["| id | fault | noticed by | action | ended |", "|---|---|---|---|---|", *rows])
