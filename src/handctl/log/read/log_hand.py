"""The hand described in a log."""

from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.load import hand_from, parse_toml
from handctl.log.header import RunHeader


def described_hand(header: RunHeader, where: str) -> Hand:
    """Read the hand of a log, and check its names against the columns of the log.

    Args:
        header: header of the log.
        where: name of the description in messages.

    Raises:
        ConfigError: the description is not a hand.
        LogError: the description has other joints, tendons, motors or digits than the header.
    """
    hand = hand_from(parse_toml(header.hand_toml, where), where)
    described = (hand.joints, hand.tendon_names, hand.motor_names, hand.digit_names)
    if described != (header.joints, header.tendons, header.motors, header.digits):
        raise LogError("names differ from the log's header", where, "the description of the hand that ran")
    return hand
