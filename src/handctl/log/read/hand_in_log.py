"""Hand description that is stored in a log."""

from contextlib import suppress

from handctl.errors import ConfigError, LogError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, parse_toml
from handctl.log.header import RunHeader


def described_hand(header: RunHeader, location: str) -> Hand:
    """Return the hand that is described in a log.

    The description and the header of the log must contain the same names of joints, tendons, motors
    and digits.

    Args:
        header: header of the log.
        location: name of the description, for error messages.

    Raises:
        ConfigError: the description does not describe a valid hand.
        LogError: the description and the header have different names of joints, tendons, motors or
            digits.
    """
    hand = hand_from_content(parse_toml(header.hand_toml, location), location)
    named_parts = (hand.joints, hand.tendon_names, hand.motor_names, hand.digit_names)
    if named_parts != (header.joints, header.tendons, header.motors, header.digits):
        raise LogError(
            "names differ from the log's header", location, "the description of the hand that ran"
        )
    return hand


def prismatic_joints(header: RunHeader) -> frozenset[str]:
    """Return the names of the prismatic joints in a log.

    The positions of prismatic joints are in m. If the log contains no valid description of the
    hand, all joints count as hinges. A log without a valid description of the hand can thus be
    exported.
    """
    with suppress(ConfigError, LogError):
        return described_hand(header, "hand.toml in the log").prismatic_joints
    return frozenset()
