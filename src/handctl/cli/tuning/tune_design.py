"""``handctl tune design``: design gains, and compare the stability margins of the old and the new gains."""

import argparse
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from handctl.cli.console.options import print_escaped, print_json
from handctl.cli.console.plan import gains_with_sources
from handctl.cli.console.rich_console import rich_console
from handctl.cli.console.verbosity import is_quiet
from handctl.cli.tuning.tune_files import (
    ensemble_of_tuned_hand,
    load_tuned_hand,
    output_files,
    verify_command,
    write_gains,
)
from handctl.controller.bus_load import bus_loads
from handctl.core.hand_model import HandModel
from handctl.errors import ConfigError
from handctl.session.exit_codes import ExitCode
from handctl.session.run_plan import control_rate

TABLE_WIDTH = 100
"""Width of the terminal at which no number in the table of margins is cut off [columns]."""
MIN_POLE_HZ = 0.01
MAX_DAMPING = 100.0


def run(args: argparse.Namespace) -> int:
    """Design gains, draw the control loops with these gains, and write the gains file and the picture.

    The command fails if the stability margins are too small.
    """
    from handctl.tune.loops.gain_design import (
        GainDesign,
        design_gains,
        linear_factors,
        model_with_gains,
    )
    from handctl.tune.loops.step_tests import DESIGN_LIMIT_FRACTION, RestTest
    from handctl.tune.tuning_figures import draw_loops

    if args.poles is None and args.damping != 1.0:
        raise ConfigError(
            f"{args.damping:g}", "--damping", "only with --poles-Hz, whose poles it damps"
        )
    hand, identified_hand, spread = load_tuned_hand(args.hand, args.fit)
    gains = gains_with_sources(args, hand).gains
    rate = control_rate(args.rate, hand, bus_loads(hand))
    output_path, picture = output_files(args, hand.name, "design")
    factors = ensemble_of_tuned_hand(args, spread, 1024)
    plants = tuple(linear_factors(factor) for factor in factors)
    model = HandModel.from_hand(identified_hand, gains, rate)
    rest_test = RestTest(identified_hand, factors, plants, args.seed)
    strict_proof = rest_test.with_limit_fraction(DESIGN_LIMIT_FRACTION)
    console = rich_console(error=True)
    console.quiet = is_quiet()
    with console.status(f"keeping margins on {len(plants)} plants"):
        try:
            result: GainDesign = (
                _place_poles(args, model, plants, rate)
                if args.poles is not None
                else design_gains(model, plants, strict_proof)
            )
        except ValueError as error:
            return _report_failure(args, f"{error}{strict_proof.reason}")
        passes_rest_test = args.poles is None or rest_test(model_with_gains(model, result.gains))
        if not result.worst_margins_after.stable or not passes_rest_test:
            return _report_failure(
                args, f"these poles are not stable on every plant{rest_test.reason}"
            )
        result = (
            result
            if rest_test(model)
            else result.with_zero_old_margins(rest_test.reason.removeprefix(": "))
        )
    model_after = HandModel.from_hand(identified_hand, result.gains, rate)
    note = f"tune design at {rate:g} Hz on {len(plants)} plants, seed {args.seed}"
    write_gains(output_path, result.gains, hand, note, fit=args.fit)
    draw_loops(picture, model, model_after, f"{hand.name} at {rate:g} Hz")
    is_sufficient = result.worst_margins_after.are_sufficient
    if args.json:
        print_json(_result_fields(result, output_path, picture, rate, len(plants)))
    else:
        _print_design(result, rate, len(plants))
        print(
            f"gains: {output_path}\npicture: {picture}\nnext: {verify_command(args, output_path)}"
        )
    return ExitCode.DONE if is_sufficient else ExitCode.FAILED


def _report_failure(args: argparse.Namespace, failure_reason: str) -> int:
    """Report the reason why no gains are written, and return the exit code."""
    if args.json:
        print_json({"gains": None, "picture": None, "enough": False, "why": failure_reason})
    print_escaped(f"handctl: tune design: {failure_reason}; nothing is written", error=True)
    return ExitCode.FAILED


