"""Measure the control rates that each class of CAN adapter permits. The hand and the time are simulated.

Each run of the benchmark is `handctl demo`: commission the hand, grasp an object, hold the object
and release it. A control rate is possible if the run ends without a fault. The possible control
rates do not depend on the computer that runs the benchmark, because the time is simulated. The
computation of one run takes 20 s to several minutes.

    python benchmarks/adapters.py --hand jamia --adapters usb-fs --rates 250 333 500 --seeds 1
"""

import argparse
import contextlib
import io
import json
import tempfile
from pathlib import Path
from typing import NamedTuple

from firmware_sim.wire.can_adapter import ADAPTER_CLASSES
from handctl.cli.main import main
from handctl.cli.runs import demo


class AdapterRunOutcome(NamedTuple):
    """Outcome of one run of the demo at one control rate.

    Attributes:
        is_demo_passed: True if the demo ran to its end without a failure.
        tracking_error_deg: tracking error [deg].
        hold_error_n: tension error while the hand holds the object [N].
        end_cause: reason why the run ended.
    """

    is_demo_passed: bool
    tracking_error_deg: float
    hold_error_n: float
    end_cause: str


def run_demo_with_adapter(
    hand_name: str, adapter_class: str, rate_hz: float, seed: int
) -> AdapterRunOutcome:
    """Run ``handctl demo`` for a hand at a control rate [Hz], with a simulated CAN adapter on the bus."""
    original_run = demo.run

    def run_at_rate(args: argparse.Namespace) -> int:
        args.rate = rate_hz  # `handctl demo` has no option that selects an adapter.
        return original_run(args)

    output, errors = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        demo_arguments = [
            "demo",
            "--lockstep",
            "--hand",
            hand_name,
            "--json",
            "--log",
            str(Path(folder) / "run.mcap"),
        ]
        demo_arguments += ["--wire", f"adapter={adapter_class}", f"seed={seed}"]
        demo.run = run_at_rate
        try:
            with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
                main(demo_arguments)
        finally:
            demo.run = original_run
    if not output.getvalue():
        return AdapterRunOutcome(
            False, float("nan"), float("nan"), errors.getvalue().strip().splitlines()[-1]
        )
    result = json.loads(output.getvalue())
    error_by_digit = result["tracking_rmse_deg"]
    tracking_error_deg = (
        sum(error**2 for error in error_by_digit.values()) / len(error_by_digit)
    ) ** 0.5
    return AdapterRunOutcome(
        not result["failure"],
        tracking_error_deg,
        result["tension_hold_error_n"],
        result["failure"] or "done",
    )


def _print_outcomes() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hand", default="jamia", help="packaged hand (default: jamia)")
    parser.add_argument(
        "--adapters",
        nargs="+",
        choices=list(ADAPTER_CLASSES),
        default=list(ADAPTER_CLASSES),
        help="classes of adapters",
    )
    parser.add_argument(
        "--rates", nargs="+", type=float, default=[250.0, 333.0, 500.0], help="control rates [Hz]"
    )
    parser.add_argument(
        "--seeds", type=int, default=1, help="number of runs for each adapter and rate (default: 1)"
    )
    args = parser.parse_args()
    for adapter in args.adapters:
        for rate in args.rates:
            for seed in range(args.seeds):
                result = run_demo_with_adapter(args.hand, adapter, rate, seed)
                outcome_text = "held" if result.is_demo_passed else "NOT HELD"
                print(
                    f"{args.hand} {adapter} {rate:g} Hz, seed {seed}: {outcome_text},"
                    f" tracking {result.tracking_error_deg:.2f} deg,"
                    f" hold {result.hold_error_n:.2f} N, {result.end_cause}",
                    flush=True,
                )


if __name__ == "__main__":
    _print_outcomes()
