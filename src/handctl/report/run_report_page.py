"""HTML page about a run.

The HTML page is a single file that can be attached to a paper or a bug report.
"""

import base64
import html
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path

import numpy as np

from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import LoggedEvent
from handctl.log.topics.clock_pair_topic import clock_steps
from handctl.output_files import atomic_path
from handctl.printing import printable_text
from handctl.report.frame_counts import frame_counts
from handctl.report.run_figure import draw_run
from handctl.report.run_summary import angle_rows, summarise_run, tracking_text
from handctl.report.svg_pictures import draw_bus_loads, draw_lateness, draw_poses
from handctl.report.truth_record import TruthRecord

MAX_LISTED_EVENTS = 500
"""Largest number of events on the page. If a run has more events, only the first events are shown."""
MAX_LISTED_CONTACTS = 20
"""Largest number of contacts on the page. If a run has more contacts, only the first contacts are shown."""

PAGE_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; max-width: 1100px; margin: 2em auto;
       padding: 0 1em; }
h1 { font-size: 1.5em; margin-bottom: 0; } h2 { font-size: 1.1em; margin-top: 2em; border-bottom: 1px solid #ccc; }
p.sub { color: #666; margin-top: .2em; } img, svg { max-width: 100%; height: auto; }
table { border-collapse: collapse; font-size: .9em; } td, th { padding: .15em .8em .15em 0; text-align: left;
        vertical-align: top; } th { font-weight: 600; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
.two { display: flex; flex-wrap: wrap; gap: 2em; } .warn { color: #9a5b00; } .error { color: #b00020; }
code { font-size: .85em; word-break: break-all; }
"""
"""Style sheet of the page."""


def write_page(
    path: Path, log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int, name: str
) -> int:
    """Write the HTML page about a run.

    Args:
        path: path of the file to write.
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator, or None on hardware.
        offset_ns: time on the clock of the simulator at which the time of the run is 0 [ns].
        name: name of the log that the page shows.

    Returns:
        The size of the page [bytes].
    """
    load_picture, max_bus_loads = draw_bus_loads(log, hand)
    metadata = log.header.metadata
    title = f"{hand.name}: {_escaped_text(name)}"
    sections = [
        f"<h1>{title}</h1><p class=sub>{_escaped_text(hand.description)}</p>",
        f"<p class=error>{_escaped_text(log.warning)}</p>" if log.warning else "",
        _html_section("In numbers", _number_table(log, hand, truth, offset_ns, max_bus_loads)),
        _html_section("The hand in each phase", draw_poses(log, hand) + _colour_legend(hand)),
        _html_section(
            "Angles, tensions with their 1-sigma band, contact forces",
            _run_image(log, hand, truth, offset_ns),
        ),
        _html_section("Events and faults", _event_table(log)),
        _html_section("Loop and bus", f'<div class="two">{draw_lateness(log)}{load_picture}</div>'),
        _html_section(
            "Origin of this run", _text_table({**metadata, **log.header.wall, **log.end})
        ),
        _html_section("Gains", _text_table(log.header.gains)),
    ]
    page = f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title><style>{PAGE_STYLE}</style>"
    data = (page + "\n".join(sections) + "</html>\n").encode()
    with atomic_path(path) as temporary_path:
        temporary_path.write_bytes(data)
    return len(data)


def _escaped_text(text: object) -> str:
    """Return a text from a log, escaped for an HTML page."""
    return html.escape(printable_text(str(text), 2000))


def _html_section(title: str, body_html: str) -> str:
    """Return a section of the page as HTML."""
    return f"<section><h2>{title}</h2>{body_html}</section>"


def _html_table(name_value_rows: Iterable[tuple[str, str]]) -> str:
    """Return an HTML table with two columns."""
    lines = (f"<tr><th>{title}</th><td>{content}</td></tr>" for title, content in name_value_rows)
    return "<table>" + "".join(lines) + "</table>"


def _text_table(values_by_name: Mapping[str, object]) -> str:
    """Return an HTML table of texts from a log."""
    return _html_table(
        (_escaped_text(key), f"<code>{_escaped_text(value)}</code>")
        for key, value in values_by_name.items()
    )


def _number_table(
    log: RunLog,
    hand: Hand,
    truth: TruthRecord | None,
    offset_ns: int,
    max_bus_loads: "np.ndarray[tuple[int], np.dtype[np.float64]]",
) -> str:
    """Return the HTML table with the numbers of a run."""
    summary = summarise_run(log, hand, truth, offset_ns)
    lateness_us = summary["late_us"]
    factor, unit = tracking_text(summary)
    frames = frame_counts(log, hand)
    rows = [
        ("ticks", f"{summary['ticks']} at {summary['rate_hz']:g} Hz, {summary['missed']} missed"),
        (
            "lateness p50 / p99.9 / max",
            " / ".join(f"{us:.0f}" for us in lateness_us.values()) + " us" if len(log) else "",
        ),
        ("frames late", f"{frames.late_frames}"),
        ("frames lost", f"{frames.lost_frames}"),
        ("ticks with a silent bus", f"{frames.silent_ticks}"),
        ("gaps in the log", f"{len(log.gaps)}"),
        ("faults", _fault_counts(log)),
        ("contacts", _contact_times(log)),
        (
            "steps of the wall clock",
            ", ".join(f"{s.step_s:+.1f} s at {s.t_s:.0f} s" for s in clock_steps(log.clock_pairs)),
        ),
        (
            "largest bus load, by frames",
            ", ".join(
                f"{n} {100 * x:.0f} %" for n, x in zip(hand.bus_names, max_bus_loads, strict=True)
            ),
        ),
        (
            "tracking error in free motion, against the plant",
            _number_text(factor * summary["tracking_rmse_rad"], unit),
        ),
        ("tension estimate, against the plant", _number_text(summary["tension_rmse_n"], "N rms")),
        ("object moved while held", _number_text(summary["object_motion_mm"], "mm")),
    ]
    rows += [(_escaped_text(name), text) for name, text in angle_rows(summary["joint_angles"])]
    forces = summary["tip_equivalent_force_n"]
    rows += [
        (f"{name}: tip-equivalent force", _number_text(force, "N"))
        for name, force in forces.items()
    ]
    return _html_table((name, text) for name, text in rows if text)


def _number_text(value: float, unit: str) -> str:
    """Return a number with its unit as text. If the number is NaN, the text is empty."""
    return "" if value != value else f"{value:.2f} {unit}"


def _colour_legend(hand: Hand) -> str:
    """Return the legend of the hand pictures as HTML."""
    from handctl.report.run_figure import digit_colours

    legend_entries = (
        f'<span style="color:{colour}">&#9679;</span> {_escaped_text(name)}'
        for name, colour in zip(hand.digit_names, digit_colours(hand), strict=True)
    )
    note = "drawn with the estimated joint angles; arrows are the estimated force of the object on a fingertip"
    return "<p>" + " &nbsp; ".join(legend_entries) + f"; {note}</p>"


def _run_image(log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int) -> str:
    """Return the figure of a run as an HTML image with embedded data."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "run.png"
        draw_run(picture, log, hand, truth, offset_ns, "")
        data = base64.b64encode(picture.read_bytes()).decode()
    alternative_text = "angles, tensions, contact forces and lateness over time"
    return f'<img alt="{alternative_text}" src="data:image/png;base64,{data}">'


def _fault_counts(log: RunLog) -> str:
    """Return HTML lines with each reported fault, the number of reports, and the time of the first report."""
    first_time_by_fault: dict[str, float] = {}
    counts: Counter[str] = Counter()
    for event in _events_named(log, "fault"):
        fault = event.event.text.partition(":")[0]
        first_time_by_fault.setdefault(fault, event.t_ns / 1e9)
        counts[fault] += 1
    lines = (
        f"{_escaped_text(fault)}: {counts[fault]}, first at {t:.3f} s"
        for fault, t in first_time_by_fault.items()
    )
    return "<br>".join(lines) or "none"


def _contact_times(log: RunLog) -> str:
    """Return HTML lines with the first contacts of a run and their times."""
    lines = (
        f"{_escaped_text(event.event.text)} at {event.t_ns / 1e9:.3f} s"
        for event in _events_named(log, "contact")
    )
    return "<br>".join(islice(lines, MAX_LISTED_CONTACTS))


def _events_named(log: RunLog, name: str) -> Iterator[LoggedEvent]:
    """Return the events of a run that have the given name."""
    return (event for event in log.events if event.event.name == name)


def _event_table(log: RunLog) -> str:
    """Return the HTML table of the events of a run."""
    hidden_event_count = len(log.events) - MAX_LISTED_EVENTS
    more_text = (
        f"<p>and {hidden_event_count} more: handctl log info</p>" if hidden_event_count > 0 else ""
    )
    rows = (
        f'<tr class="{_escaped_text(event.level)}"><td class=n>{t_ns / 1e9:.3f} s</td>'
        f"<td>{_escaped_text(event.level)}</td>"
        f"<td>{_escaped_text(event.name)}</td><td>{_escaped_text(event.text)}</td></tr>"
        for _, t_ns, event in log.events[:MAX_LISTED_EVENTS]
    )
    return "<table>" + "".join(rows) + "</table>" + more_text
