"""The controller of a recorded run, put together again from what the log holds."""

from importlib.metadata import version
from typing import TypeVar

from pydantic import ValidationError

from handctl.controller.setup import ATTACHMENT, Setup
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.errors import ConfigError, LogError
from handctl.hand.description import Hand
from handctl.log.code import UNKNOWN, code_identity
from handctl.log.read.hand import described_hand
from handctl.log.read.reader import RunLog
from handctl.printing import printable


def logged_hand(log: RunLog) -> Hand:
    """The hand that ran.

    Raises:
        LogError: the log holds no hand that this version can read.
    """
    try:
        return described_hand(log.header, "hand.toml in the log")
    except ConfigError as error:
        raise LogError(f"no usable hand in it: {error}", "the log", "a hand.toml") from None


def logged_gains(log: RunLog) -> Gains:
    """The gains it ran with.

    Raises:
        LogError: the log holds no gains that this version can read.
    """
    return _read(log, "gains.json", Gains)


def logged_setup(log: RunLog) -> Setup:
    """Rate, tare, zero and program.

    Raises:
        LogError: the log was written by a version that did not keep them.
    """
    return _read(log, ATTACHMENT, Setup)


def rebuild(log: RunLog, gains: Gains | None = None) -> Controller:
    """The controller that wrote the log, or the same with other gains.

    Raises:
        LogError: something that it needs is not in the log.
    """
    return logged_setup(log).controller(logged_hand(log), gains or logged_gains(log))


D = TypeVar("D", Gains, Setup)


def _read(log: RunLog, name: str, model: type[D]) -> D:
    data = log.header.attachments.get(name)
    if data is None:
        raise LogError(f"no {name} in it", *_versions(log))
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = "".join(f" {part}" for part in first["loc"])
        raise LogError(printable(f"{name} cannot be read:{place}: {first['msg']}"), *_versions(log)) from None


def _versions(log: RunLog) -> tuple[str, str]:
    """Who wrote a log, and who reads it: where an error is, and what would be right."""
    metadata = log.header.metadata
    wrote = f"handctl {metadata.get('version', UNKNOWN)}, code {metadata.get('code', UNKNOWN)}"
    here = f"handctl {version('handctl')}, code {code_identity()}"
    return printable(f"the log, written by {wrote}"), f"a log that this one can execute: {here}"