def _place_poles(args: argparse.Namespace, model: HandModel, plants: Any, rate_hz: float) -> Any:
    """Return gains that give the poles ``--poles-Hz`` [Hz] and the damping ratio ``--damping``.

    Raises:
        ConfigError: a pole or the damping is not a number within the limits.
    """
    from handctl.tune.loops.gain_design import design_with_poles

    try:
        motion, tension = (float(word) for word in args.poles.split(","))
    except ValueError:
        raise ConfigError(repr(args.poles), "--poles-Hz", "two numbers, e.g. 6,25") from None
    if not (MIN_POLE_HZ <= motion < rate_hz / 2 and MIN_POLE_HZ <= tension < rate_hz / 2):
        raise ConfigError(
            args.poles, "--poles-Hz", f"{MIN_POLE_HZ:g} to half of the rate, {rate_hz / 2:g}"
        )
    if not 0 < args.damping <= MAX_DAMPING:
        raise ConfigError(f"{args.damping:g}", "--damping", f"more than 0, at most {MAX_DAMPING:g}")
    return design_with_poles(model, plants, motion, tension, args.damping)


def _result_fields(
    gain_design: Any, gains_path: Path, picture_path: Path, rate_hz: float, plant_count: int
) -> dict[str, Any]:
    return {
        "gains": str(gains_path),
        "picture": str(picture_path),
        "rate_hz": rate_hz,
        "plants": plant_count,
        "before": {
            f"{name}/{kind}": asdict(margins)
            for (name, kind), margins in gain_design.margins_before.items()
        },
        "after": {
            f"{name}/{kind}": asdict(margins)
            for (name, kind), margins in gain_design.margins_after.items()
        },
        "not_at_rest_before": gain_design.old_gains_failure,
        "worst_before": asdict(gain_design.worst_margins_before),
        "worst_after": asdict(gain_design.worst_margins_after),
        "enough": gain_design.worst_margins_after.are_sufficient,
    }


def _print_design(gain_design: Any, rate_hz: float, plant_count: int) -> None:
    from rich import box
    from rich.table import Table

    title = f"loops at {rate_hz:g} Hz, before \u2192 after; in the last row the least of {plant_count} plants"
    table = Table(title=title, box=box.SIMPLE, pad_edge=False)
    for heading in ("tendon", "loop", "gain dB", "phase deg", "disk", "delay ms", "cross Hz"):
        table.add_column(heading, no_wrap=True)
    unproven_text = "not at rest" if gain_design.old_gains_failure else "unstable"
    alike: dict[tuple[str, ...], list[str]] = {}
    for (name, kind), margins_after in gain_design.margins_after.items():
        alike.setdefault(
            (
                str(kind),
                *_margin_cells(
                    gain_design.margins_before[name, kind], margins_after, unproven_text
                ),
            ),
            [],
        ).append(name)
    for (kind, *cells), names in alike.items():
        more_text = f" + {len(names) - 1}" if len(names) > 1 else ""
        table.add_row(names[0].removesuffix("_tendon") + more_text, kind, *cells)
    table.add_section()
    table.add_row(
        "worst",
        "",
        *_margin_cells(
            gain_design.worst_margins_before, gain_design.worst_margins_after, unproven_text
        ),
    )
    rich_console(min_width=TABLE_WIDTH).print(table)
    if gain_design.old_gains_failure:
        reason = gain_design.old_gains_failure
        print_escaped(f"before: in simulation the hand does not come to rest: {reason}")


def _margin_cells(margins_before: Any, margins_after: Any, missing_margin_text: str) -> list[str]:
    """Return the cells of a row of the table.

    A row of the table contains each margin twice: with the old gains and with the new gains.

    Args:
        margins_before: stability margins with the old gains.
        margins_after: stability margins with the designed gains.
        missing_margin_text: text in the first cell if a loop has no margins. The other cells of a
            loop without margins contain a dash.
    """
    from handctl.tune.loops.margins import MAX_DELAY_S, MAX_GAIN_DB

    def margin_text(margins: Any, name: str, scale: float, digits: int) -> str:
        limit = {"gain_db": MAX_GAIN_DB, "delay_s": MAX_DELAY_S}.get(name, math.inf)
        value = getattr(margins, name)
        if not margins.stable:
            return missing_margin_text if name == "gain_db" else "-"
        return (
            "-"
            if math.isnan(value)
            else f"{'>' if value >= limit else ''}{value * scale:.{digits}f}"
        )

    def before_and_after_text(name: str, scale: float = 1.0, digits: int = 1) -> str:
        texts = (
            margin_text(margins, name, scale, digits) for margins in (margins_before, margins_after)
        )
        return "\u2192".join(texts)

    return [
        before_and_after_text("gain_db"),
        before_and_after_text("phase_deg", 1.0, 0),
        before_and_after_text("disk", 1.0, 2),
        before_and_after_text("delay_s", 1e3),
        before_and_after_text("crossover_hz", 1.0, 0),
    ]
