"""Reconstruction of a controller from the log of its run."""

from importlib.metadata import version
from typing import TypeVar

from pydantic import ValidationError

from handctl.controller.run_setup import SETUP_ATTACHMENT_NAME, RunSetup
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.errors import ConfigError, IncomparableError, LogError
from handctl.hand.description import Hand
from handctl.log.code_identity import UNKNOWN_IDENTITY, code_identity
from handctl.log.read.hand_in_log import described_hand
from handctl.log.read.reader import RunLog
from handctl.printing import printable_text


def logged_hand(log: RunLog) -> Hand:
    """Return the description of the hand from the log of a run.

    Raises:
        LogError: the log contains no description of a hand that this version of handctl can read.
            If another version wrote the log, the error is an IncomparableError.
    """
    try:
        return described_hand(log.header, "hand.toml in the log")
    except ConfigError as error:
        raise _unusable_log_error(log, f"no usable hand in it: {error}") from None


def logged_gains(log: RunLog) -> Gains:
    """Return the gains from the log of a run.

    Raises:
        LogError: the log contains no gains that this version of handctl can read.
    """
    return _read_attachment(log, "gains.json", Gains)


def logged_setup(log: RunLog) -> RunSetup:
    """Return the set-up of a recorded run: control rate, load-cell tares, motor zero angles, and program.

    Raises:
        LogError: the log was written by a version of handctl that did not record the set-up.
    """
    return _read_attachment(log, SETUP_ATTACHMENT_NAME, RunSetup)


def rebuild_controller(log: RunLog, gains: Gains | None = None) -> Controller:
    """Rebuild the controller of a recorded run.

    The controller gets the given gains, or the gains in the log if none are given.

    Raises:
        LogError: a required record is missing from the log.
    """
    return logged_setup(log).controller(logged_hand(log), gains or logged_gains(log))


AttachmentT = TypeVar("AttachmentT", Gains, RunSetup)


def _read_attachment(log: RunLog, name: str, model: type[AttachmentT]) -> AttachmentT:
    """Return the decoded content of an attachment of a log.

    Raises:
        IncomparableError: another version of handctl wrote the log, and the attachment is missing or
            cannot be decoded.
        LogError: this version of handctl wrote the log, and the attachment is missing or cannot be
            decoded.
    """
    data = log.header.attachments.get(name)
    if data is None:
        raise _unusable_log_error(log, f"no {name} in it")
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        first_error = error.errors(include_url=False)[0]
        error_location = "".join(f" {key_or_index}" for key_or_index in first_error["loc"])
        raise _unusable_log_error(
            log, f"{name} cannot be read:{error_location}: {first_error['msg']}"
        ) from None


def _unusable_log_error(log: RunLog, reason: str) -> LogError:
    """Return the exception for a log from which no hand or no controller can be rebuilt.

    The message of the exception names the version of handctl that wrote the log, and this version.
    """
    metadata = log.header.metadata
    writer = metadata.get("version", UNKNOWN_IDENTITY)
    writer_code = metadata.get("code", UNKNOWN_IDENTITY)
    error_type = LogError if writer_code == code_identity() else IncomparableError
    return error_type(
        printable_text(reason),
        printable_text(f"the log, written by handctl {writer}, code {writer_code}"),
        f"a log that this one can execute: handctl {version('handctl')}, code {code_identity()}",
    )
