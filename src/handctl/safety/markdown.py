"""The fault table and the catalogue as pages, so that what README and docs promise is what the code does."""

from handctl.safety.catalogue import CATALOGUE, ON_HARDWARE, TABLE_, Entry
from handctl.safety.fault import Fault
from handctl.safety.table import TABLE

RATE_HZ = 500.0
"""Rate for which the catalogue gives times; that of the packaged hand with one motor a digit."""


def fault_table(table: tuple[Fault, ...] = TABLE) -> str:
    """The table in Markdown, a row a fault."""
    rows = [f"| {f.id} | {f.title} | {f.detection} | {f.action.name} | {f.clears} |" for f in table]
    return "\n".join(["| id | fault | noticed by | action | ended |", "|---|---|---|---|---|", *rows])


def catalogue(entries: tuple[Entry, ...] = CATALOGUE) -> str:
    """The catalogue in Markdown, with what each protocol can show."""
    head = "| id | fault | judged by | MIT | ODrive | CiA 402 | at the latest | tried by |"
    return "\n".join([head, "|---|---|---|---|---|---|---|---|", *map(_row, entries)])


def _row(entry: Entry) -> str:
    judged = ", ".join(f"{f.id} {f.action.name}" for f in TABLE if f.row == entry.id) or entry.where
    latest = f"{entry.latest_ms(RATE_HZ):g} ms, {round(entry.latest_ms(RATE_HZ) * RATE_HZ / 1e3)} ticks"
    latest = latest if entry.ticks or entry.ms else "before torque" if entry.where != TABLE_ else "1 tick"
    return (
        f"| {entry.id} | {entry.title} | {judged} | {entry.mit} | {entry.odrive} | {entry.cia402} | {latest} "
        f"| {entry.tried} |"
    )


def checklist() -> str:
    """What hardware has to show, in Markdown."""
    rows = [f"| {id_} | {text} |" for id_, text in ON_HARDWARE]
    return "\n".join(["| id | what to do |", "|---|---|", *rows])
