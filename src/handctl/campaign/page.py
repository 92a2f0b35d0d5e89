"""A campaign as one HTML page that needs nothing else, and as a table for a terminal."""

import html
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from handctl.campaign.campaign import Report
from handctl.campaign.scenarios import LEFT_OUT
from handctl.campaign.trial import Result
from handctl.output import write_whole
from handctl.safety.faults.table import CATALOGUE

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; max-width: 1300px; margin: 2em auto;
       padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.1em; margin-top: 2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; font-size: .9em; } td, th { padding: .15em .8em .15em 0; text-align: left; }
td.n { text-align: right; font-variant-numeric: tabular-nums; } .bad { color: #b00020; font-weight: 600; }
.bar { display: inline-block; height: .7em; background: #3b6fb6; } .bar.bad { background: #b00020; }
"""
BAR_EM = 6.0
HEAD = ("row", "fault", "tried", "slowest scenario", "found by", "took", "ticks", "bound", "of that", "tension", "")
TITLES = {entry.id: entry.title for entry in CATALOGUE}


def write_page(path: Path, report: Report) -> None:
    """Write the page."""
    figures = report.plain()
    title = f"Fault campaign: {html.escape(report.hand)}"
    head = "".join(
        f"<tr><th>{html.escape(label)}</th><td class=n>{value}</td></tr>"
        for label, value in (
            ("scenarios", figures["scenarios"]),
            ("not as they must be", figures["late"]),
            ("not felt (no positive control)", figures["not_felt"]),
            ("slowest reaction [ticks]", figures["worst_ticks"]),
            ("slowest reaction, share of its bound", f"{figures['worst_share_of_bound']:.2f}"),
            ("largest true tension [N]", f"{figures['worst_tension_N']:.0f}"),
            ("false alarms of the undisturbed hand", figures["false_alarms"]),
            ("simulated undisturbed [s]", f"{figures['false_alarm_run_s']:g}"),
        )
    )
    parts = [f"<h1>{title}</h1><table>{head}</table>"]
    for protocol, results in report.results.items():
        rate, number = report.rates[protocol], Counter(result.id for result in results)
        title_ = f"{protocol}, {rate:g} Hz: each row by its slowest scenario"
        parts.append(f"<h2>{title_}</h2>{_table(_slowest(results), rate, number)}")
        bad = [result for result in results if not result.ok]
        if bad:
            parts.append(f"<h2 class=bad>{protocol}: not as they must be</h2>{_table(bad, rate, number)}")
    rows = "".join(f"<tr><td>{id_}</td><td>{html.escape(why)}</td></tr>" for id_, why in LEFT_OUT.items())
    parts.append(f"<h2>Rows that are tried elsewhere</h2><table>{rows}</table>")
    page = f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title><style>{STYLE}</style>"
    write_whole(path, page + "\n".join(parts) + "</html>\n")


def _slowest(results: Iterable[Result]) -> list[Result]:
    """Of each row the scenario that came closest to its bound."""
    slowest: dict[str, Result] = {}
    for result in results:
        known = slowest.get(result.id)
        if known is None or share(result) > share(known):
            slowest[result.id] = result
    return sorted(slowest.values(), key=lambda result: ("BNTHI".index(result.id[0]), result.id))


def share(result: Result) -> float:
    """Of its bound; more than all if it did not react."""
    return result.ticks / max(result.bound, 1) if result.ticks >= 0 else 9.9


def _table(results: Iterable[Result], rate: float, number: Counter[str]) -> str:
    head = "".join(f"<th>{name}" for name in HEAD)
    rows = "".join(_row(result, rate, number[result.id]) for result in results)
    return f"<table><tr>{head}</tr>{rows}</table>"


def _row(result: Result, rate: float, number: int) -> str:
    bad = "" if result.ok else " bad"
    width = BAR_EM * min(share(result), 1.0)
    scenario = result.scenario.removeprefix(result.id).strip()
    took = f"{result.ticks * 1e3 / rate:g} ms" if result.ticks >= 0 else "never"
    cells = [
        f"<td>{result.id}</td><td>{html.escape(TITLES[result.id])}</td><td class=n>{number}</td>",
        f"<td>{html.escape(scenario)}</td><td>{html.escape(result.found or 'asked for')}</td>",
        f"<td class=n>{took}</td><td class=n>{result.ticks}</td><td class=n>{result.bound}</td>",
        f'<td><span class="bar{bad}" style="width:{width:.2f}em"></span></td>',
        f"<td class=n>{result.tension:.0f} of {result.most:.0f} N</td><td class=bad>{html.escape(result.why)}</td>",
    ]
    return f"<tr>{''.join(cells)}</tr>"


def lines(report: Report) -> list[str]:
    """What a person wants to read at the end."""
    figures = report.plain()
    told = [
        f"{figures['scenarios']} scenarios, {figures['late']} not as they must be, {figures['not_felt']} not felt",
        f"slowest reaction {figures['worst_ticks']} ticks, {100 * figures['worst_share_of_bound']:.0f} % of its bound",
        f"largest true tension {figures['worst_tension_N']:.0f} N",
        f"{figures['false_alarms']} false alarms in {figures['false_alarm_run_s']:g} s without faults",
    ]
    return told + [f"{result.scenario}: {result.why}" for result in report.all_results if not result.ok]
