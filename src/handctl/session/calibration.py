"""Calibration of a hand for a run.

The calibration is either read from a file, or measured by the commissioning before the run.
"""

import datetime
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from handctl.core.calibration import Calibration, TendonCalibration, parse_calibration
from handctl.core.identified_parameters import IdentifiedParameters
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import read_toml
from handctl.output_files import write_text_atomically
from handctl.programs.commission import CommissionProgram, calibration_of_result
from handctl.runtime.buses.bus_opening import real_buses
from handctl.session.notices import NoticeCallback, ignore_notice
from handctl.session.run import RunFunction, RunOutcome, make_controller
from handctl.session.run_plan import RunPlan
from handctl.session.time_scale_advice import late_run_advice

MAX_CALIBRATION_AGE_S = 24 * 3600.0
"""Largest age of a calibration with which arming of a hand is allowed [s].

Older calibrations are wrong, because load cells drift and tendons creep.
"""
CLOCK_TOLERANCE_S = 60.0
"""Largest accepted time by which a calibration lies in the future [s], because clocks of computers differ."""
LOCKSTEP_CALIBRATION_DATE = datetime.datetime.fromtimestamp(0, datetime.UTC)
IdentifiedParametersByTendon = dict[str, IdentifiedParameters]
"""Identified parameters of each tendon, by name of the tendon."""


def load_calibration(path: Path, hand: Hand) -> Calibration:
    """Read the calibration of a hand.

    Raises:
        ConfigError: the file cannot be read, belongs to another hand or to another version of the
            hand's description, or lacks a tendon.
    """
    return parse_calibration(read_toml(path), hand, str(path))


def find_calibration(
    path: Path, hand: Hand, is_file_given: bool, buses: Sequence[str] = ()
) -> tuple[Calibration | None, str]:
    """Read a calibration file, and return the calibration if arming of the hand with this calibration is allowed.

    Args:
        path: path of the calibration file, which need not exist yet.
        hand: description of the hand that will be armed.
        is_file_given: True if the operator has named the file. An invalid file that the operator
            has named is an error.
        buses: buses of the hand that will be armed.

    Returns:
        The calibration, and an empty text. If the file has no valid calibration, the result
        consists of None and a text with the reason.

    Raises:
        ConfigError: the named file exists but cannot be used, or the file comes from a simulated
            hand although a bus may have real motors.
    """
    if not path.exists():
        return None, f"there is no {path}"
    try:
        calibration = load_calibration(path, hand)
        if calibration.simulated and (hardware_buses := real_buses(buses)):
            raise ConfigError(
                "is of a simulated hand",
                str(path),
                f"a calibration of the hand on {hardware_buses[0]}: handctl commission",
            )
    except ConfigError as error:
        if is_file_given:
            raise
        return None, str(error)
    age_s = time.time() - datetime.datetime.fromisoformat(calibration.made).timestamp()
    if age_s > MAX_CALIBRATION_AGE_S:
        return None, f"{path} is older than a day"
    if age_s < -CLOCK_TOLERANCE_S:
        return None, f"{path} is from the future, so its age is unknown"
    return calibration, ""


