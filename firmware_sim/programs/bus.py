"""The program ``python -m firmware_sim bus``: a local bus without a simulated hand."""

import select

from firmware_sim.bus.bus_ports import open_port
from firmware_sim.bus.timed_port import DEFAULT_BITRATES, timed_port_factory
from firmware_sim.clock.shared_clock import SharedClock
from firmware_sim.command_line import CommandParser, stop_on_signal
from firmware_sim.printing import printable_text

_POLL_PERIOD_S = 0.2
"""Period with which the program checks for a stop signal [s]."""


def run(words: list[str]) -> None:
    """Serve a local bus until the process receives SIGTERM or SIGINT.

    Raises:
        SimulatorError: the program cannot use the arguments.
    """
    parser = CommandParser(
        prog="python -m firmware_sim bus",
        description="Serve a local bus without a hand until SIGTERM or SIGINT.",
    )
    parser.add_argument("name", help="name of the bus, which clients reach as local:NAME")
    parser.add_argument(
        "--wire", nargs="*", metavar="KEY=VALUE", help="simulate the wire with its timing (off)"
    )
    args = parser.parse_args(words)
    now_ns = SharedClock().now_ns
    timed_port = timed_port_factory(args.wire, [DEFAULT_BITRATES], now_ns, is_node_side=False)
    port = open_port(f"local:{args.name}", 0, timed_port)
    is_running = [True]
    stop_on_signal(is_running.clear)
    print(f"firmware_sim: ready bus=local:{printable_text(args.name)}", flush=True)
    try:
        while is_running:
            wait_ns = max(0, port.due_ns - now_ns())
            ready_sockets, _, _ = select.select(
                port.read_sockets(), port.write_sockets(), [], min(_POLL_PERIOD_S, wait_ns * 1e-9)
            )
            while port.receive(ready_sockets):
                ready_sockets = []
    finally:
        port.close()
