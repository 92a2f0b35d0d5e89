"""Output of a campaign's report as an HTML page in a single file, and as lines for a terminal."""

import html
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from handctl.campaign.campaign import CampaignReport
from handctl.campaign.fault_matrix import TEST_PLACE_BY_UNTESTED_FAULT
from handctl.campaign.scenario_run import ScenarioResult
from handctl.output_files import write_text_atomically
from handctl.safety.faults.table import FAULT_CATALOGUE

PAGE_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; max-width: 1300px; margin: 2em auto;
       padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.1em; margin-top: 2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; font-size: .9em; } td, th { padding: .15em .8em .15em 0; text-align: left; }
td.n { text-align: right; font-variant-numeric: tabular-nums; } .bad { color: #b00020; font-weight: 600; }
.bar { display: inline-block; height: .7em; background: #3b6fb6; } .bar.bad { background: #b00020; }
"""
BAR_WIDTH_EM = 6.0
"""Width of a bar that stands for the largest allowed reaction time [em]."""
TABLE_TITLES = (
    "row",
    "fault",
    "tried",
    "slowest scenario",
    "detected by",
    "time",
    "ticks",
    "bound",
    "fraction",
    "tension",
    "",
)
"""Titles of the columns in the table of scenarios."""
TITLE_BY_FAULT_ID = {entry.id: entry.title for entry in FAULT_CATALOGUE}
"""Title of each fault in the catalogue, by fault id."""


def write_page(path: Path, report: CampaignReport) -> None:
    """Write the report of a campaign as an HTML page."""
    content = report.as_json()
    title = f"Fault campaign: {html.escape(report.hand)}"
    title_cells = "".join(
        f"<tr><th>{html.escape(label)}</th><td class=n>{value}</td></tr>"
        for label, value in (
            ("scenarios", content["scenarios"]),
            ("failed", content["late"]),
            ("without effect (no positive control)", content["not_felt"]),
            ("slowest reaction [ticks]", content["worst_ticks"]),
            (
                "slowest reaction, fraction of its bound",
                f"{content['worst_share_of_bound']:.2f}",
            ),
            ("largest true tension [N]", f"{content['worst_tension_N']:.0f}"),
            ("false alarms of the fault-free hand", content["false_alarms"]),
            ("simulated without faults [s]", f"{content['false_alarm_run_s']:g}"),
        )
    )
    html_sections = [f"<h1>{title}</h1><table>{title_cells}</table>"]
    for protocol, results in report.results.items():
        rate = report.control_rates_hz[protocol]
        scenario_count_by_id = Counter(result.id for result in results)
        table_title = f"{protocol}, {rate:g} Hz: each row by its slowest scenario"
        html_sections.append(
            f"<h2>{table_title}</h2>{_html_table(_slowest_result_per_row(results), rate, scenario_count_by_id)}"
        )
        failed_results = [result for result in results if not result.ok]
        if failed_results:
            html_sections.append(
                f"<h2 class=bad>{protocol}: failed</h2>{_html_table(failed_results, rate, scenario_count_by_id)}"
            )
    rows = "".join(
        f"<tr><td>{id_}</td><td>{html.escape(reason)}</td></tr>"
        for id_, reason in TEST_PLACE_BY_UNTESTED_FAULT.items()
    )
    html_sections.append(f"<h2>Rows that are tested elsewhere</h2><table>{rows}</table>")
    page = f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title><style>{PAGE_STYLE}</style>"
    write_text_atomically(path, page + "\n".join(html_sections) + "</html>\n")


def _slowest_result_per_row(results: Iterable[ScenarioResult]) -> list[ScenarioResult]:
    """Return, for each row of the fault matrix, the result with the largest ``reaction_time_ratio``."""
    slowest_by_row: dict[str, ScenarioResult] = {}
    for result in results:
        current = slowest_by_row.get(result.id)
        if current is None or reaction_time_ratio(result) > reaction_time_ratio(current):
            slowest_by_row[result.id] = result
    # The rows of the table are in the order of the fault catalogue: bus, node, tendon, host,
    # interface.
    return sorted(
        slowest_by_row.values(), key=lambda result: ("BNTHI".index(result.id[0]), result.id)
    )


def reaction_time_ratio(result: ScenarioResult) -> float:
    """Return the reaction time in a scenario, divided by the largest allowed reaction time.

    If the controller did not react in the scenario, the returned ratio is 9.9.
    """
    return result.ticks / max(result.bound, 1) if result.ticks >= 0 else 9.9


def _html_table(
    results: Iterable[ScenarioResult], rate_hz: float, scenario_count_by_id: Counter[str]
) -> str:
    title_cells = "".join(f"<th>{name}" for name in TABLE_TITLES)
    rows = "".join(
        _html_row(result, rate_hz, scenario_count_by_id[result.id]) for result in results
    )
    return f"<table><tr>{title_cells}</tr>{rows}</table>"


def _html_row(result: ScenarioResult, rate_hz: float, scenario_count: int) -> str:
    failure_class = "" if result.ok else " bad"
    bar_width_em = BAR_WIDTH_EM * min(reaction_time_ratio(result), 1.0)
    scenario = result.scenario.removeprefix(result.id).strip()
    reaction_time_text = f"{result.ticks * 1e3 / rate_hz:g} ms" if result.ticks >= 0 else "never"
    cells = [
        f"<td>{result.id}</td><td>{html.escape(TITLE_BY_FAULT_ID[result.id])}</td><td class=n>{scenario_count}</td>",
        f"<td>{html.escape(scenario)}</td><td>{html.escape(result.detected_by or 'requested')}</td>",
        f"<td class=n>{reaction_time_text}</td><td class=n>{result.ticks}</td><td class=n>{result.bound}</td>",
        f'<td><span class="bar{failure_class}" style="width:{bar_width_em:.2f}em"></span></td>',
        f"<td class=n>{result.tension:.0f} of {result.tension_bound:.0f} N</td>",
        f"<td class=bad>{html.escape(result.problem)}</td>",
    ]
    return f"<tr>{''.join(cells)}</tr>"


def summary_lines(report: CampaignReport) -> list[str]:
    """Return the summary of a campaign's report as lines for a terminal."""
    content = report.as_json()
    summary = [
        f"{content['scenarios']} scenarios, {content['late']} failed, {content['not_felt']} without effect",
        f"slowest reaction {content['worst_ticks']} ticks, {100 * content['worst_share_of_bound']:.0f} % of its bound",
        f"largest true tension {content['worst_tension_N']:.0f} N",
        f"{content['false_alarms']} false alarms in {content['false_alarm_run_s']:g} s without faults",
    ]
    return summary + [
        f"{result.scenario}: {result.problem}" for result in report.all_results if not result.ok
    ]
