"""Net tension of a spool pair: two antagonistic tendons on one spool, wound in opposite directions.

When the spool turns, it winds up a length dl of one tendon, and pays out an equal length of the
other tendon. Each tendon has the pretension p and the stiffness k, so the tensions are p + k dl and
p - k dl, but never below 0. The net tension u of the pair is the difference of the two tensions.
While both tendons are taut, u is 2 k dl. If |u| exceeds 2 p, one tendon is slack, and the other
tendon bears all of u. In one formula the first tendon has the tension max(p + u / 2, u, 0), and the
second has max(p - u / 2, -u, 0).

Behind the pulleys, friction lowers the tension of the tendon that is wound, and raises the tension
of the tendon that is paid out. Both effects resist the motion. Because of the pretension, even a
pair without net tension therefore has friction.
"""

from handctl.compiled import kernel_helper


@kernel_helper
def net_tension_at_joint(net: float, pretension: float, passed_fraction: float) -> float:
    """Return the net tension at a joint, after the friction of the pulleys [N].

    Args:
        net: net tension at the spool [N].
        pretension: pretension of both tendons [N].
        passed_fraction: tension of the first tendon behind the pulleys, as a fraction of its
            tension at the spool. The second tendon moves in the opposite direction, so its fraction
            is the reciprocal.

    Source: capstan equation.
    """
    first = max(pretension + 0.5 * net, net, 0.0)
    second = max(pretension - 0.5 * net, -net, 0.0)
    return first * passed_fraction - second / passed_fraction


@kernel_helper
def net_tension_at_spool(net: float, pretension: float, passed_fraction: float) -> float:
    """Return the net tension at the spool for a net tension at a joint [N], the inverse of ``net_tension_at_joint``."""
    both_taut = (
        2.0
        * (net + pretension * (1.0 / passed_fraction - passed_fraction))
        / (passed_fraction + 1.0 / passed_fraction)
    )
    if abs(both_taut) < 2.0 * pretension:
        return both_taut
    return net / passed_fraction if both_taut > 0.0 else net * passed_fraction
