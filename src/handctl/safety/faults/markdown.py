"""The fault table and the catalogue as pages, so that what README and docs promise is what the code does."""

from handctl.safety.faults.fault import TICK, Fault, Row
from handctl.safety.faults.host import ON_HARDWARE
from handctl.safety.faults.table import CATALOGUE, TABLE

ASKED_MS = 5.0
"""A tick of the ideal drive for which the project's fault catalogue is written."""
RATE_HZ = 500.0
"""Rate for which the catalogue gives times; that of the packaged hand with one motor a digit."""


def fault_table(table: tuple[Fault, ...] = TABLE) -> str:
    """The table in Markdown, a row a fault."""
    rows = [f"| {f.id} | {f.title} | {f.detection} | {f.reaction} | {f.clears} |" for f in table]
    return "\n".join(["| id | fault | noticed by | action | ended |", "|---|---|---|---|---|", *rows])


def catalogue(entries: tuple[Row, ...] = CATALOGUE) -> str:
    """The catalogue in Markdown, with what each protocol can show."""
    head = "| id | fault | judged by | MIT | ODrive | CiA 402 | at the latest | tried by |"
    return "\n".join([head, "|---|---|---|---|---|---|---|---|", *map(_row, entries)])


def _row(entry: Row) -> str:
    judged = ", ".join(f"{f.id} {f.action.name}" for f in TABLE if f.row == entry.id) or entry.where
    latest = f"{entry.latest_ms(RATE_HZ):g} ms, {_ticks(entry)} ticks"
    latest += f"; ODrive {entry.odrive_ms:g} ms more" if entry.odrive_ms else ""
    latest = latest if entry.ticks or entry.ms else "before torque" if entry.where != TICK else "1 tick"
    return (
        f"| {entry.id} | {entry.title} | {judged} | {entry.mit} | {entry.odrive} | {entry.cia402} | {latest} "
        f"| {entry.tried} |"
    )


def _ticks(entry: Row) -> int:
    return round(entry.latest_ms(RATE_HZ) * RATE_HZ / 1e3)


def late(entry: Row) -> bool:
    """Whether a row takes more ticks than the project's fault catalogue gives it; never if it gives none."""
    return 0 < entry.asked < _ticks(entry)


def later(entries: tuple[Row, ...] = CATALOGUE) -> str:
    """Rows that take more ticks than were asked for, and why, in Markdown."""
    rows = [
        f"| {e.id} | {e.title} | {e.asked} | {_ticks(e)} | {e.asked * ASKED_MS:g} ms | {e.latest_ms(RATE_HZ):g} ms "
        f"| {e.why} |"
        for e in entries
        if late(e)
    ]
    head = "| id | fault | asked, ticks | at 500 Hz, ticks | asked | takes | why |"
    return "\n".join([head, "|---|---|---|---|---|---|---|", *rows])


def checklist() -> str:
    """What hardware has to show, in Markdown."""
    rows = [f"| {id_} | {text} |" for id_, text in ON_HARDWARE]
    return "\n".join(["| id | what to do |", "|---|---|", *rows])
