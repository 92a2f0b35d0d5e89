"""Description of the hand in a log."""

from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.load import hand_from_content, parse_toml
from handctl.log.header import RunHeader


def described_hand(header: RunHeader, where: str) -> Hand:
    """Return the hand described in a log, after a check of its names against the columns of the log.

    Args:
        header: header of the log.
        where: name of the description in messages.

    Raises:
        ConfigError: the description is not a valid hand.
        LogError: joints, tendons, motors or digits in the description and in the header differ.
    """
    hand = hand_from_content(parse_toml(header.hand_toml, where), where)
    described = (hand.joints, hand.tendon_names, hand.motor_names, hand.digit_names)
    if described != (header.joints, header.tendons, header.motors, header.digits):
        raise LogError("names differ from the log's header", where, "the description of the hand that ran")
    return hand
