"""``handctl jog``: move one digit to a tension or an angle, one joint to an angle, or one drive on a bench."""

import argparse

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import print_json
from handctl.cli.console.plan import find_calibration, make_plan
from handctl.cli.runs import jog_drive
from handctl.document import validate_content
from handctl.errors import ConfigError
from handctl.programs.live_session import JogProgram
from handctl.programs.requests import HoldTensionRequest, MoveDigitsRequest
from handctl.session.calibration import ensure_calibration
from handctl.session.run import make_controller, run_live
from handctl.session.run_plan import commissioning_log_path, default_log_path


def run(args: argparse.Namespace) -> int:
    """Arm a hand, move one digit or joint, and then relax and disarm the hand.

    Return the exit code.
    """
    if args.mode:
        return jog_drive.run(args)
    if (
        args.protocol
        or args.node is not None
        or args.setpoint is not None
        or args.limit is not None
    ):
        raise ConfigError(
            "an option of one drive", "jog", "--mode with --protocol, --node, --setpoint"
        )
    plan = make_plan(args)
    names = (
        plan.hand.digit_names if args.angle is None else (*plan.hand.digit_names, *plan.hand.joints)
    )
    program = _jog_program(args, names, min(tendon.tension_max_N for tendon in plan.hand.tendon))
    path, calibration, reason = find_calibration(args, plan.hand, plan.buses)
    if args.dry_run:
        line = f"{plan.hand.name}: would jog {args.digit}" + (
            f", after commissioning: {reason}" if reason else ""
        )
        return report_dry_run(args, plan, line, digit=args.digit, commissioning=reason)
    announce_motion(args, plan, path, calibration)
    log = args.log or default_log_path(plan.hand, "jog")
    if calibration is None:
        calibration = ensure_calibration(plan, path, reason, run_live, commissioning_log_path(log))
    outcome = run_live(plan, make_controller(plan, program, calibration, arm_at_once=True), log)
    if args.json:
        print_json({"digit": args.digit, "log": str(log), "failure": outcome.state.failure})
    else:
        print(f"{args.digit}: {outcome.state.failure or 'done'}; log {log}")
    return outcome.exit_code


def _jog_program(
    args: argparse.Namespace, names: tuple[str, ...], max_tension: float
) -> JogProgram:
    """Check the goal, and return the program that moves the hand to the goal.

    The goal is checked before the hand moves. An angle can be the goal of a digit or of a single
    joint.

    Raises:
        ConfigError: the digit, the duration, the tension or the angle is invalid.
    """
    if args.digit not in names:
        raise ConfigError(repr(args.digit), "digit", "one of " + ", ".join(names))
    if not 0 < args.duration <= 600:
        raise ConfigError(f"{args.duration:g}", "--for", "more than 0, at most 600 s")
    if args.tension is None:
        goal = {
            "do": "move",
            "angle_deg": {args.digit: args.angle},
            "duration_s": args.duration / 2,
        }
        return JogProgram(validate_content(goal, MoveDigitsRequest, "--angle"), args.duration)
    if args.tension > max_tension:
        raise ConfigError(
            f"{args.tension:g} N", "--tension", f"at most tension_max_N = {max_tension:g} N"
        )
    goal = {"do": "hold", "tension_N": {args.digit: args.tension}}
    return JogProgram(validate_content(goal, HoldTensionRequest, "--tension"), args.duration)
