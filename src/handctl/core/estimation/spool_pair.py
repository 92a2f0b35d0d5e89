"""Net tension of a spool pair: two antagonistic tendons on one spool, wound in opposite directions.

A spool that turns winds one tendon and pays out the other by an equal length. With the pretension p
and the stiffness k of each tendon, the tensions are p + k dl and p - k dl, never below 0. The net
tension u of the pair is their difference. While both tendons are taut u = 2 k dl. Beyond |u| = 2 p
one tendon is slack, and the other bears all of u. In one formula the first tendon has the tension
max(p + u / 2, u, 0), and the second has max(p - u / 2, -u, 0).

Friction lowers the tension behind the pulleys of the tendon that winds, and raises it for the
tendon that pays out. Both effects resist the motion, so a pair without net tension has friction by
its pretension.
"""

from handctl.compiled import inner


@inner
def net_tension_at_joint(net: float, pretension: float, passed: float) -> float:
    """Return the net tension at a joint, less the friction of the pulleys [N].

    Args:
        net: net tension at the spool [N].
        pretension: pretension of both tendons [N].
        passed: tension of the first tendon behind the pulleys, as a fraction of that at the spool.
            The second tendon moves in the opposite direction, and has the reciprocal.

    Source: capstan equation.
    """
    first = max(pretension + 0.5 * net, net, 0.0)
    second = max(pretension - 0.5 * net, -net, 0.0)
    return first * passed - second / passed


@inner
def net_tension_at_spool(net: float, pretension: float, passed: float) -> float:
    """Return the net tension at the spool for a tension at a joint [N], the inverse of ``net_tension_at_joint``."""
    both_taut = 2.0 * (net + pretension * (1.0 / passed - passed)) / (passed + 1.0 / passed)
    if abs(both_taut) < 2.0 * pretension:
        return both_taut
    return net / passed if both_taut > 0.0 else net * passed
