"""Conversion of command-line arguments to the inputs that the package ``handctl.session`` needs for a run."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from handctl.cli.console.options import print_escaped
from handctl.cli.console.progress import progress_bar
from handctl.cli.console.verbosity import (
    is_first_caution,
    is_quiet,
    is_verbose,
    print_detail,
    print_note,
)
from handctl.controller.bus_load import bus_loads
from handctl.core.calibration import Calibration
from handctl.core.gains.gains import Gains, packaged_gains
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import packaged_hands
from handctl.output_files import check_output_path
from handctl.session import calibration, gains, run_plan
from handctl.session.lockstep_simulation import SimulatorSettings

_gains_of_hands: dict[tuple[str, float], Gains] = {}
"""Default gains by the identity of the hand and the control rate.

A command needs the default gains several times, and their computation takes a second.
"""


def make_plan(args: argparse.Namespace, lockstep: bool = False) -> run_plan.RunPlan:
    """Check the hand, the gains, the buses and the control rate on a command line, and return the plan of the run.

    Raises:
        ConfigError: an argument or a file is wrong.
    """
    options = run_plan.RunOptions(
        hand=args.hand,
        is_hand_named=args.is_hand_named,
        bus_arguments=None if lockstep else args.bus,
        gains_file=args.gains,
        gain_arguments=getattr(args, "gain", None) or (),
        rate_hz=args.rate,
        time_scale=args.time_scale,
        log_path=args.log,
        clear_faults=args.clear,
        default_gains=partial(default_gains, requested_rate_hz=args.rate, show_force=True),
    )
    display = None if args.json or is_quiet() else _display_starter
    plan = replace(run_plan.make_plan(options, display, print_notice), show_progress=progress_bar)
    if is_verbose():
        _print_plan(args, plan)
    return plan


def _print_plan(args: argparse.Namespace, plan: run_plan.RunPlan) -> None:
    """Print hand, control rate, bus loads and hints of a planned run if ``--verbose`` is given."""
    hand = plan.hand
    print_detail(
        f"hand: {hand.name} from {args.hand}, identity {hand.identity[:16]}, {len(hand.tendon)} tendons"
    )
    loads = ", ".join(
        f"{name} {100 * load:.0f} %"
        for name, load in zip(hand.bus_names, plan.bus_loads, strict=False)
    )
    print_detail(
        f"rate: {plan.rate_hz:g} Hz, bus load: {loads}; buses: {', '.join(plan.buses) or 'in lockstep'}"
    )
    for text in run_plan.protocol_hint_lines(hand):
        print_detail(f"hint: {text}")
    for key, origin in gains_with_sources(args, hand).origins.items():
        if origin != gains.PACKAGED_GAINS_SOURCE:
            print_detail(f"gain {key} is from {origin}")


def print_notice(text: str) -> None:
    """Print a notice to standard error, unless ``--quiet`` is given.

    A text that begins with ``handctl:`` is a caution, and is printed even with ``--quiet``. If a
    command makes several runs, such as a commissioning and a task, each caution is printed only
    once.
    """
    if text.startswith("handctl:"):
        if is_first_caution(text):
            print_escaped(text, error=True)
    else:
        print_note(text)


def _display_starter(plan: run_plan.RunPlan) -> run_plan.OperatorDisplay:
    """Return a function that starts the display of a run."""
    from handctl.cli.console.display import DisplayProcess

    return DisplayProcess.start_display(plan.hand, plan.rate_hz, max(plan.bus_loads, default=0.0))


def gains_with_sources(args: argparse.Namespace, hand: Hand) -> gains.GainsWithSources:
    """Return the gains that a run with the given arguments uses.

    Args:
        args: arguments with ``gains`` and ``gain``.
        hand: hand of the run.

    Raises:
        ConfigError: a file or a value cannot be used, or the gains are for another hand.
    """
    hand_defaults = partial(default_gains, requested_rate_hz=getattr(args, "rate", None))
    return gains.gains_with_sources(
        hand, args.gains, getattr(args, "gain", None) or (), print_notice, hand_defaults
    )


def default_gains(
    hand: Hand, requested_rate_hz: float | None = None, show_force: bool = False
) -> Gains:
    """Return the gains that a hand uses if there is no gains file.

    Args:
        hand: description of the hand.
        requested_rate_hz: control rate that the operator has chosen [Hz], or None for the default
            rate of the hand.
        show_force: True to inform the operator if the motor force differs from the packaged force.
    """
    if hand.name in packaged_hands():
        return packaged_gains(hand.name)
    # Only a hand that is not packaged needs the margins, whose import takes 0.3 s.
    from handctl.tune.loops import default_gains as margin_gains
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB

    rate = run_plan.control_rate(requested_rate_hz, hand, bus_loads(hand))
    key = hand.identity, rate
    if key not in _gains_of_hands:
        _gains_of_hands[key] = margin_gains.default_gains(hand, rate)
    hand_gains = _gains_of_hands[key]
    force = hand_gains.motion.force_N
    packaged_force = packaged_gains(hand.name).motion.force_N
    if show_force and (force != packaged_force or hand_gains.tendon):
        tendon_forces = [
            f"{tendon_gains.name} {tendon_gains.motion_force_N:g} N"
            for tendon_gains in hand_gains.tendon
        ]
        forces_text = ", ".join([f"{force:g} N", *tendon_forces])
        print_notice(
            f"gain motion.force_N: {forces_text} instead of the packaged {packaged_force:g} N, "
            f"for a gain margin of {MIN_GAIN_MARGIN_DB:g} dB at {rate:g} Hz"
        )
    if show_force:
        # A digit keeps the packaged force if no smaller force gives it a sufficient margin.
        name, margin_db = margin_gains.smallest_gain_margin(hand, hand_gains, rate)
        force_of_tendon = {
            tendon_gains.name: tendon_gains.motion_force_N for tendon_gains in hand_gains.tendon
        }
        force = force_of_tendon.get(name) or force
        if margin_db < margin_gains.MIN_PACKAGED_MARGIN_DB:
            print_notice(
                f"gain motion.force_N: {force:g} N leave {name} a gain margin of {margin_db:.1f} dB, no smaller value "
                f"gives {MIN_GAIN_MARGIN_DB:g} dB, and the hand may oscillate (N07, N14b); try a smaller --gain "
                "motion.force_N, or handctl tune design"
            )
    return hand_gains


def calibration_path(args: argparse.Namespace, hand: Hand) -> Path:
    """Return the path of the calibration file of a hand. The file need not exist.

    Raises:
        ConfigError: the calibration file could not be written. The path of the file is checked
            before any motion of the hand.
    """
    path: Path = args.calibration or Path(f"{hand.name}.calibration.toml")
    check_output_path(
        path,
        "--calibration",
        Path(args.hand),
        getattr(args, "gains", None),
        getattr(args, "task", None),
    )
    return path


def find_calibration(
    args: argparse.Namespace, hand: Hand, buses: Sequence[str] = ()
) -> tuple[Path, Calibration | None, str]:
    """Return the path of the calibration file, and the calibration if arming with the calibration is allowed.

    Args:
        args: arguments with ``--calibration``.
        hand: description of the hand.
        buses: buses of the hand to arm.

    Returns:
        the path of the file, the calibration, and a text. If arming with the calibration is not
        allowed, the second value is None, and the text gives the reason.

    Raises:
        ConfigError: a named file exists but cannot be used, or the file cannot be written.
    """
    path = calibration_path(args, hand)
    loaded_calibration, reason = calibration.find_calibration(
        path, hand, bool(args.calibration), buses
    )
    print_detail(f"calibration: {path}" + (f" is not used: {reason}" if reason else ""))
    return path, loaded_calibration, reason


def check_perturb(args: argparse.Namespace, is_simulated: bool) -> dict[str, float]:
    """Check that a simulated hand accepts the factors of ``--perturb``, and return the factors.

    Args:
        args: arguments with the hand and ``--perturb``.
        is_simulated: True if the command simulates the hand.

    Raises:
        ConfigError: a word has not the form KEY=NUMBER, a key or a factor is invalid, or the
            command does not simulate a hand.
    """
    factors = gains.gain_assignments(args.perturb, "--perturb")
    if factors and not is_simulated:
        raise ConfigError(
            "only with --lockstep",
            "--perturb",
            "a simulator with it: python -m firmware_sim --perturb",
        )
    if factors:
        SimulatorSettings(args.hand, perturb=factors).check_hand_constructible()
    return factors


def refuse_bus_options(args: argparse.Namespace) -> None:
    """Raise an error if a command line without ``--bus`` contains an option that needs a bus.

    Raises:
        ConfigError: the command line contains an option that needs a bus.
    """
    for option, is_set in (("--clear", args.clear), ("--time-scale", args.time_scale is not None)):
        if is_set:
            raise ConfigError("only with --bus", option, "a run in lockstep without it")