def run_commissioning(
    plan: RunPlan, log: Path, runner: RunFunction, reason: str = ""
) -> tuple[Calibration, RunOutcome]:
    """Run the commissioning program, and return the new calibration and the outcome of the run.

    Args:
        plan: checked plan of the run.
        log: path of the log file to write.
        runner: function that executes the run, either in real time or in lockstep.
        reason: reason why another run needs the commissioning, for a notice to the operator. The text
            is empty if the operator has requested the commissioning.

    Raises:
        ConfigError: no controller can be designed with the gains. If this error is raised, the
            notice is not shown.
        PowerError: a drive did not confirm that it is disabled.
        DriveError: a tendon, a sensor or a drive did not pass the commissioning. See
            ``RunOutcome.check_finished``.
    """
    controller = make_controller(plan, CommissionProgram(), None, arm_at_once=True)
    if reason:
        plan.show_notice(f"commissioning {plan.hand.name} first: {reason}")
    outcome = runner(plan, controller, log)
    outcome.raise_if_not_finished(f"commissioning {plan.hand.name}", late_run_advice(plan, outcome))
    is_lockstep = outcome.priority is None  # with a fixed date, two lockstep runs give equal files
    present_date = LOCKSTEP_CALIBRATION_DATE if is_lockstep else datetime.datetime.now(datetime.UTC)
    calibration = calibration_of_result(
        controller.model, outcome.state.progress, present_date.isoformat(timespec="seconds")
    )
    drive_states = zip(controller.drives, outcome.state.drives, strict=True)
    drives = {drive.name: drive.identity(state) for drive, state in drive_states}
    is_simulated = is_lockstep or plan.is_simulated
    return calibration.model_copy(update={"drive": drives, "simulated": is_simulated}), outcome


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration to a TOML file that has one table for each tendon."""
    rows = calibration.model_dump(by_alias=True)
    tables = {f"tendon.{name}": row for name, row in rows.pop("tendon").items()}
    tables |= {f"identified.{name}": row for name, row in rows.pop("identified").items()}
    for optional_key in ("drive", "simulated"):
        if not rows[optional_key]:
            del rows[optional_key]
    text = toml_text(rows) + "".join(
        f"\n[{name}]\n{toml_text(row)}" for name, row in tables.items()
    )
    write_text_atomically(path, text)


def previous_identified_parameters(
    path: Path, hand: Hand, drives: Mapping[str, str], show_notice: NoticeCallback = ignore_notice
) -> IdentifiedParametersByTendon:
    """Return the identified parameters of the previous calibration, by the name of the tendon.

    The identified parameters stay valid when the load cells are tared again. The result is empty if
    the file is missing or unusable, or if the hand now has other drives.

    Args:
        path: file of the previous calibration.
        hand: description of the hand.
        drives: identities of the present drives, by the name of the motor. The mapping is empty if
            the identities of the drives are unknown.
        show_notice: function that shows a notice to the operator.
    """
    try:
        calibration_before = load_calibration(path, hand) if path.exists() else None
    except ConfigError:
        return {}
    if calibration_before is None:
        return {}
    if drives and calibration_before.drive and calibration_before.drive != drives:
        if calibration_before.identified:
            show_notice(
                f"handctl: caution: {path}: was made with other drives, so their identified parameters are left out"
            )
        return {}
    return calibration_before.identified


def identified_parameters_in_file(path: Path | None, hand: Hand) -> IdentifiedParametersByTendon:
    """Return the identified parameters in a calibration file, by tendon.

    If ``path`` is None, the result is empty.

    A simulated run uses no values of a calibration file except the identified parameters. The tares
    and zeros of a simulated hand are valid for one seed and one start of the simulator. The
    identified parameters of a simulated hand are valid for all seeds and starts.

    Raises:
        ConfigError: the file cannot be read, is for another hand, or contains no identified
            parameters.
    """
    if path is None:
        return {}
    identified = load_calibration(path, hand).identified
    if not identified:
        raise ConfigError(
            "holds nothing identified", str(path), "a calibration that handctl identify wrote"
        )
    return identified


def homed_calibration(hand: Hand, identified: IdentifiedParametersByTendon) -> Calibration:
    """Return the calibration of a simulated hand with taut tendons and encoder readings of zero."""
    zero = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=0.0, crosstalk_N=0.0)
    rows = dict.fromkeys(hand.tendon_names, zero)
    date_text = LOCKSTEP_CALIBRATION_DATE.isoformat(timespec="seconds")
    return Calibration(
        hand=hand.name, identity=hand.identity, made=date_text, tendon=rows, identified=identified
    )


def ensure_calibration(
    plan: RunPlan, path: Path, reason: str, runner: RunFunction, log: Path
) -> Calibration:
    """Commission a hand that has no valid calibration, and write the new calibration to a file.

    A notice tells the operator why the hand is commissioned.

    Args:
        plan: plan of the run that follows the commissioning.
        path: calibration file to write. Identified parameters that this file already contains stay
            in the file.
        reason: reason why there is no valid calibration. The notice to the operator contains this
            reason.
        runner: function that executes the run, in real time or in lockstep.
        log: log file of the commissioning run.

    Raises:
        DriveError: see ``run_commissioning``.
    """
    calibration, _ = run_commissioning(plan, log, runner, reason)
    previous_parameters = previous_identified_parameters(
        path, plan.hand, calibration.drive, plan.show_notice
    )
    calibration = calibration.model_copy(update={"identified": previous_parameters})
    write_calibration(path, calibration)
    return calibration
