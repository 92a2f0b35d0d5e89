"""Display of a running hand. A separate process draws the display from lines of JSON.

The controller writes a short line every tenth of a second to a pipe that never blocks. If the
display process is too slow, it misses lines. The controller never waits for the display process. In
a terminal, the display redraws the state of the hand in place. If the output is not a terminal, the
display prints one plain line per second.
"""

import json
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from handctl.cli.console.rich_console import rich_console
from handctl.core.tick_types import GAIN_EVENT, HandMode, TickEvent, TickIn, TickOut
from handctl.hand.description import Hand
from handctl.printing import escaped_streams
from handctl.safety.faults.table import remedy_for

REFRESH_PERIOD_S = 0.1
STDERR_FD = 2
"""File descriptor to which the display prints. Standard output is reserved for results."""
ONE_SECOND_NS = 1_000_000_000
MAX_LINE_CHARACTERS = 120
"""Longest line that the display prints without a terminal [characters]."""
NO_BREAK_SPACE = "\u00a0"


class DisplayProcess:
    """Controller's end of the pipe to the display process.

    Attributes:
        ticks_per_line: number of ticks between two lines of JSON.
        child: display process.
        pipe: file descriptor of the pipe to the display process.
        worst_late_ns: largest lateness of a tick since the last line [ns].
        last_warning_ns: time at which a warning of each fault id was last printed [ns].
        shown: remedies that the display has already printed.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        tension_limits: tuple[float, ...],
        rate_hz: float,
        bus_load: float,
    ) -> None:
        """Start the display process.

        Args:
            names: names of the tendons.
            tension_limits: tension limit of each tendon [N].
            rate_hz: control rate [Hz].
            bus_load: worst-case load of the bus, from 0 to 1.
        """
        self.ticks_per_line = max(1, round(REFRESH_PERIOD_S * rate_hz))
        display_setup = {
            "names": names,
            "ceiling": tension_limits,
            "rate_hz": rate_hz,
            "load": bus_load,
        }
        self.child = subprocess.Popen(
            [sys.executable, "-m", "handctl.cli.console.display"],
            stdin=subprocess.PIPE,
            stdout=STDERR_FD,
            start_new_session=True,
        )
        assert self.child.stdin is not None
        self.pipe = self.child.stdin.fileno()
        self.worst_late_ns = 0
        self.last_warning_ns: dict[str, int] = {}
        self.shown: set[str] = set()
        self._write_line(display_setup)
        os.set_blocking(self.pipe, False)

    @staticmethod
    def start_display(hand: Hand, rate_hz: float, bus_load: float) -> "DisplayProcess":
        """Start the display of a run, and return the controller's end of the pipe to the display."""
        return DisplayProcess(
            hand.tendon_names,
            tuple(tendon.tension_max_N for tendon in hand.tendon),
            rate_hz,
            bus_load,
        )

    def show_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Send a line about the tick to the display process.

        The method sends lines only about ticks with an event, and about one tick in each period of
        ``REFRESH_PERIOD_S``.
        """
        self.worst_late_ns = max(self.worst_late_ns, tick_input.late_ns)
        if tick_input.k % self.ticks_per_line and not tick_output.events:
            return
        line = {
            "k": tick_input.k,
            "t": tick_input.t_ns / 1e9,
            "mode": HandMode(tick_output.mode).name,
            "phase": tick_output.phase,
            "late_us": self.worst_late_ns / 1e3,
            "tension": [round(float(f), 2) for f in tick_output.telemetry.tension],
            "goal": [
                None if f != f else round(float(f), 2) for f in tick_output.telemetry.tension_goal
            ],
            "contact": [bool(c) for c in tick_output.telemetry.contact],
            "events": [
                [event.level, self._event_text(event)]
                for event in tick_output.events
                if self._is_due(tick_input.t_ns, event)
            ],
        }
        self.worst_late_ns = 0
        self._write_line(line)

    def _is_due(self, t_ns: int, event: TickEvent) -> bool:
        """Return True if the display should print an event.

        The display prints a repeated warning at most once per second. The log contains every event.
        """
        if event.level == "error" or event.name != "fault":
            return True
        fault_id = event.text[:3]
        is_new_warning = t_ns - self.last_warning_ns.get(fault_id, -ONE_SECOND_NS) >= ONE_SECOND_NS
        if is_new_warning:
            self.last_warning_ns[fault_id] = t_ns
        return is_new_warning

    def _event_text(self, event: TickEvent) -> str:
        """Return the text that the display prints for an event.

        At the first occurrence of a fault, a second line gives the remedy for the fault. If a gain
        has changed, the text contains the key of the gain.
        """
        if event.name == GAIN_EVENT:
            return f"{event.where} = {event.text}"
        remedy_text = remedy_for(event.text) if event.name == "fault" else ""
        if not remedy_text or remedy_text in self.shown:
            return event.text
        self.shown.add(remedy_text)
        return f"{event.text}\n{'':19}what to do: {remedy_text}"

    def _write_line(self, status_fields: dict[str, Any]) -> None:
        try:
            os.write(self.pipe, json.dumps(status_fields).encode() + b"\n")
        except OSError:
            return

    def close(self) -> None:
        """Close the pipe to the display.

        Wait at most 2 s until the display has printed its last line.
        """
        assert self.child.stdin is not None
        self.child.stdin.close()
        try:
            self.child.wait(2.0)
        except subprocess.TimeoutExpired:
            self.child.kill()


def short_tendon_names(names: Sequence[str]) -> list[str]:
    """Return the names of tendons, without the ending ``_tendon``."""
    return [name.removesuffix("_tendon") or name for name in names]


def _print_lines(run_fields: dict[str, Any]) -> None:
    """Print each event, and once per second a line about the state of the hand."""
    last_time_s = -1.0
    for text in sys.stdin:
        line = json.loads(text)
        for level, event in line["events"]:
            print(f"{line['t']:8.3f} s  {level:<5}  {event}", flush=True)
        if line["t"] - last_time_s >= 1.0:
            last_time_s = line["t"]
            print(_tension_lines(run_fields["names"], line), flush=True)


def _tension_lines(tendon_names: Sequence[str], status_fields: dict[str, Any]) -> str:
    """Return the state and the tensions of a hand as text.

    For a hand with many tendons, the text has several lines.
    """
    start = f"{status_fields['t']:8.3f} s  {status_fields['mode']:<9} {status_fields['phase']:<10} tension [N]  "
    pairs = zip(short_tendon_names(tendon_names), status_fields["tension"], strict=True)
    # A no-break space keeps a tendon's name and its tension on the same line.
    text = "  ".join(f"{name}{NO_BREAK_SPACE}{f:.1f}" for name, f in pairs)
    rows = textwrap.fill(
        text, MAX_LINE_CHARACTERS, initial_indent=start, subsequent_indent=" " * len(start)
    )
    return rows.replace(NO_BREAK_SPACE, " ")


def _draw_panel_in_place(run_fields: dict[str, Any]) -> None:
    """Draw the state of the hand at a fixed position in the terminal, with the package rich."""
    from rich.live import Live

    console = rich_console()
    with Live(console=console, refresh_per_second=10, transient=True) as live_display:
        for text in sys.stdin:
            line = json.loads(text)
            for level, event in line["events"]:
                live_display.console.print(f"{line['t']:8.3f} s  {level:<5}  {event}")
            live_display.update(_state_panel(run_fields, line))


def _state_panel(run_fields: dict[str, Any], status_fields: dict[str, Any]) -> Any:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    for title in ("tendon", "tension", "goal", "of its limit"):
        table.add_column(title, justify="left" if title == "tendon" else "right", min_width=8)
    for name, f, goal, limit in zip(
        run_fields["names"],
        status_fields["tension"],
        status_fields["goal"],
        run_fields["ceiling"],
        strict=True,
    ):
        bar = ProgressBar(total=limit, completed=min(f, limit), width=40)
        table.add_row(name, f"{f:.1f} N", "-" if goal is None else f"{goal:.1f} N", bar)
    header_line = Text(
        f"{status_fields['mode']}  {status_fields['phase']}  {status_fields['t']:.1f} s",
        style="bold",
    )
    footer = (
        f"{run_fields['rate_hz']:g} Hz, worst lateness {status_fields['late_us']:.0f} us, "
        f"bus load {100 * run_fields['load']:.0f} %"
    )
    return Group(header_line, table, Text(footer, style="dim"))


def main() -> None:
    """Run the display process until the controller closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    display_setup = json.loads(sys.stdin.readline())
    with escaped_streams():
        (_draw_panel_in_place if sys.stdout.isatty() else _print_lines)(display_setup)


if __name__ == "__main__":
    main()
