"""The task for a hand that has none yet: open, close until contact, hold, release, open."""

from typing import Any

import numpy as np

from handctl.core.law.redundancy import SIDEWAYS
from handctl.document import validated
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.file.toml_text import toml_text
from handctl.hand.kinematics import rotations
from handctl.hand.load import parse_toml
from handctl.hand.readiness import coordinate_range_deg
from handctl.hand.tree import HandTree
from handctl.programs.task import Task

CLOSED = 0.85
"""Angle of a closed coordinate per largest angle. A digit without an object stops before its joints do."""
LARGEST_CLOSED_DEG = 120.0
"""Largest angle of a closed coordinate [deg]."""
HOLD = 0.3
"""Tension of a hold per ``tension_max_N``, if as many digits close from one side as from the other."""
LARGEST_HOLD = 0.7
"""Largest tension of a hold per ``tension_max_N``."""
CONTACT = 0.16
"""Tension of a digit in contact per ``tension_max_N``, until all digits hold."""
RELEASE_N = 6.0
"""Tension of a release above the highest ``tension_floor_N`` of the hand [N]."""
RESTING = 1.5
"""Tension of an extensor in a hold per ``tension_floor_N``."""


def default_task(hand: Hand) -> tuple[Task, str]:
    """Return the default task of any hand, and its text as a task file.

    Args:
        hand: hand that is ready to run.
    """
    largest = min(tendon.tension_max_N for tendon in hand.tendon)
    floor = max(tendon.tension_floor_N for tendon in hand.tendon)
    opened = {name: np.zeros_like(_closed_deg(hand, name)).tolist() for name in hand.digit_names}
    # A digit that carries others, such as a wrist, keeps its angle.
    closing = [name for name in hand.digit_names if name not in hand.carriers]
    content: dict[str, Any] = {
        "schema": 1,
        "name": "close, hold, open",
        "description": f"Default task of {hand.name}",
        "phase": [
            {"kind": "move", "name": "home", "angle_deg": opened, "duration_s": 0.4},
            {
                "kind": "close",
                "name": "close",
                "angle_deg": {name: _closed_deg(hand, name).tolist() for name in closing},
                "speed_deg_s": 50.0,
                "contact_tension_N": round(max(CONTACT * largest, floor + 1.0), 1),
            },
            {
                "kind": "hold",
                "name": "hold",
                "tension_N": {name: _hold_tensions(hand, name, share) for name, share in _shares(hand).items()},
                "rate_N_per_s": 40.0,
                "duration_s": 5.0,
            },
            {"kind": "release", "name": "release", "tension_N": min(floor + RELEASE_N, largest), "rate_N_per_s": 60.0},
            {"kind": "move", "name": "open", "angle_deg": opened, "duration_s": 0.8},
        ],
    }
    text = f"# Made for {hand.name} by handctl: open, close until contact, hold, release, open.\n" + toml_text(content)
    return validated(parse_toml(text, "default task"), Task, "default task"), text


def _closed_deg(hand: Hand, name: str) -> np.ndarray:
    """Return the angle of each coordinate of a closed digit (n_c,) [deg]."""
    low, high = coordinate_range_deg(hand.digit_named(name))
    sideways = -low > SIDEWAYS * high
    closed = np.where(sideways, 0.0, np.minimum(CLOSED * high, LARGEST_CLOSED_DEG))
    return np.asarray(np.round(closed, 1))


def _shares(hand: Hand) -> dict[str, float]:
    """Return the factor of each digit's tension in a hold.

    The digits of both sides press alike. Two fingers would otherwise push a thumb open.
    """
    # The side of flexion is y of the last link, in the palm frame at rest.
    tree = HandTree.of(hand)
    turned = rotations(tree.poses(np.zeros(len(hand.joints))))
    sides = {digit.name: turned[digit.joints][-1, :, 1] for digit in tree.digits if digit.name not in hand.carriers}
    first = next(iter(sides.values()))
    opposed = {name: bool(direction @ first < 0.0) for name, direction in sides.items()}
    count = len(opposed)
    behind = sum(opposed.values())
    if behind == 0:
        return dict.fromkeys(opposed, 1.0)
    return {name: count / 2 / (behind if is_opposed else count - behind) for name, is_opposed in opposed.items()}


def _hold_tensions(hand: Hand, name: str, share: float) -> list[float]:
    """Return the tension of each tendon of a digit in a hold [N]. Extensors only stay taut."""
    held = min(HOLD * share, LARGEST_HOLD)
    arms = DigitModel.of(hand, name).reduced_moment_arms
    rows = zip(hand.tendon[hand.digit_tendons[name]], arms.sum(axis=1), strict=True)
    return [
        round(held * tendon.tension_max_N if arm > 0.0 else RESTING * tendon.tension_floor_N, 1) for tendon, arm in rows
    ]
