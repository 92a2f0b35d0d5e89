"""Net tension of a spool pair.

A spool pair consists of two antagonistic tendons, which are wound on one spool in opposite
directions. When the spool turns, it winds up a length dl of one tendon, and pays out the same
length of the other tendon. Both tendons have the pretension p and the stiffness k, so the tensions
of the two tendons are p + k dl and p - k dl, but never below 0. The net tension u of the pair is
the difference of the two tensions. While both tendons are taut, a spool turn by the length dl makes
the net tension u = 2 k dl. If |u| exceeds 2 p, one tendon is slack, and the other tendon carries
the whole net tension u. With or without a slack tendon, the tension of the first tendon is
max(p + u / 2, u, 0). The tension of the second tendon is max(p - u / 2, -u, 0).

Behind the pulleys, friction reduces the tension of the tendon that is wound up, and increases the
tension of the tendon that is paid out. The friction of both tendons resists the motion. Because of
the pretension, a spool pair has friction even if its net tension is 0.
"""

from handctl.compiled import kernel_helper


@kernel_helper
def net_tension_at_joint(net_tension: float, pretension: float, tension_ratio: float) -> float:
    """Return the net tension at a joint, after the friction of the pulleys [N].

    Args:
        net_tension: net tension at the spool [N].
        pretension: pretension of both tendons [N].
        tension_ratio: tension of the first tendon behind the pulleys, divided by its tension at
            the spool. The second tendon moves in the opposite direction, so its ratio of tensions
            is the reciprocal.

    Source: capstan equation.
    """
    first_tension = max(pretension + 0.5 * net_tension, net_tension, 0.0)
    second_tension = max(pretension - 0.5 * net_tension, -net_tension, 0.0)
    return first_tension * tension_ratio - second_tension / tension_ratio


@kernel_helper
def net_tension_at_spool(net_tension: float, pretension: float, tension_ratio: float) -> float:
    """Return the net tension at the spool for a net tension at a joint [N].

    The function ``net_tension_at_spool`` is the inverse of ``net_tension_at_joint``.
    """
    tension_if_both_taut = (
        2.0
        * (net_tension + pretension * (1.0 / tension_ratio - tension_ratio))
        / (tension_ratio + 1.0 / tension_ratio)
    )
    if abs(tension_if_both_taut) < 2.0 * pretension:
        return tension_if_both_taut
    return (
        net_tension / tension_ratio if tension_if_both_taut > 0.0 else net_tension * tension_ratio
    )
